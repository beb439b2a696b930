"""Frames cut into packets and joined again, complete or with their fault."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.devices.uvc.payload import FrameAssembler, Packet, ReceivedFrame, split_frame

# Bodies without FF cannot hold a marker, so every body makes a frame that is complete by its ends.
bodies = st.binary(max_size=400).map(lambda body: b"\xff\xd8" + body.replace(b"\xff", b"\x00") + b"\xff\xd9")
films = st.lists(bodies, min_size=1, max_size=6)
packet_sizes = st.integers(7, 96)


def cut(film: list[bytes], packet_bytes: int) -> list[list[Packet]]:
    return [
        list(split_frame(frame, fid=number & 1, pts=number * 1000, packet_bytes=packet_bytes))
        for number, frame in enumerate(film)
    ]


def flat(film: list[list[Packet]]) -> list[Packet]:
    return [packet for frame in film for packet in frame]


@given(films, packet_sizes)
def test_split_and_reassembled_is_the_same(film: list[bytes], packet_bytes: int) -> None:
    """Every frame comes back byte by byte, in order, with its time and no fault."""
    frames = FrameAssembler().feed(flat(cut(film, packet_bytes)))
    assert frames == [ReceivedFrame(frame, number * 1000) for number, frame in enumerate(film)]


@given(films, packet_sizes, st.data())
def test_an_error_bit_spoils_one_frame(film: list[bytes], packet_bytes: int, data: st.DataObject) -> None:
    """The frame with the flagged packet has a fault; all others are complete."""
    packets = cut(film, packet_bytes)
    sick = data.draw(st.integers(0, len(film) - 1))
    where = data.draw(st.integers(0, len(packets[sick]) - 1))
    packets[sick] = list(
        split_frame(film[sick], fid=sick & 1, pts=0, packet_bytes=packet_bytes, error_in=frozenset({where}))
    )
    frames = FrameAssembler().feed(flat(packets))
    assert [frame.fault is not None for frame in frames] == [number == sick for number in range(len(film))]


@given(films, packet_sizes, st.data())
def test_a_reported_loss_never_passes(film: list[bytes], packet_bytes: int, data: st.DataObject) -> None:
    """Whichever packets the controller reports lost, each delivered frame is a sent one or has a fault."""
    packets = flat(cut(film, packet_bytes))
    lost = data.draw(st.sets(st.integers(0, len(packets) - 1), max_size=4))
    received = [Packet(b"", arrived=False) if i in lost else packet for i, packet in enumerate(packets)]
    for frame in FrameAssembler().feed(received):
        assert frame.fault is not None or frame.payload in film


@given(films, packet_sizes, st.data())
def test_a_silent_loss_at_an_end_is_seen(film: list[bytes], packet_bytes: int, data: st.DataObject) -> None:
    """A first or last packet that is lost silently is detected by the missing JPEG marker or the toggled bit."""
    packets = cut(film, packet_bytes)
    sick = data.draw(st.integers(0, len(film) - 1))
    del packets[sick][data.draw(st.sampled_from([0, -1]))]
    for frame in FrameAssembler().feed(flat(packets)):
        assert frame.fault is not None or frame.payload in film


@given(films, packet_sizes)
def test_batches_do_not_matter(film: list[bytes], packet_bytes: int) -> None:
    """Packets one at a time give what all at once give."""
    packets = flat(cut(film, packet_bytes))
    one_by_one = FrameAssembler()
    assert [frame for packet in packets for frame in one_by_one.feed([packet])] == FrameAssembler().feed(
        packets
    )


def test_worked_by_hand() -> None:
    """Two packets: header 2, flags EOH|FID=0, then EOH|EOF; the frame is the bytes behind the headers."""
    packets = [Packet(b"\x02\x80\xff\xd8AB"), Packet(b""), Packet(b"\x02\x82CD\xff\xd9")]
    assert FrameAssembler().feed(packets) == [ReceivedFrame(b"\xff\xd8ABCD\xff\xd9")]


def test_joining_in_the_middle_of_a_frame() -> None:
    """The tail of a frame whose start was not seen is dropped, and the next frame is complete."""
    first, second = cut([b"\xff\xd8" + b"a" * 50 + b"\xff\xd9", b"\xff\xd8b\xff\xd9"], 16)
    frames = FrameAssembler().feed(first[2:] + second)
    assert [frame.payload for frame in frames] == [b"\xff\xd8b\xff\xd9"]
    assert frames[0].fault is None


def test_a_lost_end_is_found_by_the_toggled_bit() -> None:
    """Without its last packet the frame ends where the next one begins, and it is corrupt."""
    first, second = cut([b"\xff\xd8" + b"a" * 50 + b"\xff\xd9", b"\xff\xd8b\xff\xd9"], 16)
    frames = FrameAssembler().feed(first[:-1] + second)
    assert [frame.fault is None for frame in frames] == [False, True]


def test_longer_than_promised_is_corrupt() -> None:
    """dwMaxVideoFrameSize is the camera's own limit."""
    packets = flat(cut([b"\xff\xd8" + b"a" * 50 + b"\xff\xd9"], 64))
    (frame,) = FrameAssembler(max_frame_bytes=53).feed(packets)
    assert "promised at most 53" in (frame.fault or "")
    assert FrameAssembler(max_frame_bytes=54).feed(packets)[0].fault is None


def test_two_frames_without_a_boundary_are_corrupt() -> None:
    """An end and two toggles lost: one frame's bytes hold two pictures, detected by the second start marker."""
    body = b"\xff\xd8\xff\xe0" + b"a" * 20 + b"\xff\xd9"
    first, _, third = cut([body, body, body], 16)
    (frame,) = FrameAssembler().feed(first[:-1] + third)
    assert frame.fault == "two frames without a boundary"


def test_a_header_alone_begins_no_frame() -> None:
    """Cameras send headers without bytes between frames; the start that follows one is the first, not a second."""
    body = b"\xff\xd8\xff\xe0" + b"a" * 20 + b"\xff\xd9"
    packets = flat(cut([body], 16))
    (frame,) = FrameAssembler().feed([Packet(packets[0].data[:6]), *packets])
    assert frame.fault is None
    assert frame.payload == body


@pytest.mark.parametrize("data", [b"\x01", b"\x00\x80", b"\xff\x80abc"])
def test_a_header_that_cannot_be_is_a_fault(data: bytes) -> None:
    """A header shorter than two bytes or longer than its packet invalidates the frame."""
    packets = flat(cut([b"\xff\xd8" + b"a" * 50 + b"\xff\xd9"], 16))
    (frame,) = FrameAssembler().feed([*packets[:2], Packet(data), *packets[2:]])
    assert "header" in (frame.fault or "")
