"""The table of docs/simulator.md: what each effect is worth, and what it costs.

    python -m calibration.benchmark.effect_table docs/studies/effects.jsonl

prints it from the rows of `calibration.benchmark.effect_ablation`. An effect pays where trunks learnt without it are
worse by more than chance. It leaves the default list where its worth is shown to be below `LEAST_WORTH` on real presses
and on simulated parts, where it costs `LEAST_SHARE` of a press or more, and where nothing else needs it (`KEPT`). What
is neither shown to pay nor shown to be worth less than that is not decided, and stays.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calibration.benchmark.effect_ablation import ALL, NOT_TRAINED, VARIANTS
from calibration.benchmark.seed_differences import LEAST_WORTH, Worth, differences
from calibration.benchmark.short_trunks import exit_code, mean_of, rows_of
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.effects import EFFECTS as SIMULATED
from calibration.studies.page_parts import table
from calibration.training.train_config import EFFECTS
from edge.core.errors import ConfigError

__all__ = ["KEPT", "LEAST_SHARE", "LEAST_WORTH", "effect_table", "leaving", "trial_table", "worths"]

_LEAST_SEEDS = 3
_HEADING = ("left out", "ms", "of a press", "seeds", "worth on real presses", "on a simulated part", "result")

LEAST_SHARE = 0.01
"""Of a press's processor time; an effect that costs less may stay whatever it is worth."""

KEPT: Mapping[str, str] = {
    "pose_jitter": "without it every press is the same press",
    "deformation": "masks are where its imprint differs",
    "dust": "the life of a gel",
    "wear": "the life of a gel, and its scars",
    "led_drift": "limits and their promises need light that varies",
    "noise": "limits and their promises need frames that vary",
    "illumination": "not left out: part of a sensor's colours",
    "vignette": "not left out: part of a sensor's colours",
    "motion_blur": "not drawn in training; recordings need presses that still move",
}
"""Effects that other parts of the product need, with the reason."""


def worths(rows: Sequence[Mapping[str, Any]], is_real: bool) -> dict[str, Worth]:
    """What is lost without the effects of every variant but `ALL`, on real presses or on simulated parts.

    Errors: ConfigError for a variant without a row, or for too few seeds.
    """
    _check_complete(_trained(rows))
    values = [
        (row["without"], row["seed"], -mean_of(row, is_real))
        for row in _trained(rows)
        if row["without"] != NOT_TRAINED
    ]
    return differences(values, [name for name in VARIANTS if name != ALL])


def _check_complete(rows: Sequence[Mapping[str, Any]]) -> None:
    """Errors: ConfigError."""
    counts = Counter(row["without"] for row in rows)
    if absent := [name for name in (NOT_TRAINED, *VARIANTS) if not counts[name]]:
        raise ConfigError(f"the rows lack {', '.join(absent)}; continue the run")
    trained = counts.total() - counts[NOT_TRAINED]
    freedom = trained - (len(VARIANTS) - 1) - len({row["seed"] for row in rows})
    if counts[ALL] < _LEAST_SEEDS or freedom < 1:
        raise ConfigError(
            f"the rows hold {trained} trunks, {counts[ALL]} of them with every effect, too few to know the noise; "
            "continue the run with --seeds 2"
        )


def effect_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Worth and cost of every effect. Errors: ConfigError for rows that are not complete."""
    costs = _Costs.of(rows)
    real, simulated = (worths(rows, is_real) for is_real in (True, False))
    counts = Counter(row["without"] for row in _trained(rows))
    lines: list[list[object]] = [
        [
            f"`{name}`" if name in EFFECTS else name,
            *costs.cells(name),
            counts[name],
            real[name],
            simulated[name],
            _result(name, costs, real[name], simulated[name]) if name in EFFECTS else "",
        ]
        for name in real
    ]
    rest: list[list[object]] = [
        [f"`{name}`", *costs.cells(name), *[""] * 3, KEPT[name]] for name in SIMULATED if name not in EFFECTS
    ]
    return f"{table(_HEADING, lines + rest)}\n{_scale(rows)}\n"


def _scale(rows: Sequence[Mapping[str, Any]]) -> str:
    """What the worths are differences of."""
    found = []
    for name, words in ((ALL, "With every effect"), (NOT_TRAINED, "With random weights")):
        of = [row for row in _trained(rows) if row["without"] == name]
        real, simulated = (np.mean([mean_of(row, is_real) for row in of]) for is_real in (True, False))
        found.append(
            f"{words} the mean is {real:.3f} on real presses and {simulated:.3f} on the simulated part."
        )
    return "\n".join(found)


@dataclass(frozen=True)
class _Costs:
    """Processor time in ms of a press with every effect, and of each effect."""

    press_ms: float
    each_ms: Mapping[str, float]

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]]) -> "_Costs":
        found = [row for row in rows if "costs_ms" in row]
        if not found:
            raise ConfigError("the rows hold no costs; continue the run")
        return cls(found[-1]["press_ms"], found[-1]["costs_ms"])

    def share(self, name: str) -> float:
        """0 where the difference of two times is below 0."""
        return max(0.0, self.each_ms[name] / self.press_ms)

    def cells(self, name: str) -> tuple[str, str]:
        if name not in self.each_ms:
            return "", ""
        return f"{max(0.0, self.each_ms[name]):.1f}", f"{self.share(name):.0%}"


def _result(name: str, costs: _Costs, real: Worth, simulated: Worth) -> str:
    both = {"real presses": real, "simulated parts": simulated}
    words = [f"{word} on {' and '.join(places)}" for word, places in _shown(both) if places]
    if name in KEPT:
        words.append(f"kept: {KEPT[name]}")
    elif name not in DEFAULT_EFFECTS:
        words.append("not in the default list")
    elif not (real.pays or simulated.pays):
        words.append(
            "leaves the default list" if _leaves(name, costs, real, simulated) else "not decided: stays"
        )
    return "; ".join(words)


def _shown(both: Mapping[str, Worth]) -> Iterator[tuple[str, list[str]]]:
    yield "pays", [place for place, of in both.items() if of.pays]
    yield "harms", [place for place, of in both.items() if of.harms]


def _leaves(name: str, costs: _Costs, *found: Worth) -> bool:
    return name not in KEPT and costs.share(name) >= LEAST_SHARE and all(of.is_small for of in found)


def leaving(rows: Sequence[Mapping[str, Any]], default: Sequence[str] = DEFAULT_EFFECTS) -> list[str]:
    """The effects that the rule takes from the default list."""
    costs, real, simulated = _Costs.of(rows), worths(rows, is_real=True), worths(rows, is_real=False)
    return [name for name in EFFECTS if name in default and _leaves(name, costs, real[name], simulated[name])]


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
    return exit_code(partial(_print, Path(given[0])))


def _print(path: Path) -> None:
    """Errors: ConfigError for a file without complete rows."""
    if not (rows := rows_of(path)):
        raise ConfigError(f"'{path}' holds no rows; write them with calibration.benchmark.effect_ablation")
    print(effect_table(rows), trial_table(rows), sep="\n", end="")


if __name__ == "__main__":
    sys.exit(main())
