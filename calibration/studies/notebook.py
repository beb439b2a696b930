"""The studies from Python: results as a pandas frame, plots as matplotlib figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.progress import progress
from calibration.studies.good_fraction_study import FRACTIONS, HELD_OUT, SHOTS, study_good_fraction
from calibration.studies.page_parts import only_scored
from calibration.studies.rows import frame
from calibration.studies.runner import Show
from calibration.studies.study import Options, as_modes, as_splits
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["figure", "good_fraction"]


def good_fraction(
    dataset: Path | str,
    output: Path | str,
    *,
    parts: Sequence[str] = (),
    position: str | None = None,
    methods: Sequence[str] = (),
    modes: Sequence[str] = (),
    backbones: Sequence[str] = (),
    splits: Sequence[str] = (),
    seeds: int = 10,
    fractions: Sequence[float] = FRACTIONS,
    shots: Sequence[int] = SHOTS,
    held_out: int = HELD_OUT,
    jobs: int = 1,
    dask: str | None = None,
    cache: Path | None = None,
    show: Show = progress,
) -> "pd.DataFrame":
    """Run `gelgate study good-fraction`, or continue it, and give its rows; see docs/studies.md for the columns.

    Empty sequences are the command's defaults; fractions are in (0, 1]. Errors: as the command.
    """
    rows = study_good_fraction(
        Options(
            dataset=Path(dataset),
            output=Path(output),
            cache=cache,
            parts=tuple(parts),
            position=position,
            methods=tuple(methods),
            modes=as_modes(modes),
            backbones=tuple(backbones),
            splits=as_splits(splits),
            seeds=seeds,
            held_out=held_out,
            jobs=jobs,
            dask=dask,
            show=show,
        ),
        fractions=fractions,
        shots=shots,
    )
    every = frame(rows.path)
    return every[every["study"] == "good-fraction"].dropna(axis=1, how="all").reset_index(drop=True)


def figure(rows: "pd.DataFrame", measure: str = "aupro_001") -> "Figure":
    """The curves of a good-fraction study: by fraction if the rows have fractions, else by shots.

    rows: of one backbone, mode and split. Errors: ConfigError for several of them, or no row with this measure.
    """
    from calibration.studies.figures import fraction_figure, overview_figure, shots_figure

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
        return shots_figure(scored, measure)
    parts = sorted(set(scored["part"]))
    return fraction_figure(scored, parts[0], measure) if len(parts) == 1 else overview_figure(scored, measure)
