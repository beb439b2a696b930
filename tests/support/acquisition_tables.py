"""The tables of docs/acquire.md, from the rows of the simulated acquisitions; make them with `make acquisitions`."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.acquisition.coverage import ROUND, Standing

ROWS = Path(__file__).resolve().parents[1] / "bench" / "acquisitions.jsonl"
PROMISED = Standing(0, None, None).promised_at
POOL = 40
"""Presses that an acquisition may take."""
FRESH = 100
"""Other presses that show the rate of false alarms."""

DESIGNS = ("presses", "pieces")


def write_rows(found: Sequence[Mapping[str, Any]]) -> None:
    """Sorted, with four decimals."""
    ordered = sorted(found, key=lambda row: (DESIGNS.index(row["design"]), row["part"], row["order"]))
    rounded = [
        {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}
        for row in ordered
    ]
    ROWS.write_text("".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rounded))


def read_rows() -> list[dict[str, Any]]:
    return [json.loads(line) for line in ROWS.read_text().splitlines()]


def tables(found: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[str]]:
    """The lines of the table of promises, and of that of forecasts."""
    of = {design: [row for row in found if row["design"] == design] for design in DESIGNS}
    promises = [
        "| design | acquisitions | promised | false alarms | broken | its interval | broken by press | its interval "
        "| an exact promise | presses used | its interval | at most | AU-PRO lost | nine of ten lose less |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
        *(promise_line(design, chosen) for design, chosen in {**of, "both": found}.items()),
    ]
    forecasts = [
        "| design | seen | of the coverage | / needed, median | within 30 % | still needed within 30 % | of the end "
        "| / needed, median | within 30 % | still needed within 30 % |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for design, chosen in of.items():
        lines = [forecast_line(design, chosen, seen) for seen in range(ROUND, POOL, ROUND)]
        forecasts += [line for line in lines if line]
    return promises, forecasts


def promise_line(design: str, found: Sequence[Mapping[str, Any]]) -> str:
    """How often the promise is broken, how many presses are used, and what is lost by not using all."""
    broken = np.array([row["false_alarms"] > row["by_piece"] for row in found])
    by_press = np.array([row["false_alarms"] > row["by_press"] for row in found])
    used = np.array([row["stop"] for row in found]) / POOL
    lost = np.array([row["aupro_all"] - row["aupro"] for row in found])
    promised = np.median([row["by_piece"] for row in found])
    exact = np.mean([seen_as_broken(row["stop"], row["by_press"]) for row in found])
    return (
        f"| {design} | {len(found)} | {promised:.1%} | {np.mean([r['false_alarms'] for r in found]):.1%} | "
        f"{broken.mean():.1%} | {_over_parts(found, broken, 1)} | "
        f"{by_press.mean():.1%} | {_over_parts(found, by_press, 1)} | {exact:.1%} | "
        f"{used.mean():.0%} | {_over_parts(found, used, 0)} | {used.max():.0%} | "
        f"{lost.mean():+.4f} | {np.quantile(lost, 0.9):+.4f} |"
    )


def seen_as_broken(presses: int, rate: float) -> float:
    """How often fresh presses exceed a rate that is promised exactly: their number is finite, so they scatter too.
    Without a difference between the presses learnt and the fresh ones every order of their scores is as likely. More
    than `rate` of the fresh ones alarm where the highest scores of all are theirs: C(m, k) / C(m + n, k)."""
    alarms = math.floor(FRESH * rate) + 1
    return math.comb(FRESH, alarms) / math.comb(FRESH + presses, alarms)


def _over_parts(found: Sequence[Mapping[str, Any]], values: NDArray[Any], decimals: int) -> str:
    """The 95 % bootstrap interval of the mean over parts: acquisitions of one part are not independent."""
    parts = np.array([row["part"] for row in found])
    means = np.array([values[parts == part].mean() for part in np.unique(parts)])
    drawn = np.random.default_rng(0).choice(means, (10_000, len(means))).mean(axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return f"{low:.{decimals}%} to {high:.{decimals}%}"


def forecast_line(design: str, found: Sequence[Mapping[str, Any]], seen: int) -> str | None:
    """How near the forecasts after so many presses are to what was needed: of the coverage alone, and of the end."""
    coverage = [
        (ahead, row["covered"]) for row in found if (ahead := _ahead(row, seen)) and row["covered"] > seen
    ]
    end = [
        (max(ahead, PROMISED), row["stop"])
        for row in found
        if (ahead := _ahead(row, seen)) and row["stop"] > seen
    ]
    if not end:
        return None
    return f"| {design} | {seen} | {_nearness(coverage, seen)} | {_nearness(end, seen)} |"


def _ahead(row: Mapping[str, Any], seen: int) -> int | None:
    """The forecast of the coverage after so many presses; those seen, where it was reached; None where unknown."""
    if row["covered"] is None:
        return None
    return next(
        (ahead for count, ahead in row["forecasts"] if count == seen),
        seen if row["covered"] <= seen else None,
    )


def _nearness(pairs: Sequence[tuple[int, int]], seen: int) -> str:
    """Cells of the table: how many, the median of forecast / needed, and the shares within 30 %, in all and ahead."""
    if not pairs:
        return "0 | | |"
    forecast, needed = np.array(pairs, np.float64).T
    total, still = forecast / needed, (forecast - seen) / (needed - seen)
    near, near_still = np.mean(np.abs(total - 1) <= 0.3), np.mean(np.abs(still - 1) <= 0.3)
    return f"{len(pairs)} | {np.median(total):.2f} | {near:.0%} | {near_still:.0%}"
