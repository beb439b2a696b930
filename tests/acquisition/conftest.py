"""Sound presses of one simulated part: as pictures with their pieces, and as a recording."""

from pathlib import Path

import cv2
import pytest
from random_part_presses import RandomPartPresses

from edge.recording.from_images import PressLift, record_images

PRESSES = 12


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder `presses` with twelve pictures of six pieces, pressed twice each, and free.png next to it."""
    root = tmp_path_factory.mktemp("pictures")
    part = RandomPartPresses(99, 1, PRESSES)
    (root / "presses").mkdir()
    for k in range(PRESSES):
        name = f"bolt_pos1_s{k // 2:03d}_p{1 + k % 2:02d}.png"
        cv2.imwrite(str(root / "presses" / name), part.press(k // 2, 1 + k % 2, k)[..., ::-1])
    cv2.imwrite(str(root / "free.png"), part.free_gel(0)[..., ::-1])
    return root


@pytest.fixture(scope="session")
def recording(pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same presses as a recording of a sensor, without names of pieces."""
    folder = tmp_path_factory.mktemp("recording") / "recorded"
    record_images(
        folder,
        sorted((pictures / "presses").iterdir()),
        pictures / "free.png",
        PressLift(lead_frames=20, number_copies=True),
        product="GelSight Mini R0B 2BNN-4ZE7",
        serial="2BNN4ZE7",
        profile="cropped_lr",
    )
    return folder
