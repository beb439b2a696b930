"""JPEG and PNG checked without decoding."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_recordings import jpeg

from edge.core.imaging.image_bytes import Freshness, comment, damage, kind, picture_size, with_comment


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("size", [(64, 48), (3, 500)])
def test_size_is_read_from_the_header(suffix: str, size: tuple[int, int]) -> None:
    """Width and height, in that order, also behind a comment, and of a JPEG behind bytes that fill."""
    payload = jpeg(0, size, suffix)
    assert picture_size(payload) == size
    if suffix == ".jpg":
        for filling in (b"\xff", b"\xff\xff", b"\xff\x01"):
            assert picture_size(payload[:2] + filling + payload[2:]) == size
    assert picture_size(with_comment(payload, "in front")) == size


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_complete_and_truncated(suffix: str) -> None:
    """A complete file has no damage; without its last or first byte it has."""
    payload = jpeg(0, suffix=suffix)
    assert damage(payload) is None
    assert damage(payload[:-1]) is not None
    assert damage(payload[1:]) is not None
    assert damage(b"") is not None


def test_padding_zeros_are_allowed_and_nothing_else() -> None:
    """Zeros after the end are accepted: some cameras fill the last packet with them."""
    assert damage(jpeg(0) + bytes(30)) is None
    assert damage(jpeg(0) + b"\0\x01") == "a JPEG with 2 bytes after its end marker"


@given(
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=60),
    st.sampled_from([".jpg", ".png"]),
)
def test_a_comment_is_read_back(text: str, suffix: str) -> None:
    """What is written in front is read there, and a picture without one has none."""
    assert comment(with_comment(jpeg(0, suffix=suffix), text)) == text
    assert comment(jpeg(0, suffix=suffix)) is None


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_comment_changes_no_pixel(suffix: str) -> None:
    payload = jpeg(0, suffix=suffix)
    plain, commented = (
        cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR)
        for one in (payload, with_comment(payload, "7"))
    )

    np.testing.assert_array_equal(commented, plain)


@given(st.binary(max_size=60), st.sampled_from([b"", b"\xff\xd8", b"\xff\xd8\xff\xc0", b"\x89PNG\r\n\x1a\n"]))
def test_any_bytes_are_answered(tail: bytes, start: bytes) -> None:
    """Random bytes are reported as damage, never an exception."""
    payload = start + tail
    assert (kind(payload) is None) <= (damage(payload) is not None)
    picture_size(payload)
    comment(payload)


def test_fresh_is_other_than_the_last_one() -> None:
    """A B B A: the second B is stale, the second A is not."""
    freshness = Freshness()
    assert [freshness.is_new(payload) for payload in (b"A", b"B", b"B", b"A")] == [True, True, False, True]
    assert freshness.stale == 1
