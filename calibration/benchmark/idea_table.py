"""The tables of docs/backbone.md about ideas for real touch: what each gains, alone and joined.

    python -m calibration.benchmark.idea_table docs/studies/ideas.jsonl

prints them from the rows of `calibration.benchmark.idea_ablation`. An idea pays where trunks learnt with it are better
than the base by more than chance, and harms where they are worse by more than chance.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calibration.benchmark.ideas import (
    BASE,
    IDEAS,
    NOT_TRAINED,
    PHOTOGRAPH,
    PHOTOGRAPH_OF_IT,
)
from calibration.benchmark.seed_differences import Worth, differences
from calibration.benchmark.short_trunks import exit_code, mean_of, rows_of
from calibration.studies.page_parts import table
from edge.core.errors import ConfigError

__all__ = ["gains", "idea_table", "trial_table"]

Rows = Sequence[Mapping[str, Any]]

_ALONE, _JOINED = "aupro_fpr01", "joined_aupro_fpr01"
_COLUMNS = (
    ("real presses, alone", _ALONE, True),
    ("real presses, joined", _JOINED, True),
    ("simulated part, joined", _JOINED, False),
)
_LEAST_SEEDS = 3
_COMPARED = {
    PHOTOGRAPH: "no tactile channel",
    PHOTOGRAPH_OF_IT: "no tactile channel",
    NOT_TRAINED: "tactile channels as they are before training",
}


def gains(rows: Rows, column: str, is_real: bool) -> dict[str, Worth]:
    """What every idea but the base gains. Errors: ConfigError for an idea without a row, or for too few seeds."""
    _check_complete(rows)
    values = [
        (row["idea"], row["seed"], mean_of(row, is_real, column)) for row in rows if row["idea"] in IDEAS
    ]
    return differences(values, [name for name in IDEAS if name != BASE])


def _check_complete(rows: Rows) -> None:
    """Errors: ConfigError."""
    counts = Counter(row["idea"] for row in rows)
    if absent := [name for name in (*_COMPARED, *IDEAS) if not counts[name]]:
        raise ConfigError(f"the rows lack {', '.join(absent)}; continue the run")
    seeds = {row["seed"] for row in rows if row["idea"] in IDEAS}
    trunks = sum(counts[name] for name in IDEAS)
    if counts[BASE] < _LEAST_SEEDS or trunks < len(IDEAS) + len(seeds):
        raise ConfigError(
            f"the rows hold {trunks} trunks, {counts[BASE]} of them of the base, too few to know the noise; "
            "continue the run with --seeds 2"
        )


def idea_table(rows: Rows) -> str:
    """What every idea gains. Errors: ConfigError for rows that are not complete."""
    found = [gains(rows, column, is_real) for _, column, is_real in _COLUMNS]
    counts = Counter(row["idea"] for row in rows)
    lines: list[list[object]] = [
        [name, IDEAS[name], counts[name], *(of[name] for of in found), _result([of[name] for of in found])]
        for name in found[0]
    ]
    heading = ["idea", "what is other", "seeds", *(words for words, *_ in _COLUMNS), "result"]
    return f"{table(heading, lines)}\n{mean_table(rows)}"


def _result(found: Sequence[Worth]) -> str:
    """Where it pays and where it harms."""
    places = [words.replace(",", "") for words, *_ in _COLUMNS]
    words = []
    for word in ("pays", "harms"):
        shown = [place for place, of in zip(places, found, strict=True) if getattr(of, word)]
        words += [f"{word}: {' and '.join(shown)}"] * bool(shown)
    return "; ".join(words) or "not decided"


def mean_table(rows: Rows) -> str:
    """The means over the seeds of the base, and of what it is compared with."""
    return table(["layer1", "what it is", *(words for words, *_ in _COLUMNS)], list(_means(rows)))


def _means(rows: Rows) -> Iterator[list[object]]:
    for name, words in ({BASE: IDEAS[BASE]} | _COMPARED).items():
        of = [row for row in rows if row["idea"] == name]
        means = (np.mean([mean_of(row, is_real, column) for row in of]) for _, column, is_real in _COLUMNS)
        cells = [f"{mean:.3f}" for mean in means]
        yield [name, words, *cells]


def trial_table(rows: Rows, *, is_joined: bool) -> str:
    """AU-PRO of every trunk by trial and method, means over its seeds."""
    read = _JOINED if is_joined else _ALONE
    columns = [(trial, method) for trial, of in rows[0][read].items() for method in of]
    lines = []
    for name in (*_COMPARED, *IDEAS):
        found = [row[read] for row in rows if row["idea"] == name]
        lines.append(
            [name, *(f"{np.mean([of[trial][method] for of in found]):.3f}" for trial, method in columns)]
        )
    return table(
        ["joined" if is_joined else "alone", *(f"{trial}, {method}" for trial, method in columns)], lines
    )


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    given = list(sys.argv[1:] if words is None else words)
    if len(given) != 1:
        print("name one file of rows, such as docs/studies/ideas.jsonl", file=sys.stderr)
        return 2
    return exit_code(partial(_print, Path(given[0])))


def _print(path: Path) -> None:
    """Errors: ConfigError for a file without complete rows."""
    if not (rows := rows_of(path)):
        raise ConfigError(f"'{path}' holds no rows; write them with calibration.benchmark.idea_ablation")
    gained = idea_table(rows)
    by_trial = [trial_table(rows, is_joined=is_joined) for is_joined in (False, True)]
    print(gained, *by_trial, sep="\n", end="")


if __name__ == "__main__":
    sys.exit(main())
