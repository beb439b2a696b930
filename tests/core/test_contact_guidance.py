"""What a hand is told: worked by hand on masks, and on simulated presses that lean to one side."""

import math
from typing import Any

import cv2
import numpy as np
import pytest

from edge.core.contact.mask import touched, touched_mask
from edge.core.contact.press_detector import Look
from edge.core.contact.reference import Reference
from edge.core.contact.relief import Relief, ReliefOfReference, reach
from edge.core.contact.settled_frame import Observation
from edge.core.contact.sight import Sight
from edge.core.contact.table import State
from edge.core.contact_guidance import Guidance, guide
from edge.core.contact_state import ContactState
from edge.core.imaging.quality import NominalContact

MIDDLE = NominalContact((0.4, 0.6), (0.4, 0.6), (0.05, 0.5))


def box(left: int, top: int, right: int, bottom: int) -> Any:
    mask = np.zeros((120, 160), bool)
    mask[top:bottom, left:right] = True
    return mask


REACH = box(50, 40, 110, 80)


FREE = np.full((120, 160, 3), 100, np.float32)
FLAT = ReliefOfReference(FREE).of(np.zeros_like(FREE), 3.5)


def look(mask: Any, relief: Relief | None = None) -> Look:
    seen = Observation(0, 7, touched(mask), 0.0, 0.0)
    return Look(0, (), State.SETTLING, Sight(), None, seen=seen, mask=mask, relief=relief or FLAT)


@pytest.mark.parametrize(
    ("state", "mask", "advice"),
    [
        ("pressing", REACH, Guidance("deeper")),
        ("deep_enough", REACH, Guidance("hold")),
        ("at_rest", REACH, Guidance("hold")),
        ("judged", REACH, Guidance("hold")),
        ("lift", REACH, Guidance("lift")),
        ("overload", REACH, Guidance("lift")),
        ("free", box(0, 0, 0, 0), None),
        ("touching", REACH, None),
        ("unknown", REACH, None),
        ("deep_enough", box(0, 40, 60, 80), Guidance("shift", 0.0)),
        ("deep_enough", box(100, 40, 160, 80), Guidance("shift", 180.0)),
        ("pressing", box(50, 0, 110, 40), Guidance("shift", 90.0)),
        ("pressing", box(50, 80, 110, 120), Guidance("shift", 270.0)),
        ("deep_enough", box(50, 40, 80, 80), Guidance("tilt", 0.0)),
        ("deep_enough", box(50, 58, 110, 80), Guidance("tilt", 270.0)),
        ("deep_enough", box(60, 46, 100, 74), Guidance("hold")),
        ("deep_enough", box(40, 40, 95, 80), Guidance("hold")),
        ("pressing", box(0, 0, 4, 4), Guidance("deeper")),
    ],
    ids=[
        "not deep enough",
        "deep enough",
        "at rest",
        "judged",
        "recorded",
        "too deep",
        "free",
        "not a press yet",
        "not seen",
        "too far left",
        "too far right",
        "too far up",
        "too far down",
        "the right side does not touch",
        "the upper side does not touch",
        "smaller on all sides",
        "a little to the left",
        "too little to tell",
    ],
)
def test_advice(state: ContactState, mask: Any, advice: Guidance | None) -> None:
    assert guide(state, look(mask), MIDDLE, box(46, 36, 114, 84)) == advice


def test_nothing_is_said_of_what_a_bundle_does_not_know() -> None:
    far = box(0, 40, 60, 80)
    assert guide("deep_enough", look(far), None, None) == Guidance("hold")


@pytest.mark.parametrize(("part", "degrees", "least"), [("PZ2", 4, 7), ("PZ3", 3, 7)])
def test_a_leaning_press_is_told_the_side_that_does_not_touch(part: str, degrees: float, least: int) -> None:
    """To eight sides: the advice is that side, within 45 degrees, or none, as for smaller parts. Upright presses, also
    lighter and deeper ones, and those that lie a millimetre away, are never told to lean."""
    from calibration.simulator.effects import DEFAULT_EFFECTS
    from calibration.simulator.field_of_view import LR
    from calibration.simulator.parts import PARTS
    from calibration.simulator.pose import Pose, sample
    from calibration.simulator.renderer import Renderer

    renderer, simulated = Renderer(LR, DEFAULT_EFFECTS), PARTS[part]
    height = next(iter(simulated.positions.values()))

    def view(pose: Pose | None, depth: float) -> Any:
        imprint = np.zeros(renderer.field.shape, np.float32)
        if pose is not None:
            imprint = renderer.imprint(sample(height, pose, renderer.field), simulated.depth_mm * depth)
        planes = renderer.light(renderer.surface(imprint, 200), 200)
        return cv2.resize(planes.transpose(1, 2, 0), (160, 120), interpolation=cv2.INTER_AREA)

    gel = Reference(np.asarray(view(None, 0), np.float32))
    structure = ReliefOfReference(gel.view)

    def press(pose: Pose, depth: float = 1.0) -> Look:
        added = gel.difference(np.asarray(view(pose, depth), np.float32))
        return look(touched_mask(added), structure.of(added, 3.5))

    middle = press(Pose())
    assert middle.mask is not None
    assert middle.relief is not None
    nominal = reach(middle.mask, middle.relief)
    upright = [press(Pose(), depth) for depth in (0.6, 0.8, 1.0, 1.2)]
    moved = [press(Pose((x, y))) for x, y in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))]
    assert [guide("deep_enough", one, None, nominal) for one in (*upright, *moved)] == [Guidance("hold")] * 8
    lean, told = math.tan(math.radians(degrees)), 0
    for side in np.arange(0, 360, 45):
        tilt = (lean * math.cos(math.radians(side)), lean * math.sin(math.radians(side)))
        found = guide("deep_enough", press(Pose(tilt=tilt)), None, nominal)
        assert found is not None
        if found.advice == "tilt":
            assert found.direction_deg is not None
            away = (found.direction_deg - side) % 360 - 180
            assert abs(away) <= 45, (side, found)
            told += 1
    print(part, degrees, told)
    assert told >= least
