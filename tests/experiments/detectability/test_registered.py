"""Trials with a bundle that registers its presses."""

from typing import cast

import numpy as np
import turned_parts as parts
from numpy.typing import NDArray
from registered_bundle import registered

from calibration.experiments.detectability.judges import Judge
from calibration.fitting.damage.damage import Damage
from calibration.fitting.damage.rendering import EditedPress
from edge.core.registration.pose import Pose
from edge.model.scorer import Scorer


class UnrecognisedPress:
    """Damage so large that the part is not recognised any more."""

    def render(self, damage: Damage) -> NDArray[np.uint8]:
        return parts.press(parts.OTHER, Pose(2.0, 3.0, 0.2))


def test_a_press_that_is_not_recognised_finds_no_damage() -> None:
    """It is rejected, which is neither a pass nor found damage, and no error of the trial."""
    judge = Judge(Scorer(registered().bundle()), registered().manifest)

    assert not judge.finds(cast(EditedPress, UnrecognisedPress()), cast(Damage, None))
