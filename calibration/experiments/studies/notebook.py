"""The studies from Python: results as a pandas frame, plots as matplotlib figures.

Every study takes the fields of `calibration.experiments.harness.study.Options`, such as parts or seeds; what is empty
is the command's default. Errors: as the command; TypeError for another field.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.page import only_scored
from calibration.experiments.harness.rows import Rows, frame
from calibration.experiments.harness.study import Options
from calibration.experiments.studies.bad_presses_study import study_bad_presses
from calibration.experiments.studies.cross_position_study import study_cross_position
from calibration.experiments.studies.good_fraction_study import FRACTIONS, SHOTS, study_good_fraction
from calibration.experiments.studies.resolution_study import MOST_PRESSES, study_resolution
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["bad_presses", "cross_position", "figure", "good_fraction", "resolution"]


def good_fraction(
    dataset: Path | str,
    output: Path | str,
    *,
    fractions: Sequence[float] = FRACTIONS,
    shots: Sequence[int] = SHOTS,
    **asked: Any,
) -> "pd.DataFrame":
    """Run `gelgate lab study good-fraction`, or continue it, and give its rows; see docs/studies.md for the columns.

    fractions: in (0, 1].
    """
    options = Options(Path(dataset), Path(output), **asked)
    return _frame(study_good_fraction(options, fractions=fractions, shots=shots), "good-fraction")


def cross_position(
    dataset: Path | str, output: Path | str, *, target: str | None = None, **asked: Any
) -> "pd.DataFrame":
    """Run `gelgate lab study cross-position`, or continue it, and give its rows."""
    options = Options(Path(dataset), Path(output), **asked)
    return _frame(study_cross_position(options, target), "cross-position")


def bad_presses(dataset: Path | str, output: Path | str, **asked: Any) -> "pd.DataFrame":
    """Run `gelgate lab study bad-presses`, or continue it, and give its rows."""
    return _frame(study_bad_presses(Options(Path(dataset), Path(output), **asked)), "bad-presses")


def resolution(
    dataset: Path | str,
    output: Path | str,
    *,
    views: Sequence[str] = (),
    most_presses: int = MOST_PRESSES,
    **asked: Any,
) -> "pd.DataFrame":
    """Run `gelgate lab study resolution`, or continue it, and give its rows.

    views: some of `calibration.experiments.studies.views.VIEWS`, all if empty. most_presses: the cap of the pool.
    """
    options = Options(Path(dataset), Path(output), **asked)
    return _frame(study_resolution(options, views, most_presses), "resolution")


def _frame(rows: Rows, study: str) -> "pd.DataFrame":
    every = frame(rows.path)
    return every[every["study"] == study].dropna(axis=1, how="all").reset_index(drop=True)


def figure(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """The curves of a good-fraction study: by fraction if the rows have fractions, else by shots.

    rows: of one backbone, mode and split. Errors: ConfigError for several of them, or no row with this measure.
    """
    from calibration.experiments.harness.figures import draw_fractions, draw_overview, draw_shots

    setups = rows[["backbone", "mode", "split"]].drop_duplicates()
    if len(setups) != 1:
        found = "; ".join(", ".join(map(str, setup)) for setup in setups.to_numpy())
        raise ConfigError(
            f"a figure shows one backbone, mode and split, the rows have {found or 'none'}; select one"
        )
    scored = only_scored(rows)
    if measure not in scored or scored[measure].isna().all():
        raise ConfigError(f"no row has the measure '{measure}'; see the columns of the rows")
    if "fraction" not in scored or scored["fraction"].isna().all():
        return draw_shots(scored, measure)
    parts = sorted(set(scored["part"]))
    return draw_fractions(scored, parts[0], measure) if len(parts) == 1 else draw_overview(scored, measure)
