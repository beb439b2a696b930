"""Scores in colour: scaled by the threshold, calm where nothing happens, and never over what they mark."""

import numpy as np
import pytest

from edge.pictures.heatmap import FULL_SCALE, draw_contour, paint_scores, relative_scores, score_at


def lightness(rgb: np.ndarray) -> np.ndarray:
    """Relative luminance (ITU-R BT.709) of linearised sRGB."""
    linear = (rgb.astype(np.float64) / 255) ** 2.2
    return linear @ np.array([0.2126, 0.7152, 0.0722])


def test_the_colour_depends_on_score_over_threshold_alone() -> None:
    """Score 3 at threshold 2 looks like score 30 at threshold 20: presses of different parts compare."""
    scores = np.linspace(0, 4, 40 * 56, dtype=np.float32).reshape(40, 56)

    one, other = paint_scores(relative_scores(scores, 2.0)), paint_scores(relative_scores(scores * 10, 20.0))

    assert np.array_equal(one, other)


def test_the_same_score_has_the_same_colour_whatever_else_is_on_the_map() -> None:
    """One far outlier does not fade the rest of its map, as scaling by the maximum would."""
    scores = np.full((40, 56), 0.9, np.float32)
    with_outlier = scores.copy()
    with_outlier[:4, :4] = 50.0

    assert np.array_equal(paint_scores(with_outlier)[10:, 10:], paint_scores(scores)[10:, 10:])


def test_a_higher_score_is_never_darker() -> None:
    """From nothing to full scale the lightness rises: the colours order the scores in grey and to every eye."""
    ramp = paint_scores(np.linspace(0, FULL_SCALE, 256, dtype=np.float32)[None])[0]

    assert (np.diff(lightness(ramp)) > -1e-3).all()
    assert lightness(ramp)[0] < 0.01
    assert lightness(ramp)[-1] > 0.8


def test_a_near_miss_below_the_threshold_can_be_seen() -> None:
    """0.8 of the threshold is at least five times as light as a calm 0.3."""
    calm, near = lightness(paint_scores(np.array([[0.3, 0.8]], np.float32))[0])

    assert near > 5 * calm


def test_the_contour_runs_around_what_exceeds_the_threshold_and_covers_none_of_it() -> None:
    """A square above the threshold keeps its pixels; a white line of one pixel and a dark one lie outside it."""
    rgb = np.full((40, 56, 3), 90, np.uint8)
    relative = np.zeros((40, 56), np.float32)
    relative[10:20, 12:30] = 1.5
    draw_contour(rgb, relative)

    white = np.zeros((40, 56), bool)
    white[9:21, 11:31] = True
    white[10:20, 12:30] = False
    assert np.array_equal((rgb == 255).all(axis=2), white)
    assert (rgb[10:20, 12:30] == 90).all()
    assert (rgb[8, 10:32] == 0).all()


@pytest.mark.parametrize(
    ("threshold", "expected"), [(-2.0, [0.0, 0.5, 1.0, 2.0]), (0.0, [-3.0, -2.0, -1.0, 1.0])]
)
def test_a_threshold_that_is_not_positive_is_drawn_too(threshold: float, expected: list[float]) -> None:
    """Negated likelihoods and logits: 1 is the threshold, 0 and 2 are as far from it as it is from 0."""
    scores = np.array([[-4.0, -3.0, -2.0, 0.0]])

    relative = relative_scores(scores, threshold)

    assert relative.tolist() == [expected]
    assert [score_at(value, threshold) for value in expected] == scores[0].tolist()


@pytest.mark.parametrize("threshold", [float("nan"), float("inf")])
def test_a_threshold_without_scale_is_refused(threshold: float) -> None:
    with pytest.raises(ValueError, match="threshold"):
        relative_scores(np.ones((2, 2), np.float32), threshold)


def test_a_map_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="1 values"):
        relative_scores(np.array([[np.nan, 1.0]], np.float32), 1.0)
