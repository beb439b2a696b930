"""The picture of a press: nothing painted over the defect, everything a reader needs around it and in the file."""

import cv2
import numpy as np
import pytest

from edge.pictures import png
from edge.pictures.press_picture import LARGEST_BYTES, TEXT_KEYWORDS, PressCaption, draw_press, press_png

CAPTION = PressCaption(
    press_id="01ARZ3NDEKTSV4RRFFQ69G5FAV",
    verdict="fail",
    score=3.0,
    threshold=2.0,
    mm_per_pixel=(0.0634, 0.0634),
    station="plant/line1/Werk-Süd",
    part="bolt/top",
    time="2026-01-31T12:00:00.000250Z",
)
HEADER = 40


def press(h: int, w: int) -> np.ndarray:
    return np.random.default_rng(1).integers(60, 196, (h, w, 3), dtype=np.uint8)


def with_defect(h: int, w: int) -> np.ndarray:
    scores = np.full((h, w), 0.4, np.float32)
    scores[h // 4 : h // 4 + 12, w // 2 : w // 2 + 16] = 3.0
    return scores


def test_every_pixel_of_the_defect_is_as_the_sensor_saw_it() -> None:
    """Inside the contour, at twice the size, the left panel is the press itself, however strong the score is."""
    rgb = press(224, 224)
    sheet = draw_press(rgb, with_defect(224, 224), CAPTION)

    panel = sheet[HEADER : HEADER + 448, :448]
    assert np.array_equal(
        panel[112 + 4 : 112 + 20, 224 + 4 : 224 + 28],
        np.kron(rgb, np.ones((2, 2, 1), np.uint8))[112 + 4 : 112 + 20, 224 + 4 : 224 + 28],
    )


def test_a_sound_press_is_not_drawn_on_but_for_the_scale() -> None:
    """Above the scale bar every pixel of the left panel is the sensor's."""
    rgb = press(224, 224)
    sheet = draw_press(rgb, np.full((224, 224), 0.5, np.float32), CAPTION._replace(verdict="pass", score=0.5))

    assert np.array_equal(sheet[HEADER : HEADER + 400 : 2, 0:448:2], rgb[:200])


def test_a_squeezed_axis_is_drawn_true() -> None:
    """1280x720 of a profile that squeezes rows by 4/3 has panels of 800x600: a circle on the part is a circle."""
    caption = CAPTION._replace(mm_per_pixel=(0.0159, 0.0159 * 4 / 3))
    sheet = draw_press(press(720, 1280), with_defect(720, 1280), caption)

    above = (sheet[HEADER : HEADER + 600, :800] == 255).all(axis=2)
    assert sheet.shape == (HEADER + 600 + 28, 2 * 800 + 8 + 112, 3)
    assert above.any()


def test_the_scale_bar_is_as_long_as_it_says() -> None:
    """At 0.0634 mm per pixel, enlarged twice, 2 mm are 63 pixels; the bar's white part is that long."""
    sheet = draw_press(np.zeros((224, 224, 3), np.uint8), np.zeros((224, 224), np.float32), CAPTION)

    row = sheet[HEADER + 448 - 12 - 2, :448]
    assert int((row == 255).all(axis=1).sum()) == round(2 / 0.0317)


@pytest.mark.parametrize(("verdict", "channel"), [("pass", 1), ("fail", 0)])
def test_the_verdict_has_its_colour(verdict: str, channel: int) -> None:
    """Green for a pass, red for a fail."""
    sheet = draw_press(press(224, 224), with_defect(224, 224), CAPTION._replace(verdict=verdict))

    assert int(sheet[2, 2].argmax()) == channel


def test_a_threshold_below_zero_has_its_picture() -> None:
    """A negated likelihood: damage at -0.2 is above the threshold of -0.5, and is as bright as the other."""
    caption = CAPTION._replace(score=-0.2, threshold=-0.5)
    scores = np.where(with_defect(40, 56) > CAPTION.threshold, -0.2, -0.9)

    sheet = draw_press(press(40, 56), scores, caption)

    assert (sheet[HEADER:] == 255).all(axis=2).any()


def test_the_file_says_what_it_shows() -> None:
    """Press id, verdict, score, threshold, mm per pixel, station, part and time are in the PNG's text chunks."""
    data = press_png(press(40, 56), with_defect(40, 56), CAPTION)

    found = png.texts(data)
    assert tuple(found) == TEXT_KEYWORDS
    assert found["press_id"] == CAPTION.press_id
    assert found["verdict"] == "fail"
    assert found["threshold"] == "2"
    assert found["mm_per_pixel"] == "0.0634 0.0634"
    assert found["station"] == "plant/line1/Werk-Süd"


def test_the_file_with_texts_is_a_sound_png() -> None:
    """Every chunk's checksum holds: the decoder gives back the drawn pixels, red in the first channel."""
    rgb, scores = press(40, 56), with_defect(40, 56)
    decoded = cv2.imdecode(np.frombuffer(press_png(rgb, scores, CAPTION), np.uint8), cv2.IMREAD_COLOR)

    assert np.array_equal(decoded[:, :, ::-1], draw_press(rgb, scores, CAPTION))


def test_what_is_no_png_has_no_texts() -> None:
    """A JPEG is refused by its first bytes."""
    with pytest.raises(ValueError, match="not a PNG"):
        png.texts(b"\xff\xd8\xff\xe0")


def test_a_picture_of_another_size_is_refused() -> None:
    """The map belongs to the region, not to the frame."""
    with pytest.raises(ValueError, match="found uint8"):
        draw_press(press(40, 50), np.zeros((40, 56), np.float32), CAPTION)


def test_a_picture_that_does_not_compress_is_drawn_smaller() -> None:
    """Noise over the complete frame of the sensor: a broker that retains the picture never gets more than 2 MiB."""
    rgb = np.random.default_rng(1).integers(0, 256, (800, 800, 3), dtype=np.uint8)
    scores = np.random.default_rng(2).random((800, 800), np.float32)
    assert len(png.encode(draw_press(rgb, scores, CAPTION))) > LARGEST_BYTES

    picture = press_png(rgb, scores, CAPTION)

    assert LARGEST_BYTES // 8 < len(picture) <= LARGEST_BYTES
    assert png.texts(picture)["press_id"] == CAPTION.press_id
