"""The faults of a virtual sensor, scripted by frame number or injected while it runs."""

from dataclasses import dataclass
from typing import Literal, Self, cast, get_args

__all__ = ["Fault", "FaultKind"]

FaultKind = Literal["drop", "stall", "error_bit", "lost_packet", "truncate", "stale", "unplug"]


@dataclass(frozen=True)
class Fault:
    """One fault at one frame. Frames are numbered from 0 in the order of sending, over loops and re-plugs.

    drop: this frame is never sent. stall: nothing is sent for `seconds`, or until the stream is started again when 0.
    error_bit: one packet carries UVC's error bit. lost_packet: the host controller reports one packet as not arrived.
    truncate: the second half of the JPEG is missing. stale: the previous frame is sent again instead. unplug: the
    sensor leaves the bus for `seconds`, or until `plug_in` when 0.
    """

    kind: FaultKind
    frame: int
    seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(FaultKind):
            raise ValueError(f"a fault is one of {', '.join(get_args(FaultKind))}, found '{self.kind}'")
        if self.frame < 0 or self.seconds < 0:
            raise ValueError(
                f"a fault's frame and seconds are not negative, found {self.frame} and {self.seconds}"
            )

    @classmethod
    def parse(cls, text: str) -> Self:
        """`stall@12:2.5` is a stall of 2.5 seconds at frame 12. Errors: ValueError."""
        name, at, rest = text.partition("@")
        frame, _, seconds = rest.partition(":")
        if not at or not frame.isdigit():
            raise ValueError(f"a fault is written kind@frame or kind@frame:seconds, found '{text}'")
        return cls(cast(FaultKind, name), int(frame), float(seconds or 0))
