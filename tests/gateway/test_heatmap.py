"""Heatmaps: scaled by the threshold, calm where nothing happens, exact in 16 bits."""

import cv2
import numpy as np
import pytest

from edge.gateway.heatmap import SIXTEEN_BIT_THRESHOLD, overlay, overlay_png, relative_scores, score_map_png


def press(h: int = 40, w: int = 56) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (h, w, 3), dtype=np.uint8)


def test_below_half_the_threshold_the_press_is_shown_as_it_is() -> None:
    """A calm map changes no pixel."""
    rgb = press()

    assert np.array_equal(overlay(rgb, np.full((40, 56), 0.49, np.float32), 1.0), rgb)


def test_the_colour_depends_on_score_over_threshold_alone() -> None:
    """Score 3 at threshold 2 looks like score 30 at threshold 20: presses of different parts compare."""
    rgb, scores = press(), np.linspace(0, 4, 40 * 56, dtype=np.float32).reshape(40, 56)

    assert np.array_equal(overlay(rgb, scores, 2.0), overlay(rgb, scores * 10, 20.0))


def test_the_same_score_has_the_same_colour_whatever_else_is_on_the_map() -> None:
    """One far outlier does not fade the rest of its map, as scaling by the maximum would."""
    rgb, scores = np.full((40, 56, 3), 90, np.uint8), np.full((40, 56), 0.9, np.float32)
    with_outlier = scores.copy()
    with_outlier[:4, :4] = 50.0

    assert np.array_equal(overlay(rgb, with_outlier, 1.0)[10:, 10:], overlay(rgb, scores, 1.0)[10:, 10:])


def test_a_line_runs_around_what_exceeds_the_threshold() -> None:
    """A square above the threshold has a white border, and no white elsewhere."""
    scores = np.zeros((40, 56), np.float32)
    scores[10:20, 12:30] = 1.5
    white = (overlay(np.zeros((40, 56, 3), np.uint8), scores, 1.0) == 255).all(axis=2)

    border = np.zeros_like(white)
    border[10:20, 12:30] = True
    border[11:19, 13:29] = False
    assert np.array_equal(white, border)


def test_black_and_white_pictures_do_not_wrap() -> None:
    """0 and 255 stay within uint8 at any opacity."""
    scores = np.full((8, 8), 99.0, np.float32)

    dark = overlay(np.zeros((8, 8, 3), np.uint8), scores, 1.0)
    light = overlay(np.full((8, 8, 3), 255, np.uint8), scores, 1.0)

    assert (light.astype(int) >= dark.astype(int)).all()


def test_the_png_decodes_to_the_overlay_with_its_colours_in_order() -> None:
    """The picture is RGB here and BGR inside OpenCV; the file has them right."""
    rgb, scores = press(), np.zeros((40, 56), np.float32)

    decoded = cv2.imdecode(np.frombuffer(overlay_png(rgb, scores, 1.0), np.uint8), cv2.IMREAD_COLOR)

    assert np.array_equal(decoded[:, :, ::-1], rgb)


def test_sixteen_bits_keep_scores_up_to_four_thresholds() -> None:
    """The threshold is 16384; negative scores are 0 and huge ones 65535."""
    scores = np.array([[-1.0, 0.0, 2.0, 4.0, 1e9]], np.float32)

    decoded = cv2.imdecode(np.frombuffer(score_map_png(scores, 2.0), np.uint8), cv2.IMREAD_UNCHANGED)

    assert decoded.dtype == np.uint16
    assert decoded.tolist() == [[0, 0, SIXTEEN_BIT_THRESHOLD, 2 * SIXTEEN_BIT_THRESHOLD, 65535]]


@pytest.mark.parametrize("threshold", [0.0, -1.0, float("nan"), float("inf")])
def test_a_threshold_without_scale_is_refused(threshold: float) -> None:
    """Nothing is divided by zero."""
    with pytest.raises(ValueError, match="threshold"):
        relative_scores(np.ones((2, 2), np.float32), threshold)


def test_a_map_that_is_not_finite_is_refused() -> None:
    """A NaN is an error, never a dark pixel."""
    with pytest.raises(ValueError, match="1 values"):
        relative_scores(np.array([[np.nan, 1.0]], np.float32), 1.0)


def test_a_picture_of_another_size_is_refused() -> None:
    """The map belongs to the region, not to the frame."""
    with pytest.raises(ValueError, match="found uint8"):
        overlay(press(40, 50), np.zeros((40, 56), np.float32), 1.0)
