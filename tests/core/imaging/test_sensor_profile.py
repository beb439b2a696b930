"""How a picture of another size becomes that of a profile."""

import pytest

from edge.core.imaging.sensor_profile import cut_in_words, cut_to_aspect


@pytest.mark.parametrize(
    ("size", "border", "words"),
    [
        ((640, 480), (0.0, 0.0), "640x480 scaled to 320x240"),
        ((640, 400), (1 / 12, 0.0), "640x400 cut to 533x400 in the middle and scaled to 320x240"),
        ((400, 600), (0.0, 0.25), "400x600 cut to 400x300 in the middle and scaled to 320x240"),
    ],
)
def test_what_exceeds_the_aspect_is_cut_from_both_sides(
    size: tuple[int, int], border: tuple[float, float], words: str
) -> None:
    """A picture of the same aspect, a wider one and a higher one."""
    assert cut_to_aspect(size, (320, 240)) == pytest.approx(border)
    assert cut_in_words(size, (320, 240)) == words
