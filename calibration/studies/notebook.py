"""The studies from Python: results as a pandas frame, plots as matplotlib figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.progress import progress
from calibration.studies.good_fraction_study import FRACTIONS, HELD_OUT, SHOTS, study_good_fraction
from calibration.studies.page_parts import only_scored
from calibration.studies.rows import Rows, frame
from calibration.studies.runner import Show
from calibration.studies.stable import StableFractions
from calibration.studies.study import ROWS_FILE, Options, as_modes, as_splits
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["bad_presses", "cross_position", "figure", "good_fraction", "resolution"]


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
    """Run `gelgate lab study good-fraction`, or continue it, and give its rows; see docs/studies.md for the columns.

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
    return _rows_of(rows, "good-fraction")


def cross_position(
    dataset: Path | str,
    output: Path | str,
    *,
    target: str | None = None,
    fraction: float | None = None,
    **asked: Any,
) -> "pd.DataFrame":
    """Run `gelgate lab study cross-position`, or continue it, and give its rows.

    fraction: of the first position's presses, in (0, 1]; None is each method's stable one. asked: further fields of
    `calibration.studies.study.Options`, such as parts or seeds. Errors: as the command; TypeError for another field.
    """
    from calibration.studies.cross_position_study import STUDY, study_cross_position

    options = Options(dataset=Path(dataset), output=Path(output), **asked)
    return _rows_of(study_cross_position(options, _fractions(options, fraction), target), STUDY)


def bad_presses(
    dataset: Path | str, output: Path | str, *, fraction: float | None = None, **asked: Any
) -> "pd.DataFrame":
    """Run `gelgate lab study bad-presses`, or continue it, and give its rows.

    Arguments and errors: as `cross_position`.
    """
    from calibration.studies.bad_presses import STUDY, study_bad_presses

    options = Options(dataset=Path(dataset), output=Path(output), **asked)
    return _rows_of(study_bad_presses(options, _fractions(options, fraction)), STUDY)


def resolution(
    dataset: Path | str,
    output: Path | str,
    *,
    views: Sequence[str] = (),
    most_presses: int = 40,
    fraction: float | None = None,
    **asked: Any,
) -> "pd.DataFrame":
    """Run `gelgate lab study resolution`, or continue it, and give its rows. Arguments and errors: as `cross_position`.

    views: some of `calibration.studies.views.VIEWS`, all if empty. most_presses: the cap of the pool.
    """
    from calibration.studies.resolution_study import STUDY, study_resolution
    from calibration.studies.views import VIEWS

    options = Options(dataset=Path(dataset), output=Path(output), **asked)
    chosen = tuple(views) or tuple(VIEWS)
    return _rows_of(study_resolution(options, _fractions(options, fraction), chosen, most_presses), STUDY)


def _fractions(options: Options, given: float | None) -> StableFractions:
    return StableFractions(given, options.output / ROWS_FILE)


def _rows_of(rows: Rows, study: str) -> "pd.DataFrame":
    every = frame(rows.path)
    return every[every["study"] == study].dropna(axis=1, how="all").reset_index(drop=True)


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
