"""The picture of a press: nothing painted over the defect, everything a reader needs around it and in the file."""

import cv2
import numpy as np
import pytest

from edge.pictures.image_file import PictureForm, content_type, encode, texts
from edge.pictures.press_picture import (
    CELL,
    LARGEST_BYTES,
    SCALE_KEYWORDS,
    TEXT_KEYWORDS,
    PressCaption,
    draw_press,
    encode_press,
    encode_scores,
)

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
    sheet = draw_press(press(224, 224), with_defect(224, 224), CAPTION._replace(verdict=verdict))

    assert int(sheet[2, 2].argmax()) == channel


def test_a_threshold_below_zero_has_its_picture() -> None:
    """A negated likelihood: damage at -0.2 is above the threshold of -0.5, and is as bright as the other."""
    caption = CAPTION._replace(score=-0.2, threshold=-0.5)
    scores = np.where(with_defect(40, 56) > CAPTION.threshold, -0.2, -0.9)

    sheet = draw_press(press(40, 56), scores, caption)

    assert (sheet[HEADER:] == 255).all(axis=2).any()


@pytest.mark.parametrize("form", ["jpeg", "png"])
def test_the_file_says_what_it_shows(form: PictureForm) -> None:
    """Press id, verdict, score, threshold, mm per pixel, station, part and time are in the texts of either form; where
    regions are drawn, what they ignore; where heights are measured, the deviation."""
    plain = texts(encode_press(press(40, 56), with_defect(40, 56), CAPTION, form))
    drawn = CAPTION._replace(
        drawn="ignored: 3.0 mm2 of 9 mm2 contact; 1 ignore", deviation="0.10 ± 0.02 mm deep, 0.8 ± 0.1 mm"
    )
    data = encode_press(press(40, 56), with_defect(40, 56), drawn, form)

    found = texts(data)
    assert {*TEXT_KEYWORDS} - {*plain} == {"drawn", "deviation"}
    assert (found["drawn"], found["deviation"]) == (drawn.drawn, drawn.deviation)
    assert content_type(data) == f"image/{form}"
    assert tuple(found) == TEXT_KEYWORDS
    assert found["press_id"] == CAPTION.press_id
    assert found["verdict"] == "fail"
    assert found["threshold"] == "2"
    assert found["mm_per_pixel"] == "0.0634 0.0634"
    assert found["station"] == "plant/line1/Werk-Süd"


def test_the_file_with_texts_is_a_sound_png() -> None:
    """Every chunk's checksum holds: the decoder gives back the drawn pixels, red in the first channel."""
    rgb, scores = press(40, 56), with_defect(40, 56)
    decoded = cv2.imdecode(
        np.frombuffer(encode_press(rgb, scores, CAPTION, "png"), np.uint8), cv2.IMREAD_COLOR
    )

    assert np.array_equal(decoded[:, :, ::-1], draw_press(rgb, scores, CAPTION))


@pytest.mark.parametrize(
    "data",
    [
        b"GIF89a",
        b"",
        b"\xff\xd8\xff\xfe\x00\x04[]",
        b"\xff\xd8\xff\xfe\x00\x04\xff\xff",
        b"\xff\xd8\xff\xfe\xc3\x52" + b"[" * 50_000,
        b"\x89PNG\r\n\x1a\n\0\0\0\x01iTXtx\0\0\0\0",
    ],
)
def test_what_is_no_picture_of_a_press_has_no_texts(data: bytes) -> None:
    """It is refused by its first bytes, and by its comment."""
    with pytest.raises(ValueError):  # noqa: PT011 - the second is a fault of JSON, in its own words
        texts(data)


def test_a_comment_of_others_is_passed_over() -> None:
    """A JPEG whose comment ends with the file has no texts, and nothing is read beyond it."""
    assert texts(b"\xff\xd8\xff\xe0\x00\x04xx\xff\xfe") == {}


def read_scores(data: bytes) -> tuple[np.ndarray, dict[str, str]]:
    """As docs/subscribers.md reads it, with OpenCV."""
    levels, said = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), texts(data)
    assert levels.dtype == np.uint16
    return levels * float(said["step"]) + float(said["zero"]), said


@pytest.mark.parametrize("shift", [0.0, -1e4])
def test_a_program_reads_the_scores_from_the_map(shift: float) -> None:
    """Within half a step of 65535, each the largest of its cell, with a rest at the rim; the largest is the score. The
    scale in mm is that of a cell."""
    scores = np.random.default_rng(1).normal(shift, 3, (CELL * 9 + 3, CELL * 5)).astype(np.float32)

    read, said = read_scores(encode_scores(scores, CAPTION))

    cells = [
        [scores[CELL * r : CELL * (r + 1), CELL * c : CELL * (c + 1)].max() for c in range(5)]
        for r in range(10)
    ]
    assert np.abs(read - cells).max() <= float(said["step"]) / 2 * (1 + 1e-6)
    assert read.max() == pytest.approx(float(scores.max()), rel=1e-12)
    assert said["mm_per_pixel"] == f"{CELL * 0.0634:.6g} {CELL * 0.0634:.6g}"
    assert {*said} == {*TEXT_KEYWORDS, *SCALE_KEYWORDS} - {"drawn", "deviation"}


def test_a_map_of_one_score_has_no_step() -> None:
    read, said = read_scores(encode_scores(np.full((8, 8), 0.3, np.float32), CAPTION))
    assert (float(said["step"]), np.unique(read).tolist()) == (0.0, [np.float64(np.float32(0.3))])


def test_a_map_that_is_not_finite_is_refused() -> None:
    """It would be a map of another press's scale."""
    with pytest.raises(ValueError, match="finite"):
        encode_scores(np.array([[np.nan, 1.0]]), CAPTION)


def test_a_picture_of_another_size_is_refused() -> None:
    """The map belongs to the region, not to the frame."""
    with pytest.raises(ValueError, match="found uint8"):
        draw_press(press(40, 50), np.zeros((40, 56), np.float32), CAPTION)


def test_a_picture_that_does_not_compress_is_drawn_smaller() -> None:
    """Noise over the complete frame of the sensor: a broker that retains the picture never gets more than 2 MiB."""
    rgb = np.random.default_rng(1).integers(0, 256, (800, 800, 3), dtype=np.uint8)
    scores = np.random.default_rng(2).random((800, 800), np.float32)
    assert len(encode(draw_press(rgb, scores, CAPTION))) > LARGEST_BYTES

    picture = encode_press(rgb, scores, CAPTION, "png")

    assert LARGEST_BYTES // 8 < len(picture) <= LARGEST_BYTES
    assert texts(picture)["press_id"] == CAPTION.press_id
