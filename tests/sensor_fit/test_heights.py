"""`gelgate lab calibrate --heights`: from presses of a ball to heights that are as wrong as the file says."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from ball_presses import PLACES_MM, RADIUS_MM, frames, renderer, write_frames
from command_line import gelgate

from calibration.sensor_fit.ball import Ball, ball_height
from calibration.simulator.field_of_view import LR, grids
from edge.core.heights.height_map import measure_heights
from edge.heights.files import read_calibration

# A ball of another size, where none was pressed at calibration.
_OTHER_MM, _AT = 3.0, Ball(-2.5, 1.0, 0.35)


def test_another_ball_comes_back(tmp_path: Path) -> None:
    """Balls of 2 mm calibrate; the surface over a ball of 3 mm, which the simulator knows, lies within the stated
    uncertainty at 95 % of all places, and its top within a tenth."""
    presses, free = write_frames(tmp_path, frames(PLACES_MM))
    words = ("--no-contact", free, "--ball-radius-mm", RADIUS_MM, "--mm-per-px", LR.mm_per_px[0])
    done = gelgate(
        "lab", "calibrate", presses, "--heights", *words, "--serial", "2BNN4ZE7", "-o", tmp_path / "g.toml"
    )
    assert done.code == 0, done.err
    assert "6 balls of 2 mm held out; 95 % of all heights are within" in done.out
    made = read_calibration(tmp_path / "g.toml")
    assert (made.serial, made.scale_u95) == ("2BNN4ZE7", 0.01)
    assert made.made_on is not None
    height = ball_height(_AT, _OTHER_MM, *grids(LR))
    rgb = renderer().press(lambda _x, _y: height, 0.0, ("other",))
    free_rgb = cv2.cvtColor(cv2.imread(str(free)), cv2.COLOR_BGR2RGB).astype(np.uint8)
    found = measure_heights(rgb, free_rgb, made, "2BNN4ZE7")
    truth = renderer().surface(renderer().imprint(height, 0.0))
    assert found.heights_mm.max() == pytest.approx(truth.max(), rel=0.1)
    assert (np.abs(found.heights_mm - truth) <= found.u95_mm).mean() > 0.95


def test_a_gel_with_markers_is_refused(tmp_path: Path) -> None:
    presses, free = write_frames(tmp_path, frames(PLACES_MM[:3], markers=True))
    words = ("--no-contact", free, "--ball-radius-mm", RADIUS_MM, "-o", tmp_path / "g.toml")
    done = gelgate("lab", "calibrate", presses, "--heights", *words)
    assert "calibrate heights with a gel without markers" in done.sentence()
