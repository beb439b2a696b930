"""The table of docs/simulator.md: what each effect is worth, and what it costs.

    python -m calibration.benchmark.effect_table docs/studies/effects.jsonl

prints it from the rows of `calibration.benchmark.effect_ablation`. The rule, stated before a trunk without an effect
was trained: an effect pays where trunks learnt without it are worse by more than the noise. One that pays neither on
real presses nor on simulated parts, costs 1 % of a press or more, and is not needed for a reason of its own (`KEPT`)
leaves the default list.
"""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.benchmark.effect_ablation import ALL, NOT_TRAINED, OPTICAL, VARIANTS, rows_of
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.studies.intervals import t_quantile
from calibration.studies.page_parts import table
from calibration.training.train_config import EFFECTS
from edge.core.errors import ConfigError, GelgateError

__all__ = ["KEPT", "LEAST_SHARE", "Measured", "effect_table", "leaving", "measured", "trial_table"]

_LEAST_SEEDS = 3

LEAST_SHARE = 0.01
"""Of a press's processor time; an effect that costs less may stay whatever it is worth."""

KEPT: Mapping[str, str] = {
    "pose_jitter": "without it every press is the same press",
    "deformation": "masks are where its imprint differs",
    "dust": "the life of a gel",
    "wear": "the life of a gel, and its scars",
    "led_drift": "limits and their promises need light that varies",
    "noise": "limits and their promises need frames that vary",
}
"""Effects that other parts of the product need, with the reason."""


@dataclass(frozen=True)
class Measured:
    """AU-PRO up to 1 % false alarms of every variant, each the mean over trials and methods, for each seed."""

    values: Mapping[str, Sequence[float]]

    def mean(self, name: str) -> float:
        return float(np.mean(self.values[name]))

    def worth(self, name: str) -> float:
        """How much is lost without the effect; below 0 where the trunk is better without it."""
        return self.mean(ALL) - self.mean(name)

    def noise(self, name: str) -> float:
        """Half the width of the 95 % interval of its worth, were only the seeds to differ."""
        share = 1 / len(self.values[ALL]) + 1 / len(self.values[name])
        return t_quantile(self._freedom) * self._deviation * math.sqrt(share)

    def pays(self, name: str) -> bool:
        return self.worth(name) > self.noise(name)

    @property
    def _freedom(self) -> int:
        return sum(len(of) - 1 for of in self.values.values())

    @property
    def _deviation(self) -> float:
        """Of trunks that differ by their seed alone, pooled over the variants."""
        apart = [np.subtract(of, np.mean(of)) for of in self.values.values()]
        return math.sqrt(float((np.concatenate(apart) ** 2).sum()) / self._freedom)


def measured(rows: Sequence[Mapping[str, Any]], is_real: bool) -> Measured:
    """Of all rows, on real presses or on simulated parts. Errors: ConfigError for a variant without a row, or for fewer
    than three seeds with every effect."""
    found = {
        name: [_mean(row, is_real) for row in _trained(rows) if row["without"] == name]
        for name in (NOT_TRAINED, *VARIANTS)
    }
    if absent := [name for name, values in found.items() if not values]:
        raise ConfigError(f"the rows lack {', '.join(absent)}; continue the run")
    if len(found[ALL]) < _LEAST_SEEDS:
        raise ConfigError(
            f"the rows hold {len(found[ALL])} seeds with every effect, at least {_LEAST_SEEDS} are needed to know the "
            "noise; continue the run"
        )
    return Measured(found)


def _mean(row: Mapping[str, Any], is_real: bool) -> float:
    """Over the trials, of the mean over the methods of each."""
    chosen = [found for name, found in row["aupro_fpr01"].items() if (name in row["real"]) == is_real]
    return float(np.mean([np.mean(list(found.values())) for found in chosen]))


def effect_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Worth and cost of every effect. Errors: ConfigError for rows that are not complete."""
    costs = _costs(rows)
    real, simulated = (measured(rows, is_real) for is_real in (True, False))
    heading = [
        "left out",
        "ms",
        "of a press",
        "seeds",
        "real presses",
        "worth",
        "simulated part",
        "worth",
        "result",
    ]
    return table(heading, [[*_line(name, costs, real, simulated)] for name in (NOT_TRAINED, *VARIANTS)])


def _costs(rows: Sequence[Mapping[str, Any]]) -> Mapping[str, float]:
    """Of each effect as a share of a press, and in ms under the name `ms`."""
    found = [row for row in rows if "costs_ms" in row]
    if not found:
        raise ConfigError("the rows hold no costs; continue the run")
    costs: Mapping[str, float] = {
        name: ms / found[-1]["press_ms"] for name, ms in found[-1]["costs_ms"].items()
    }
    return {**costs, "ms": found[-1]["press_ms"]}


def _line(name: str, costs: Mapping[str, float], real: Measured, simulated: Measured) -> Iterator[str]:
    yield name if name in (ALL, OPTICAL, NOT_TRAINED) else f"`{name}`"
    yield from (f"{costs[name] * costs['ms']:.1f}", f"{costs[name]:.0%}") if name in costs else ("", "")
    yield str(len(real.values[name]))
    for of in (real, simulated):
        yield f"{of.mean(name):.3f}"
        yield (
            ""
            if name in (ALL, NOT_TRAINED)
            else f"{round(of.worth(name), 3) + 0.0:+.3f} ± {of.noise(name):.3f}"
        )
    yield _result(name, costs, real, simulated) if name in EFFECTS else ""


def _result(name: str, costs: Mapping[str, float], real: Measured, simulated: Measured) -> str:
    places = [word for word, of in (("real presses", real), ("simulated parts", simulated)) if of.pays(name)]
    if places:
        return f"pays on {' and '.join(places)}"
    if name in KEPT:
        return f"within the noise; kept: {KEPT[name]}"
    if name not in DEFAULT_EFFECTS:
        return "within the noise; not in the default list"
    return "within the noise" if costs[name] < LEAST_SHARE else "within the noise: leaves the default list"


def leaving(rows: Sequence[Mapping[str, Any]], default: Sequence[str] = DEFAULT_EFFECTS) -> list[str]:
    """The effects that the rule takes from the default list."""
    costs = _costs(rows)
    both = [measured(rows, is_real) for is_real in (True, False)]
    return [
        name
        for name in EFFECTS
        if name in default
        and name not in KEPT
        and costs[name] >= LEAST_SHARE
        and not any(of.pays(name) for of in both)
    ]


def trial_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """AU-PRO of every variant by trial and method, means over its seeds."""
    columns = [(trial, method) for trial, of in _trained(rows)[0]["aupro_fpr01"].items() for method in of]
    lines = []
    for name in (NOT_TRAINED, *VARIANTS):
        found = [row["aupro_fpr01"] for row in _trained(rows) if row["without"] == name]
        lines.append(
            [name, *(f"{np.mean([of[trial][method] for of in found]):.3f}" for trial, method in columns)]
        )
    return table(["left out", *(f"{trial}, {method}" for trial, method in columns)], lines)


def _trained(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [row for row in rows if "without" in row]


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    given = list(sys.argv[1:] if words is None else words)
    if len(given) != 1:
        print("name one file of rows, such as docs/studies/effects.jsonl", file=sys.stderr)
        return 2
    try:
        if not (rows := rows_of(Path(given[0]))):
            raise ConfigError(
                f"'{given[0]}' holds no rows; write them with calibration.benchmark.effect_ablation"
            )
        print(effect_table(rows), trial_table(rows), sep="\n", end="")
    except (GelgateError, OSError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
