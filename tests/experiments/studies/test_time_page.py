"""The page about time: every number comes from the rows."""

from typing import Any

import pandas as pd
import pytest

from calibration.experiments.studies.time_page import page

SECONDS = {"cpu_fit_s": 4.0, "cpu_score_s": 1.5, "cpu_measure_s": 0.5}


def row(**changed: Any) -> dict[str, Any]:
    own = {"study": "good-fraction", "part": "PZ1", "method": "padim", "fraction": 0.5, "seed": 0}
    return {**own, "backbone": "tiny", "mode": "corrected", "split": "press", **SECONDS, **changed}


def lines(*rows: dict[str, Any]) -> list[str]:
    return [line for line in page(pd.DataFrame(rows)).text.splitlines() if line.startswith("|")]


def test_cells_are_summed_and_ten_seeds_are_ten_times_the_mean() -> None:
    """Two seeds of one condition take 6 s each: 0.2 minutes; ten of them take one."""
    found = lines(row(), row(seed=1))

    assert "| tiny | corrected | press | good-fraction | 2 | 6.0 | 0.2 | 1.0 |" in found
    assert "| good-fraction | PZ1 | tiny | corrected | press | 2 | 6.0 | 0.2 | 1.0 |" in found


def test_all_studies_of_a_setup_are_added() -> None:
    """Conditions of another study, part or method are conditions of their own; another setup is another line."""
    found = lines(
        row(),
        row(part="PZ3"),
        row(study="cross-position", fraction=None, target_fraction=0.05),
        row(mode="paper", cpu_fit_s=58.0),
    )

    assert "| tiny | corrected | press | **all** | 3 | 6.0 | 0.3 | 3.0 |" in found
    assert "| tiny | paper | press | **all** | 1 | 60.0 | 1.0 | 10.0 |" in found


@pytest.mark.parametrize(
    "refused", [{"error": "too few presses"} | dict.fromkeys(SECONDS), dict.fromkeys(SECONDS)]
)
def test_cells_without_a_time_are_left_out(refused: dict[str, Any]) -> None:
    """Those that could not be fitted, and rows without these columns."""
    assert "| tiny | corrected | press | **all** | 1 | 6.0 | 0.1 | 1.0 |" in lines(row(), row(**refused))


def test_rows_without_any_time_are_an_empty_table() -> None:
    """Where every cell was refused the columns are not there."""
    assert len(lines({k: v for k, v in row(error="no").items() if k not in SECONDS})) == 4
