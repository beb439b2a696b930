"""The fit of the acquired presses: as a command to copy, or at once."""

import math
import shlex
from dataclasses import dataclass
from pathlib import Path

from calibration.acquisition.stopping import Standing

__all__ = ["Plan", "alpha", "fit_command", "fit_now"]

USUAL_ALPHA = 0.05


@dataclass(frozen=True)
class Plan:
    """What was acquired and how it is seen, in the words of `fit`."""

    part: str
    position: str
    profile: str
    region: str
    method: str
    backbone: str
    resize: bool


def alpha(standing: Standing) -> float:
    """The rate to ask `fit` for, so that no nominal press lies above its threshold: the promise counts on that.

    1 / (pieces + 1), rounded up, is the largest rate that puts the threshold at the highest score.
    """
    pieces = standing.presses if standing.pieces is None else standing.pieces
    return min(USUAL_ALPHA, math.ceil(1e4 / (pieces + 1)) / 1e4)


def fit_command(folder: Path, plan: Plan, standing: Standing) -> str:
    """The command line that fits the acquired presses."""
    words = ["gelgate", "fit", str(folder / "presses"), "-o", f"{plan.part}.bundle"]
    if any((folder / "free").iterdir()):
        words += ["--no-contact", str(folder / "free")]
    words += ["--part", plan.part, "--position", plan.position, "--profile", plan.profile]
    words += ["--region", plan.region, "--method", plan.method, "--backbone", plan.backbone]
    words += ["--alpha", f"{alpha(standing):g}"] + ["--resize"] * plan.resize
    return shlex.join(words)


def fit_now(folder: Path, plan: Plan, standing: Standing, output: Path, threads: int) -> None:
    """Fit the acquired presses and print the summary. Errors: as `gelgate fit`."""
    from calibration.fitting.command import fit

    fit(
        [folder / "presses"],
        output,
        part=plan.part,
        position=plan.position,
        method=plan.method,
        backbone=plan.backbone,
        profile=plan.profile,
        region=plan.region,
        alpha=alpha(standing),
        no_contact=[folder / "free"] if any((folder / "free").iterdir()) else None,
        resize=plan.resize,
        threads=threads,
    )
