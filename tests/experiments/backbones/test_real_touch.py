"""Real touch: sensors apart, no held-out press learnt, small edits, and a sentence where frames are missing."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from real_touch import EDITS, OBJECTS, SENSORS, real_touch_sets, real_touch_trial

from edge.core.errors import DatasetError

DEVELOPMENT, JUDGEMENT = SENSORS["real-touch"], SENSORS["real-touch-judgement"]


def test_sensors_are_apart() -> None:
    """No sensor is in both sets, every object's sensor is in one, with a licence; GPL frames are not for training."""
    assert set(SENSORS) == {"real-touch", "real-touch-judgement"}
    assert not DEVELOPMENT.keys() & JUDGEMENT.keys()
    assert {chosen.sensor for chosen in OBJECTS} == DEVELOPMENT.keys() | JUDGEMENT.keys()
    for licence in (*DEVELOPMENT.values(), *JUDGEMENT.values()):
        assert licence.startswith(("MIT", "GPL-3.0; measured, never trained on"))


def test_missing_frames_are_a_sentence(tmp_path: Path) -> None:
    """A folder without a sensor, a sensor without presses: said, never an empty table. Judgement is opened by name."""
    (tmp_path / "rpl-cmu__gelslam").mkdir()
    with pytest.raises(DatasetError, match=r"^no frames of skleff1994__gs_sdk, gelsightinc__gsrobotics"):
        real_touch_sets(tmp_path)
    for sensor in (*DEVELOPMENT, *JUDGEMENT):
        (tmp_path / sensor).mkdir(parents=True, exist_ok=True)
    assert {name: len(of.trials) for name, of in real_touch_sets(tmp_path).items()} == {"real-touch": 8}
    assert len(real_touch_sets(tmp_path, ["real-touch-judgement"])["real-touch-judgement"].trials) == 1
    for name in ("ball 6.31 mm, anywhere", "finger on a marker gel"):
        with pytest.raises(DatasetError, match=r"fetch (them|it) again"):
            real_touch_trial(tmp_path, name)


@pytest.mark.parametrize("chosen", OBJECTS, ids=lambda chosen: chosen.name)
def test_held_out_presses_are_not_learnt(chosen: object, real_tactile: Path) -> None:
    """No scored frame is learnt; edits are of held-out presses, one region each, of 20 pixels at most across."""
    found = real_touch_trial(real_tactile, chosen.name, edits=8)  # type: ignore[attr-defined]
    damaged = found.masks.any(axis=(1, 2))
    learnt = {frame.tobytes() for frame in found.nominal.frames}
    assert not learnt & {frame.tobytes() for frame in found.frames}
    assert damaged.sum() == 8
    sound = found.frames[~damaged].astype(int)
    for frame, mask in zip(found.frames[damaged].astype(int), found.masks[damaged], strict=True):
        assert cv2.connectedComponents(mask.astype(np.uint8))[0] == 2
        assert max(np.ptp(axis) for axis in np.nonzero(mask)) <= 20
        changed = np.abs(sound - frame).max(axis=3)
        nearest = changed[(changed > 0).sum(axis=(1, 2)).argmin()]
        assert nearest[mask].max() >= 20
        assert not nearest[~cv2.dilate(mask.astype(np.uint8), np.ones((25, 25))).astype(bool)].any()


def test_a_trial_is_the_same_every_time(real_tactile: Path) -> None:
    """Two calls give the same frames and masks, and 48 edits without a number."""
    one, other = (real_touch_trial(real_tactile, "ball 6.31 mm, registered") for _ in range(2))
    assert np.array_equal(one.frames, other.frames)
    assert np.array_equal(one.masks, other.masks)
    assert one.masks.any(axis=(1, 2)).sum() == EDITS
