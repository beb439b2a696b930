"""Learnt and scored frames are the same: `fit` and the gateway choose the same frames of any recording."""

import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration.fitting.presses.nominal_presses import read_presses
from edge import registry
from edge.clock import ManualClock
from edge.core.contact.mask import Touch
from edge.core.contact.reference import View
from edge.core.contact.settings import ContactSettings
from edge.core.errors import FitError, FrameCorrupt, RecordingEnded
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import with_comment
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.press import Press
from edge.gateway.inspection_session import InspectionSession
from edge.recording.format import Recording, RecordingHeader, RecordingWriter

SIZE = (160, 120)
PROFILE = SensorProfile("test", SIZE, (0.0, 0.0), SIZE, 1, 4.0)
WHOLE = Region(0, 0, *SIZE)
SECOND = 1_000_000_000


@cache
def picture(depth: float) -> bytes:
    """The gel with a ball pressed into it, 0 to 1 deep."""
    rows, columns = np.mgrid[:120, :160].astype(np.float32)
    radius = max(20 * depth**0.5, 1e-3)
    u, v = (columns - 80) / radius, (rows - 60) / radius
    slopes = np.stack([-60 * v, 55 * u, 60 * v], axis=-1) * (u * u + v * v <= 1)[..., None] * depth
    noise = np.random.default_rng(round(depth * 100)).normal(0, 1.3, slopes.shape)
    level = (110 + rows / 6 + columns / 8)[..., None]
    return cv2.imencode(".jpg", np.clip(level + slopes + noise, 0, 255).astype(np.uint8))[1].tobytes()


@dataclass(frozen=True)
class Stretch:
    """Some frames of one kind: `what` is a depth, or the fault of the frame."""

    what: float | str
    frames: int
    hole_frames: int


STRETCHES = st.lists(
    st.builds(
        Stretch,
        what=st.sampled_from([0.0, 0.0, 0.5, 1.0, 1.0, "cut", "small", "again", "black"]),
        frames=st.integers(1, 24),
        hole_frames=st.sampled_from([0, 0, 0, 1, 15, 40]),
    ),
    min_size=2,
    max_size=12,
)


def payload(what: float | str, number: int, before: bytes) -> bytes:
    match what:
        case "again":
            return before
        case "cut":
            return with_comment(picture(1.0), str(number))[:-30]
        case "small":
            return cv2.imencode(".png", np.full((4, 4, 3), number % 256, np.uint8))[1].tobytes()
        case "black":
            flat = cv2.imencode(".png", np.zeros((120, 160, 3), np.uint8))[1].tobytes()
            return with_comment(flat, str(number))
    assert isinstance(what, float)
    return with_comment(picture(what), str(number))


def recorded(folder: Path, stretches: list[Stretch], fps: float, nominal_fps: float = 25.0) -> Path:
    lead = [Stretch(0.0, 40, 0), Stretch(1.0, round(fps), 0), Stretch(0.0, 10, 0)]
    last, place = picture(0.0), 0
    with RecordingWriter(
        folder, RecordingHeader("GelSight Mini R0B TEST-0001", "TEST0001", SIZE, nominal_fps)
    ) as writer:
        for stretch in [*lead, *stretches]:
            place += stretch.hole_frames
            for _ in range(stretch.frames):
                last = payload(stretch.what, len(writer), last)
                writer.add(last, SECOND + round(place * SECOND / fps))
                place += 1
    return folder


class Listener:
    """An inspector that keeps the frames to judge."""

    bundle = Mock(profile=PROFILE, free_reference=None, digest="")
    took_s = 0.0
    light = None

    def __init__(self) -> None:
        self.asked: list[bytes] = []
        self.ahead: list[bytes] = []

    def warm_up(self, frame: CameraFrame) -> None: ...

    def follow_light(self, free: View | None, *, is_doubtful: bool = False) -> None: ...

    def examine_ahead(self, frame: CameraFrame, touch: Touch) -> Press | None:
        if frame.payload in self.ahead:
            return None
        self.ahead.append(frame.payload)
        return Press()

    def inspect(self, frame: CameraFrame, touch: Touch, press: Press, came_ns: int) -> Press:
        self.asked.append(frame.payload)
        return replace(press, error="not judged")


def scored_by_the_gateway(folder: Path, device: str = "recorded", pace: float = 1.0) -> list[bytes]:
    return listen_to_the_gateway(folder, device, pace).asked


