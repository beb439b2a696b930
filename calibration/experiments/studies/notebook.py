"""The studies from Python: results as a pandas frame, plots as matplotlib figures."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.page import only_scored
from calibration.experiments.harness.rows import frame
from calibration.experiments.harness.study import Options, require_known
from calibration.experiments.studies.every_study import STUDIES
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["figure", "study"]


def study(name: str, dataset: Path | str, output: Path | str, **asked: Any) -> "pd.DataFrame":
    """Run `gelgate lab study NAME`, or continue it, and give its rows; see docs/studies.md for the columns.

    asked: fields of `calibration.experiments.harness.study.Options`, such as parts or seeds; what is empty is the
    command's default. Errors: as the command; TypeError for another field.
    """
    require_known("study", [name], STUDIES)
    every = frame(STUDIES[name](Options(Path(dataset), Path(output), **asked)).path)
    return every[every["study"] == name].dropna(axis=1, how="all").reset_index(drop=True)


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
