"""The frames of a camera."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

from edge.core.imaging.image_bytes import damage, picture_size

__all__ = ["CameraFrame"]


@dataclass(frozen=True)
class CameraFrame:
    """One frame exactly as the camera sent it."""

    payload: bytes
    """The JPEG (or PNG) bytes, unchanged, so the archive holds what the camera sent."""
    timestamp_ns: int
    """Monotonic nanoseconds at arrival."""
    sequence: int
    """Rises by one per frame that the device delivered."""
    is_on_demand: bool = False
    """Made when it was requested; its time is that of the recording, and its age has no meaning."""

    @cached_property
    def damage(self) -> str | None:
        """The reason why the payload is not one complete JPEG or PNG, or None; checked once."""
        return damage(self.payload)

    @cached_property
    def size(self) -> tuple[int, int] | None:
        """(width, height) by the payload's header, or None when it cannot be read; checked once."""
        return picture_size(self.payload)

    def renumber(self, sequence: int) -> Self:
        """Give the frame another sequence; what is known of its payload stays known."""
        frame = replace(self, sequence=sequence)
        frame.__dict__.update(
            {name: self.__dict__[name] for name in ("damage", "size") if name in self.__dict__}
        )
        return frame
