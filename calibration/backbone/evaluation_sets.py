"""What a backbone is judged on: presses of parts, damage and sensors that training never draws, and real frames.

Every set is a list of trials that can be made in any process. Simulated ones come from `evaluation_presses`, pictures
of real things from `evaluation_pictures`, whose folders are no part of the product.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.presses import NominalPresses
from edge.core.profiles import profile
from edge.core.region import Region

__all__ = ["FORMAT", "PROFILE", "REGION", "SETS", "EvaluationSet", "Trial", "evaluation_sets"]

# Of the evaluation's file; 1 and 2 had other sets.
FORMAT = 3

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)


@dataclass(frozen=True)
class Trial:
    """One position of one part: what a detector learns, and what it then scores.

    frames: uint8 (n, h, w, 3). masks: bool (n, h, w), all False where nothing was done to the press. is_foreign: bool
    (n,), frames of another kind of sensor, which have no mask and count as neither sound nor damaged.
    """

    name: str
    nominal: NominalPresses
    frames: NDArray[np.uint8]
    masks: NDArray[np.bool_]
    is_foreign: NDArray[np.bool_]


@dataclass(frozen=True)
class EvaluationSet:
    """Trials whose measures are averaged.

    text: what they are, and what they cannot say. is_brief: only the first backbone and random weights are compared
    on it. missing: why there are no trials, empty when there are.
    """

    title: str
    text: str
    trials: tuple[Callable[[], Trial], ...]
    is_brief: bool = False
    missing: str = ""

    def __post_init__(self) -> None:
        if bool(self.trials) == bool(self.missing):
            raise ValueError(f"set '{self.title}' has trials or a reason for having none")


SETS = (
    "random-parts",
    "parts",
    "sensor",
    "worn-gel",
    "marker-gel",
    "residual-imprint",
    "sliding-press",
    "registered-presses",
    "real-presses",
    "screws",
)
"""The names of the sets, in the order of the tables."""


def evaluation_sets(real_tactile: Path | None, screws: Path | None) -> dict[str, EvaluationSet]:
    """Every set by its name in `SETS`. real_tactile, screws: folders of real frames, None or absent to do without."""
    from calibration.backbone.evaluation_pictures import (
        BALLS,
        REGISTERED_BALLS,
        ball_trial,
        registered_ball_trial,
        screw_trial,
    )
    from calibration.backbone.evaluation_presses import PARTS, development_trial, part_trial

    few = tuple(part for part in PARTS if part in ("PZ1", "PZ4", "PZ5"))
    balls = _missing(real_tactile, "real tactile frames", "--tactile")
    optical = _missing(screws, "pictures of screws", "--screws")
    return {
        "random-parts": EvaluationSet(
            "Random parts, on which the methods' settings were chosen",
            "Six random parts, none of them drawn in training: 24 nominal presses of six pieces, then 16 sound presses "
            "of four other pieces and 16 damaged ones. The detectors' settings were chosen on these presses, so the "
            "sets below are the ones to judge by.",
            tuple(partial(development_trial, number) for number in range(6)),
        ),
        "parts": EvaluationSet(
            "Unseen parts",
            "The analogues PZ1 to PZ5 on a sensor that training varies: neither the parts nor their kinds of damage "
            "are ever drawn in training. That finer taps serve better was first seen here, with earlier weights; every "
            "setting was then chosen on the random parts above.",
            tuple(partial(part_trial, part) for part in PARTS),
        ),
        "sensor": EvaluationSet(
            "Unseen parts on an unseen sensor",
            "The same parts on a sensor whose colours training never mixes, and presses that lean over "
            "(partial contact), which training never draws.",
            tuple(partial(part_trial, part, "unseen sensor") for part in PARTS),
        ),
        "worn-gel": EvaluationSet(
            "A worn gel",
            "Learnt on a gel after 700 presses, scored after 900 of a rated 1000: new scratches, stains and dust are "
            "on every scored press and in none that was learnt.",
            tuple(partial(part_trial, part, "worn gel") for part in few),
            is_brief=True,
        ),
        "marker-gel": EvaluationSet(
            "A marker gel",
            "A tracking gel with its grid of dark dots, in the presses that are learnt and in those that are scored.",
            tuple(partial(part_trial, part, "marker gel") for part in few),
            is_brief=True,
        ),
        "residual-imprint": EvaluationSet(
            "A gel that remembers",
            "Each press comes three seconds after one on another place of the part, whose imprint has not gone yet.",
            tuple(partial(part_trial, part, "residual imprint") for part in few),
            is_brief=True,
        ),
        "sliding-press": EvaluationSet(
            "Pressed before it is at rest",
            "Scored presses slide at 5 mm/s in any direction, 0.09 mm in an exposure of 18 ms; learnt ones have "
            "settled. Training never draws motion blur.",
            tuple(partial(part_trial, part, "sliding press") for part in few),
            is_brief=True,
        ),
        "registered-presses": EvaluationSet(
            "Real presses, registered",
            "Presses of two steel balls on two GelSight Mini sensors, each cut about its contact, so that the ball "
            "lies at one place as on a fixture. What stays is real: the light of another place of the gel in every "
            "press, its grain and scratches; cuts beside a speck that the free gel shows are left out, for on a "
            "fixture it is learnt. Damage is a smooth bump or hollow of 0.02 to 0.06 mm rendered into the real press, "
            "at three places of each held-out one. Read the image AUROC: its blurred edge alone is more than one per "
            "cent of a region of 96 pixels a side, which keeps AU-PRO low.",
            tuple(partial(registered_ball_trial, real_tactile, b) for b in REGISTERED_BALLS)
            if real_tactile and not balls
            else (),
            missing=balls,
        ),
        "real-presses": EvaluationSet(
            "Real presses anywhere",
            "The whole pictures of such presses, of three balls. Here the ball is pressed at many places, so the "
            "nominal scatter is far wider than that of a part on a fixture, and methods that compare place with place "
            "have little to hold on to; public frames of a part pressed again and again at one place were not found. "
            "Damage is 0.05 to 0.12 mm high. "
            "Foreign frames are of other kinds of sensor, and foreign_out is the share of them that scores above every "
            "sound held-out press. Intervals are wide: a dozen presses each.",
            tuple(partial(ball_trial, real_tactile, b) for b in BALLS) if real_tactile and not balls else (),
            missing=balls,
        ),
        "screws": EvaluationSet(
            "Screws under a camera",
            "Optical pictures of screws that lie turned at random (a subset of MVTec AD), as a check of the detectors "
            "and not of touch: the backbone has never seen an optical picture, methods that compare place with place "
            "have nothing to hold on to, a picture is shrunk from 1024 to 224 pixels a side, and the physical sizes of "
            "the settings mean nothing here. Image AUROC moves about with the smallest change of weights: it says "
            "nothing for or against one of them.",
            () if optical or screws is None else (partial(screw_trial, screws),),
            missing=optical,
        ),
    }


def _missing(folder: Path | None, what: str, option: str) -> str:
    if folder is None:
        return f"no folder of {what} was given ({option})"
    return "" if folder.is_dir() else f"there is no folder of {what} at the place given with {option}"
