"""The probe block and the format descriptors."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.devices.uvc.uvc import StreamControl, mjpeg_modes
from plugins.devices.virtual.descriptors import WEBCAM, interface_descriptor

BLOCKS = st.builds(
    StreamControl,
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    st.integers(0, 0xFFFF),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
)


@given(BLOCKS, st.sampled_from([26, 34, 48]))
def test_block_packs_and_unpacks(block: StreamControl, size: int) -> None:
    """26 bytes for UVC 1.0, 34 from 1.1, 48 in 1.5; nothing is lost on the way."""
    packed = block.pack(size)
    assert len(packed) == size
    assert StreamControl.unpack(packed) == block


def test_block_by_hand() -> None:
    """Interval 400000 (25 fps) at byte 4, the frame limit at byte 18, the payload limit at byte 22."""
    packed = StreamControl(1, 2, 400_000, max_frame_bytes=0x01020304, max_payload_bytes=3072).pack()
    assert packed[2:4] == b"\x01\x02"
    assert packed[4:8] == b"\x80\x1a\x06\x00"
    assert packed[18:22] == b"\x04\x03\x02\x01"
    assert packed[22:26] == b"\x00\x0c\x00\x00"


def test_short_block_is_refused() -> None:
    """Less than 26 bytes is refused."""
    with pytest.raises(ValueError, match="found 25"):
        StreamControl.unpack(bytes(25))


def test_modes_of_the_sibling_board() -> None:
    """Five MJPEG modes at 30 fps, read from the bytes that the virtual webcam shows."""
    modes = mjpeg_modes(interface_descriptor(WEBCAM, 1, 0).extra_descriptors)
    sizes = [(mode.width, mode.height) for mode in modes]
    assert sizes == [(320, 240), (640, 480), (1280, 720), (1600, 1200), (1920, 1080)]
    assert {round(mode.nominal_fps, 2) for mode in modes} == {30.0}


@pytest.mark.parametrize("cut", [1, 5, 20, 29])
def test_descriptor_that_runs_past_the_end_is_refused(cut: int) -> None:
    """A truncated block of descriptors is an error, not fewer modes."""
    extra = interface_descriptor(WEBCAM, 1, 0).extra_descriptors
    with pytest.raises(ValueError, match="left"):
        mjpeg_modes(extra[: 14 + 11 + cut])


def test_a_format_that_is_too_short_is_refused() -> None:
    """Three bytes have no index."""
    with pytest.raises(ValueError, match="11 bytes, found 3"):
        mjpeg_modes(bytes([3, 0x24, 0x06]))


@given(st.binary(max_size=80))
def test_any_bytes_are_read_or_refused(extra: bytes) -> None:
    """Random bytes from a device raise nothing but ValueError."""
    try:
        mjpeg_modes(extra)
    except ValueError:
        return