def listen_to_the_gateway(
    folder: Path, device: str = "recorded", pace: float = 1.0, wait_s: float = 0.0
) -> Listener:
    """The gateway's chain, from a device that plays at the recorded times. wait_s: of each frame for the loop."""
    clock, listener = ManualClock(), Listener()
    plugin = registry.device(device)
    sensor = plugin.open(plugin.Options.model_validate({"recording": folder, "pace": pace}), clock)
    references = Mock(load_picture=Mock(return_value=None))
    gel, recorder, status = Mock(serial="S", gel_id="S-1"), Mock(), Mock()
    session = InspectionSession(gel, listener, ContactSettings(), references, recorder, status, clock, ())  # type: ignore[arg-type]
    while True:
        try:
            frame = sensor.read(clock.monotonic_ns() + 3600 * SECOND)
            session.feed(replace(frame, timestamp_ns=frame.timestamp_ns - round(wait_s * SECOND)))
        except FrameCorrupt:
            continue
        except RecordingEnded:
            return listener


def learnt_by_fit(folder: Path) -> list[bytes]:
    try:
        names = read_presses([folder], PROFILE, WHOLE).names
    except FitError:
        return []
    frames = Recording.open(folder)
    return [frames[int(name.rpartition("#")[2])].frame.payload for name in names]


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(stretches=STRETCHES, fps=st.sampled_from([5.0, 10.0, 15.0, 18.75, 25.0, 30.0, 60.0]))
def test_fit_and_gateway_choose_the_same_frames(stretches: list[Stretch], fps: float) -> None:
    """Recordings with holes, broken, black, small and repeated frames, at any rate: the same frames, in order."""
    with tempfile.TemporaryDirectory() as folder:
        recording = recorded(Path(folder) / "any", stretches, fps)
        learnt = learnt_by_fit(recording)
        assert learnt == scored_by_the_gateway(recording)
        assert learnt, "the first press is a second long and settles"


def test_a_hole_is_an_interruption_for_both(tmp_path: Path) -> None:
    """Fifteen frames are missing in the middle of a press: one press for the gateway, and one for fit."""
    stretches = [Stretch(1.0, 3, 0), Stretch(1.0, 20, 15), Stretch(0.0, 20, 0)]
    recording = recorded(tmp_path / "hole", stretches, 18.75)
    assert len(learnt_by_fit(recording)) == len(scored_by_the_gateway(recording)) == 2


@pytest.mark.parametrize("fps", [18.75, 60.0])
def test_a_steady_press_is_scored_once_before_it_rests(tmp_path: Path, fps: float) -> None:
    """The frame that is scored ahead is the one that the press is judged by: no press costs a second score."""
    stretches = [Stretch(depth, round(fps / 2), 0) for depth in (1.0, 0.0, 0.6, 0.0)]
    heard = listen_to_the_gateway(recorded(tmp_path / "steady", stretches, fps))
    assert heard.ahead == heard.asked
    assert len(heard.asked) == 3


@pytest.mark.parametrize(("wait_s", "ahead"), [(0.09, 2), (0.11, 0)])
def test_nothing_is_scored_ahead_while_frames_wait(tmp_path: Path, wait_s: float, ahead: int) -> None:
    """A part that slips slowly would be scored again and again, until frames are dropped."""
    film = recorded(tmp_path / "film", [Stretch(1.0, 12, 0)], 18.75)
    heard = listen_to_the_gateway(film, wait_s=wait_s)
    assert (len(heard.ahead), len(heard.asked)) == (ahead, 2)


@pytest.mark.parametrize(("nominal_fps", "pace"), [(25.0, 0.0), (60.0, 1.0)])
def test_every_virtual_sensor_plays_the_same_film(tmp_path: Path, nominal_fps: float, pace: float) -> None:
    """The times of the frames are the pace, whatever rate the camera advertises: presses of four frames do not rest for
    0.2 s, presses of six do."""
    stretches = [Stretch(depth, n, 0) for n in (4, 6, 4, 9) for depth in (1.0, 0.0, 0.0)]
    film = recorded(tmp_path / "film", stretches, 18.75, nominal_fps)

    assert scored_by_the_gateway(film, "usb_mock", pace) == scored_by_the_gateway(film, "recorded", pace)
    assert scored_by_the_gateway(film, "recorded", pace) == learnt_by_fit(film)
