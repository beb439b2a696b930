"""What looking for contact costs, in CPU time: decoding the view, the tracker, and one idle stream."""

import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from edge.core.contact.reference import View
from edge.core.contact.tracker import ContactTracker
from edge.core.imaging.decode import decode, decode_view
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import PROFILES

FPS = 25


def camera_frame(quality: int) -> CameraFrame:
    """A native frame: smooth colours and sensor noise; the JPEG's size is set by its quality."""
    y, x = np.mgrid[0:2464, 0:3280].astype(np.float32) / 3280
    colours = np.stack([40 + 90 * y, 60 + 60 * x, 150 - 80 * y], axis=-1)
    noisy = colours + np.random.default_rng(0).normal(0, 3, colours.shape)
    done, payload = cv2.imencode(".jpg", noisy.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return CameraFrame(payload.tobytes(), 0, 0)


def median_ms(work: Callable[[], object], rounds: int = 30) -> float:
    """Median CPU time of this process, so that other processes do not count."""
    times = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1e3 * float(np.median(times))


def looks_per_second(tracker: ContactTracker, view: View) -> float:
    """How many of 25 frames a second an idle tracker asks for."""
    for i in range(1, 2 * FPS):
        tracker.feed(view, i * 10**9 // FPS, i)
    looked = 0
    for i in range(2 * FPS, 12 * FPS):
        if tracker.is_due(i * 10**9 // FPS):
            tracker.feed(view, i * 10**9 // FPS, i)
            looked += 1
    return looked / 10


@pytest.mark.bench
@pytest.mark.parametrize("quality", [80, 92])
def test_the_cost_of_an_idle_stream(quality: int) -> None:
    """Prints milliseconds per look and the share of one core at 25 frames a second."""
    frame, profile = camera_frame(quality), PROFILES["mini_lr"]
    view = decode_view(frame, profile)
    tracker = ContactTracker()
    looks = looks_per_second(tracker, view)
    clock = iter(range(10**12, 10**13, 10**9 // FPS))
    view_ms = median_ms(lambda: decode_view(frame, profile))
    feed_ms = median_ms(lambda: tracker.feed(view, next(clock), 0))
    picture_ms = median_ms(lambda: decode(frame, profile))
    share = looks * (view_ms + feed_ms) / 1e3
    print(
        f"\nJPEG {len(frame.payload) / 1e6:.2f} MB: view {view_ms:.1f} ms, contact {feed_ms:.1f} ms, "
        f"picture {picture_ms:.1f} ms; {looks:.1f} looks/s of {FPS}: {share:.1%} of one core when idle"
    )
