"""The operating points of a run: each axis varied around the usual settings of every method.

Around the usual point (20 presses, float32 trunk, low resolution) one axis at a time is varied, and the axes that
change both cost and accuracy most (trunk precision, presses) together. A full product would have thousands of points,
most of them between two others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Final

import numpy as np

from calibration.experiments.harness.pictures import LR_VIEW
from calibration.experiments.harness.study import require_known
from calibration.experiments.tradeoff.accuracy import Truth
from calibration.experiments.tradeoff.point import OperatingPoint, Setting
from calibration.experiments.tradeoff.presses import MOST, Chosen, choose_presses
from calibration.fitting.trunks import DEFAULT_BACKBONE
from calibration.metrics.summary import specimen_weights
from edge import registry
from edge.cli.arguments import add_argument, add_option
from edge.core.errors import ConfigError
from edge.core.suggest import suggestion

__all__ = ["BACKBONES", "LEAST_ROUNDS", "Run", "TradeoffArguments", "usual_points"]

BACKBONES: Final = (DEFAULT_BACKBONE, "tactile_resnet18", "tactile_resnet18_int8")
"""The trunks of a run without others: those that ship, the one that `gelgate fit` uses first."""

PRESSES: Final = (5, 10, 20, MOST)
"""Nominal presses of a fit; the third is the usual number."""

USUAL: Final = PRESSES[2]

BANKS: Final[dict[str, tuple[dict[str, Setting], ...]]] = {
    "padim": ({"rank": 4}, {"rank": 8}, {"rank": 32}, {"packing": "none"}, {"channels": 32}),
    "spade": ({"dims": (16,)}, {"dims": (32,)}, {"window_mm": 0.25}, {"window_mm": 1.0}, {"packing": "none"}),
    "fapm": ({"near_fraction": 0.05}, {"near_fraction": 0.25}, {"banks": "location"}, {"packing": "int8"}),
    "inreach": ({"most_rows": 256}, {"most_rows": 512}, {"most_rows": 2048}, {"dims": 32}),
    "patchcore": ({"most_rows": 256}, {"most_rows": 512}, {"most_rows": 2048}, {"dims": 32}),
    "subspace": ({"most_rank": 48}, {"most_rank": 96}, {"channels": 128}),
}
"""Parameters that set the size of each bank, how it is stored and how far a match may be."""

TILED: Final = ("padim", "patchcore")
"""The methods that are run on tiles: one that compares places, and one that does not."""

IN_ONE_PIECE: Final = ("padim", "fapm", "patchcore", "subspace")
"""The methods that are run on the high resolution in one piece."""

PAPER: Final = ("padim", "spade", "fapm", "patchcore")
"""The methods whose published settings this family of trunks can give (InReaCh needs other taps)."""


def usual_points(
    backbones: Sequence[str], methods: Sequence[str], *, most: int = MOST, with_high: bool = True
) -> tuple[OperatingPoint, ...]:
    """The points of a run. The first backbone is varied in every axis, the others with the usual settings.

    most: presses that can be fitted. with_high: whether there are high-resolution pictures.
    """
    points = (point for method in methods for point in _of_method(method, backbones))
    allowed = (point for point in points if point.presses <= most and (with_high or point.view == "lr"))
    return tuple(dict.fromkeys(allowed))


def _of_method(method: str, backbones: Sequence[str]) -> Iterator[OperatingPoint]:
    first = backbones[0]
    for presses in sorted(PRESSES, key=lambda n: n != USUAL):
        for backbone in backbones:
            yield OperatingPoint(method, backbone, presses=presses)
    for bank in BANKS.get(method, ()):
        yield OperatingPoint(method, first, settings=tuple(sorted(bank.items(), key=itemgetter(0))))
    if method in PAPER:
        yield OperatingPoint(method, first, mode="paper")
    if method in IN_ONE_PIECE:
        yield OperatingPoint(method, first, "hr")
    if method in TILED:
        yield from (OperatingPoint(method, first, view) for view in ("hr_tiles_0", "hr_tiles_56"))


LEAST_ROUNDS: Final = 7
"""Below this the interval of a median over rounds is as wide as the samples."""


@dataclass(frozen=True)
class TradeoffArguments:
    """What the command line says."""

    dataset: Path = add_argument(..., "the folder of presses, good ones and defective ones with masks")
    output: Path = add_option(
        Path("tradeoff"), "the folder for rows.jsonl and tradeoff.svg", "--output", "-o"
    )
    part: str | None = add_option(None, "the part; optional for a dataset of one part")
    position: str | None = add_option(None, "the position; optional for one position")
    method: list[str] | None = add_option(None, "a detector, again for more; by default every installed one")
    backbone: list[str] | None = add_option(
        None, "an installed backbone or a trunk .onnx file, the first varied in every axis, again for more"
    )
    within: str | None = add_option(
        None, "choose a point: most time from the settled frame to the verdict, such as 20ms"
    )
    under: str | None = add_option(None, "choose a point: largest bank, such as 8MB")
    presses: int | None = add_option(None, "choose a point: most nominal presses", min=1)
    point: str | None = add_option(None, "make only the bundle of the point of this name")
    bundle: Path | None = add_option(
        None, "where the chosen bundle is written, a folder or a name ending in .zip"
    )
    rounds: int = add_option(25, "rounds of timing", min=LEAST_ROUNDS)
    minutes: float = add_option(12.0, "after this many no new round of timing begins", min=0)
    bootstrap: int = add_option(200, "bootstrap replicates per accuracy interval", min=20)
    seed: int = add_option(0, "fixes every random choice", min=0)
    threads: int = add_option(2, "threads of the runtime", min=1, max=64)
    overwrite: bool = add_option(False, "measure again although the folder has rows; replace the bundle")


@dataclass(frozen=True)
class Run:
    """Points that are measured on presses."""

    given: TradeoffArguments
    chosen: Chosen
    points: tuple[OperatingPoint, ...]

    @classmethod
    def of(cls, given: TradeoffArguments) -> "Run":
        """Return the run of every point that the presses allow. Errors: DatasetError, ConfigError."""
        chosen = choose_presses(given.dataset, given.part, given.position, given.seed)
        known = registry.names("detectors")
        require_known("detector", given.method or (), known)
        most, with_high = len(chosen.fitted), bool(chosen.high)
        points = usual_points(
            given.backbone or BACKBONES, given.method or known, most=most, with_high=with_high
        )
        if not points:
            raise ConfigError(
                f"no operating point is left: the dataset gives {most} presses to fit, the smallest fit has "
                f"{PRESSES[0]}; press more good parts"
            )
        return cls(given, chosen, points)

    def point(self, key: str) -> OperatingPoint:
        """Return the point of a key. Errors: ConfigError with the nearest known key."""
        named = {point.key: point for point in self.points}
        if key not in named:
            raise ConfigError(f"no operating point is named '{key}'; {suggestion(key, named)}")
        return named[key]

    @cached_property
    def truth(self) -> Truth:
        """Labels and masks of the scored presses, and how replicates draw them."""
        label, rng = self.chosen.label, np.random.default_rng(self.given.seed)
        pieces = [str(press.specimen) for press in self.chosen.scored]
        drawn = specimen_weights(pieces, label, self.given.bootstrap, rng)
        return Truth(
            label,
            [LR_VIEW.mask(press) for press in self.chosen.scored],
            np.concatenate([np.ones((1, label.size)), drawn]),
        )
