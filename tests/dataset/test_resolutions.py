"""A data set in which some parts exist at one resolution only."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.dataset import open_dataset
from edge.core.errors import DatasetError


def put(path: Path, size: tuple[int, int]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.zeros((size[1], size[0], 3), np.uint8))


def test_parts_without_the_large_pictures_are_left_out_of_them(tmp_path: Path) -> None:
    """PZ1 has only 320x240: the large set is PZ3 alone, the small one both."""
    put(tmp_path / "PZ1/pos1/rgb_320x240/PZ1_pos1_s001_p01.png", (320, 240))
    put(tmp_path / "PZ3/pos1/rgb_320x240/PZ3_pos1_s001_p01.png", (320, 240))
    put(tmp_path / "PZ3/pos1/rgb/PZ3_pos1_s001_p01.png", (1280, 720))
    assert [press.part for press in open_dataset(tmp_path, "lr").presses] == ["PZ1", "PZ3"]
    assert [press.part for press in open_dataset(tmp_path, "hr").presses] == ["PZ3"]


def test_a_set_without_any_large_picture_is_refused_at_that_resolution(tmp_path: Path) -> None:
    """If no part has the resolution, every missing file is named."""
    put(tmp_path / "PZ1/pos1/rgb_320x240/PZ1_pos1_s001_p01.png", (320, 240))
    with pytest.raises(DatasetError, match="PZ1_pos1_s001_p01"):
        open_dataset(tmp_path, "hr")
