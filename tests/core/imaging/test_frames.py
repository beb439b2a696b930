"""A camera frame's bytes are looked at once, however many stages ask."""

import cv2
import numpy as np

from edge.core.imaging.frames import CameraFrame


class Watched(bytes):
    """Bytes that count how often their end is searched for."""

    searches = 0

    def rfind(self, *arguments: object) -> int:  # type: ignore[override]
        Watched.searches += 1
        return super().rfind(*arguments)  # type: ignore[arg-type]


def test_the_bytes_are_searched_once_also_after_the_frame_is_numbered() -> None:
    """Reader, press detector and decoder all ask; the reader gives the frame a number of its own in between."""
    Watched.searches = 0
    payload = Watched(cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    frame = CameraFrame(payload, 7, 0)
    assert frame.damage is None
    later = frame.renumber(41)

    assert (later.damage, later.sequence, later.timestamp_ns, later.size) == (None, 41, 7, (64, 48))
    assert later.payload is payload
    assert Watched.searches == 1
