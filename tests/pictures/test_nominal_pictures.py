"""What a press was compared with: the nominal press most like it at its highest score, or the mean."""

import tracemalloc

import cv2
import numpy as np
import pytest

from edge.pictures.nominal_pictures import MOST_PICTURES, NominalPictures
from edge.pictures.press_picture import PressCaption, draw_press

MM = (0.1, 0.1)
CAPTION = PressCaption("", "fail", 3.0, 2.0, MM, "", "", "")


def gradient(level: int) -> np.ndarray:
    """A smooth press, uint8 (160, 160, 3): what a JPEG keeps to a level or two."""
    return np.full((160, 160, 3), level, np.uint8)


def two_halves() -> np.ndarray:
    """Dark as the first nominal press on the left, bright as the second on the right."""
    press = gradient(60)
    press[:, 80:] = 180
    return press


@pytest.mark.parametrize(("x", "name", "level"), [(20.0, "dark", 60), (140.0, "bright", 180)])
def test_it_is_the_press_most_like_it_around_the_highest_score(x: float, name: str, level: int) -> None:
    """Elsewhere each of the two differs by 120 levels."""
    pictures = NominalPictures.of(np.stack([gradient(60), gradient(180)]), ("dark", "bright"), is_mean=False)

    compared = pictures.compare(two_halves(), (x, 80.0), MM)

    assert compared.name == f"nominal press {name}"
    assert np.abs(compared.nominal - level).max() <= 2
    assert np.abs(compared.difference[:, 80:] - (180 - level)).max() <= 2
    assert np.abs(compared.difference[:, :80] - (60 - level)).max() <= 2


def test_a_method_that_holds_a_mean_shows_the_mean() -> None:
    """One picture, between the two presses; the difference has a sign."""
    pictures = NominalPictures.of(np.stack([gradient(60), gradient(180)]), ("dark", "bright"), is_mean=True)

    compared = pictures.compare(gradient(100), (0.0, 0.0), MM)

    assert pictures.names == ("the mean of 2 nominal presses",)
    assert np.abs(compared.nominal - 120).max() <= 2
    assert np.abs(compared.difference + 20).max() <= 2


def test_of_many_presses_some_are_shown_from_first_to_last() -> None:
    """A bundle of a thousand presses stays compact, and each picture stays itself beside its neighbours."""
    frames = np.stack([gradient(k) for k in range(250)])
    names = tuple(str(k) for k in range(250))

    pictures = NominalPictures.of(frames, names, is_mean=False)

    assert len(pictures.names) == MOST_PICTURES
    assert (pictures.names[0], pictures.names[-1]) == ("nominal press 0", "nominal press 249")
    for name in pictures.names[::9]:
        level = int(name.split()[-1])
        compared = pictures.compare(gradient(level), (80.0, 80.0), MM)
        assert abs(int(compared.name.split()[-1]) - level) <= 4  # levels of 4 apart are one picture to a JPEG
        assert np.ptp(compared.nominal) <= 2
    tracemalloc.start()
    pictures.compare(gradient(0), (80.0, 80.0), MM)
    assert (
        tracemalloc.get_traced_memory()[1] < 3 * MOST_PICTURES * gradient(0).nbytes
    )  # none but one in float32
    tracemalloc.stop()


def test_a_score_at_the_rim_of_a_flat_region_has_its_comparison() -> None:
    """The last pixel of 24 x 200, whose pictures are of another shape."""
    frames = np.random.default_rng(1).integers(0, 255, (3, 24, 200, 3), dtype=np.uint8)
    frames = np.stack([cv2.blur(one, (9, 9)) for one in frames])

    compared = NominalPictures.of(frames, ("a", "b", "c"), is_mean=False).compare(frames[1], (199, 23), MM)

    assert compared.name == "nominal press b"
    assert compared.nominal.shape == compared.difference.shape == (24, 200, 3)


def test_below_the_press_stand_the_nominal_one_and_the_difference() -> None:
    """The upper row is as without; grey says that nothing differs, and a bright place that the press is brighter."""
    scores = np.full((160, 160), 0.4, np.float32)
    scores[100:110, 20:30] = 3.0
    press = gradient(100)
    press[100:110, 20:30] = 140
    pictures = NominalPictures.of(gradient(100)[None], ("x",), is_mean=False)

    plain = draw_press(press, scores, CAPTION)
    sheet = draw_press(press, scores, CAPTION, compared=pictures.compare(press, (25, 105), MM))

    panel = plain.shape[0] - 40 - 28
    lower = sheet[40 + panel + 24 : -28]
    k = panel // 160
    assert np.array_equal(sheet[: 40 + panel], plain[: 40 + panel])
    assert lower.shape[0] == panel
    assert np.abs(lower[50 * k, : 160 * k].astype(int) - 100).max() <= 2
    assert np.abs(lower[50 * k, 160 * k + 8 : 320 * k].astype(int) - 128).max() <= 4
    assert np.abs(lower[105 * k, (160 + 25) * k + 8].astype(int) - (128 + 2 * 40)).max() <= 8
