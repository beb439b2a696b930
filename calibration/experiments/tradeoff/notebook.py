"""The trade-off from Python: its rows as a pandas frame. `figure.figure` draws them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.runner import Show
from calibration.experiments.tradeoff.plan import Run, RunSettings
from calibration.experiments.tradeoff.run import read_or_measure
from calibration.progress import progress

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["tradeoff"]


def tradeoff(
    dataset: Path | str,
    output: Path | str,
    *,
    methods: Sequence[str] = (),
    backbones: Sequence[str] = (),
    overwrite: bool = False,
    show: Show = progress,
    **asked: Any,
) -> "pd.DataFrame":
    """Run `gelgate lab tradeoff`, or read the rows that the folder holds; one row for each operating point.

    Nested fields are columns with dots, such as `accuracy.aupro_fpr01.value`. Empty sequences are the command's
    defaults. asked: further fields of `plan.RunSettings`, such as part, position or minutes.
    Errors: as the command; TypeError for another field.
    """
    import pandas as pd

    run = Run.of(RunSettings(Path(dataset), **asked), methods, backbones)
    return pd.json_normalize(read_or_measure(run, Path(output), overwrite, show, print))
