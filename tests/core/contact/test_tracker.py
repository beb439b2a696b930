"""The contact tracker on pictures: simulated presses, real backgrounds, and a real press video."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from contact_frames import read_view

from edge.core.contact.events import (
    Event,
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
    ReferenceReady,
    ReferenceRefreshed,
    StartedTouched,
)
from edge.core.contact.reference import Reference, View
from edge.core.contact.settings import ContactSettings
from edge.core.contact.table import State
from edge.core.contact.tracker import ContactTracker

SECOND = 1_000_000_000


def free_gel() -> View:
    y, x = np.mgrid[0:120, 0:160].astype(np.float32)
    shade = np.exp(-(((x - 80) / 90) ** 2 + ((y - 60) / 70) ** 2))[..., None]
    return (20 + np.stack([150 - y * 0.5, 60 + x * 0.4, 60 + y * 0.6], axis=-1) * shade).astype(np.float32)


def pressed(view: View, depth: float) -> View:
    """A ball of 20 pixels at full depth: the disc and its slopes grow with the depth."""
    return view if depth <= 0 else (view + ball(depth)).astype(np.float32)


@cache
def ball(depth: float) -> View:
    rows, columns = np.mgrid[0:120, 0:160].astype(np.float32)
    radius = 20 * depth**0.5
    u, v = (columns - 80) / radius, (rows - 60) / radius
    slopes = np.stack([-60 * v, 55 * u, 60 * v], axis=-1) * (u * u + v * v <= 1)[..., None]
    return np.asarray(slopes * depth, np.float32)


def depth_at(t: float, onset: float, hold: float = 1.5, ramp: float = 0.3) -> float:
    """A robot's press: down in `ramp` seconds, held, and up again."""
    return float(np.clip(min((t - onset) / ramp, (onset + hold + 2 * ramp - t) / ramp), 0, 1))


class Camera:
    """Feeds a tracker with noisy views at a steady rate and keeps its events."""

    def __init__(self, tracker: ContactTracker, background: View, fps: float = 25.0) -> None:
        self.tracker, self.background, self.fps = tracker, background, fps
        rng = np.random.default_rng(0)
        self.noises = [rng.normal(0, 1.3, background.shape).astype(np.float32) for _ in range(7)]
        self.count = 0
        self.events: list[Event] = []
        self.looked = 0

    @property
    def now(self) -> float:
        return self.count / self.fps

    def show(self, depth: float = 0.0, gain: float = 1.0, every: bool = True) -> None:
        self.count += 1
        timestamp_ns = round(self.now * SECOND)
        if not every and not self.tracker.is_due(timestamp_ns):
            return
        noise = self.noises[self.count % len(self.noises)]
        view = np.clip((pressed(self.background, depth) + noise) * np.float32(gain), 0, 255)
        self.looked += 1
        self.events += self.tracker.feed(view, timestamp_ns, self.count)

    def wait(self, seconds: float, depth: float = 0.0) -> None:
        for _ in range(round(seconds * self.fps)):
            self.show(depth)

    def names(self) -> list[str]:
        return [type(event).__name__ for event in self.events]


def ready(fps: float = 25.0, settings: ContactSettings | None = None) -> Camera:
    camera = Camera(ContactTracker(settings), free_gel(), fps)
    camera.wait(max(1.5, 18 / fps))
    assert camera.names() == ["ReferenceReady"]
    camera.events.clear()
    return camera


@pytest.mark.parametrize(
    ("fps", "every"),
    [(5.0, True), (18.75, True), *((fps, False) for fps in (5.0, 10.0, 18.75, 25.0, 60.0))],
)
def test_one_press_one_frame_at_any_rate(fps: float, every: bool) -> None:
    """Three presses at 5 to 60 frames a second, every frame looked at or only those that are due: three settled."""
    camera = ready(fps)
    start = camera.now + 1.0
    while camera.now < start + 10.5:
        camera.show(max(depth_at(camera.now, start + 3.5 * i) for i in range(3)), every=every)
    assert camera.names() == ["PressBegan", "PressSettled", "PressEnded"] * 3
    for i, event in enumerate(e for e in camera.events if isinstance(e, PressSettled)):
        assert depth_at(event.sequence / fps, start + 3.5 * i) > 0.85
        assert event.touch.x == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("fps", [18.75, 25.0, 30.0])
def test_a_short_grasp_is_judged_at_its_peak(fps: float) -> None:
    """Down in 0.5 s and up again at once: the verdict comes with the release, with what the deepest frame shows."""
    camera = ready(fps)
    start = camera.now + 1.0
    while camera.now < start + 2:
        camera.show(depth_at(camera.now, start, hold=0.0, ramp=0.5), every=False)
        assert len(camera.tracker.candidates) <= 0.2 * fps + 3
    assert camera.names() == ["PressBegan", "PressSettled", "PressEnded"]
    [settled] = [event for event in camera.events if isinstance(event, PressSettled)]
    assert depth_at(settled.sequence / fps, start, hold=0.0, ramp=0.5) > 0.85
    assert settled.findings is not None
    assert settled.findings.mask.mean() == pytest.approx(settled.touch.area)
    assert "array" not in repr(settled), "the log has a line for each event"


def test_idle_frames_are_mostly_not_due() -> None:
    """Ten looks a second are enough while nothing presses: of 25 frames a second a third is decoded."""
    camera = ready()
    looked = camera.looked
    for _ in range(250):
        camera.show(every=False)
    assert camera.looked - looked <= 90
    assert camera.names() == ["ReferenceRefreshed"]


def test_the_scored_frame_is_a_candidate_or_the_newest() -> None:
    """With these camera frames, which are few, a press can always be scored."""
    camera = ready()
    start = camera.now + 0.5
    while camera.now < start + 3:
        kept = {*camera.tracker.candidates, camera.count + 1}
        before = len(camera.events)
        camera.show(depth_at(camera.now, start))
        for event in camera.events[before:]:
            if isinstance(event, PressSettled):
                assert event.sequence in kept
    assert "PressSettled" in camera.names()


def test_mask_and_reference_are_at_hand() -> None:
    """During a press the mask is the disc, for fitting and for the heatmap."""
    camera = ready()
    camera.wait(0.5, depth=1.0)
    mask = camera.tracker.mask
    assert mask is not None
    assert mask[60, 80]
    assert not mask[10, 10]
    assert camera.tracker.has_contact
    assert camera.tracker.reference is not None
    assert np.abs(camera.tracker.reference.view - free_gel()).mean() < 0.6


def test_an_exposure_drift_tells_nothing_and_loses_no_press() -> None:
    """Level down a fifth over a minute, then up, with a press in the middle: that press and nothing else."""
    camera = ready()
    start = camera.now
    while camera.now < start + 60:
        t = camera.now - start
        camera.show(depth_at(t, 30.0), gain=1.0 - 0.2 * min(t, 60 - t) / 30, every=False)
    presses = [name for name in camera.names() if name.startswith("Press")]
    assert presses == ["PressBegan", "PressSettled", "PressEnded"]


def test_the_reference_is_not_learnt_from_a_press_or_its_imprint() -> None:
    """A press held for twenty seconds, and three seconds after it, leave the reference as it was."""
    camera = ready()
    before = camera.tracker.reference
    camera.wait(20, depth=1.0)
    camera.wait(3)
    assert camera.tracker.reference is before
    assert camera.tracker.state is State.RECOVERY
    camera.wait(11)
    assert camera.names() == ["PressBegan", "PressSettled", "PressEnded", "ReferenceRefreshed"]
    refreshed = camera.events[-1]
    assert isinstance(refreshed, ReferenceRefreshed)
    assert refreshed.change < 0.5


def test_no_refresh_before_the_imprint_has_faded() -> None:
    """Where a refresh takes two seconds, they begin three seconds after the release."""
    camera = ready(settings=ContactSettings(refresh_s=2.0))
    camera.wait(1, depth=1.0)
    camera.wait(4.9)
    assert camera.names() == ["PressBegan", "PressSettled", "PressEnded"]
    camera.wait(0.5)
    assert camera.names()[3] == "ReferenceRefreshed"


def test_a_stored_reference_shows_that_the_start_was_touched() -> None:
    """A part on the gel at the start is reported, not learnt; after its lift presses count as usual."""
    camera = Camera(ContactTracker(stored=Reference(free_gel())), free_gel())
    camera.wait(3, depth=1.0)
    camera.wait(4)
    camera.wait(1, depth=1.0)
    assert [type(e) for e in camera.events] == [StartedTouched, ReferenceReady, PressBegan, PressSettled]
    reference = camera.tracker.reference
    assert reference is not None
    assert np.array_equal(reference.view, free_gel())


def test_a_stored_reference_is_replaced_by_a_free_start() -> None:
    camera = Camera(ContactTracker(stored=Reference(free_gel() * np.float32(0.9))), free_gel())
    camera.wait(2)
    assert camera.names() == ["ReferenceReady"]
    assert camera.tracker.reference is not None
    assert np.abs(camera.tracker.reference.view - free_gel()).mean() < 0.6


def test_a_part_arriving_during_the_baseline_is_not_learnt() -> None:
    """Without a stored reference, motion gives it away; learning waits until the view rests again."""
    camera = Camera(ContactTracker(), free_gel())
    camera.wait(0.7)
    camera.wait(0.2, depth=1.0)
    camera.wait(0.6)
    assert camera.events == []
    camera.wait(1.0)
    assert camera.names() == ["ReferenceReady"]


def test_unplugged_in_the_middle_of_presses() -> None:
    """Ten pulls of the plug during presses, the camera black at first each time: ten presses, ten verdicts."""
    camera = ready()
    for i in range(10):
        camera.wait(0.04 * (i % 5) + 0.08 * i, depth=1.0)
        camera.events += camera.tracker.gap()
        camera.count += 50
        for _ in range(3):
            camera.count += 1
            black = np.zeros((120, 160, 3), np.float32)
            camera.events += camera.tracker.feed(black, round(camera.now * SECOND), camera.count)
        camera.wait(1.0, depth=1.0)
        camera.wait(1.0)
    assert camera.names() == ["PressBegan", "PressSettled", "PressEnded"] * 10


def test_a_part_that_lies_there_after_an_interruption_is_no_free_gel() -> None:
    """It was put on the gel meanwhile, and there are two: the light of presses is still that of the gel before."""
    camera = ready()
    camera.wait(1)
    for _ in range(2):
        camera.tracker.gap()
        camera.count += 50
        camera.wait(0.3, depth=1.0)
    assert camera.tracker.newest_free is not None
    assert np.abs(camera.tracker.newest_free - free_gel()).max() < 10


def test_relearning_follows_a_change_of_gel() -> None:
    """Another gel looks like contact everywhere; after `relearn` it is the free gel."""
    camera = ready()
    camera.background = np.ascontiguousarray(free_gel()[::-1, ::-1])
    camera.wait(1)
    assert camera.tracker.has_contact
    camera.events = camera.tracker.relearn()
    assert camera.names() == ["PressEnded"]
    assert camera.tracker.mask is None
    camera.wait(2)
    assert camera.names() == ["PressEnded", "ReferenceReady"]
    assert camera.tracker.touch is not None
    assert camera.tracker.touch.area == 0


@cache
def video_views(path: Path) -> list[View]:
    capture = cv2.VideoCapture(str(path))
    views = []
    while (found := capture.read())[0]:
        small = cv2.resize(found[1], (160, 120), interpolation=cv2.INTER_AREA)
        views.append(np.ascontiguousarray(small[..., ::-1]).astype(np.float32))
    capture.release()
    return views


@pytest.mark.parametrize(
    ("view", "stored", "words"),
    [
        (np.zeros((120, 160, 3), np.uint8), None, "uint8"),  # it would wrap
        (np.zeros((120, 160), np.float32), None, r"\(120, 160\)"),
        (free_gel(), Reference(np.zeros((60, 80, 3), np.float32)), r"60, 80.*120, 160"),
    ],
)
def test_other_arrays_are_refused(view: View, stored: Reference | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ContactTracker(stored=stored).feed(view, 1, 1)


def test_the_real_press_video(real_tactile: Path) -> None:
    """No contact, press with shear, short lift, press, lift: two presses, each settled once, at these frames. A marker
    gel and a human fingertip at 25 frames a second, 219 frames. By eye the touch begins at frame 57, the short lift is
    from 154 to 159, and the last lift ends at 209."""
    tracker = ContactTracker()
    found: list[tuple[int, Event]] = []
    for i, view in enumerate(video_views(real_tactile / "gelsightinc__gsrobotics" / "mini_example.avi")):
        found += [(i, event) for event in tracker.feed(view, (i + 1) * SECOND // 25, i)]
    assert [type(event) for _, event in found] == [
        ReferenceReady,
        *[PressBegan, PressSettled, PressEnded] * 2,
    ]
    expected = (22, 60, 109, 156, 162, 183, 211)
    assert [frame for frame, _ in found] == pytest.approx(expected, abs=2)
    assert [event.sequence for _, event in found if isinstance(event, PressSettled)] == pytest.approx(
        (98, 170), abs=3
    )


@pytest.mark.parametrize("stride", [2, 3])
def test_the_real_video_at_lower_rates(real_tactile: Path, stride: int) -> None:
    """At 12.5 and 8.3 frames a second the same two presses begin and end, each once. Whether the ever shearing
    fingertip counts as still for a moment does depend on the rate."""
    tracker = ContactTracker()
    found: list[Event] = []
    for i, view in enumerate(video_views(real_tactile / "gelsightinc__gsrobotics" / "mini_example.avi")):
        if i % stride == 0:
            found += tracker.feed(view, (i + 1) * SECOND // 25, i)
    for kinds in ((PressBegan,), (PressSettled, PressNotSettled), (PressEnded,)):
        assert sum(isinstance(event, kinds) for event in found) == 2


def test_a_real_gel_under_drifting_light(real_tactile: Path) -> None:
    """A real background and real ball presses, the exposure wandering by a fifth: each press settled once."""
    folder = real_tactile / "rpl-cmu__gelslam"

    background = read_view(folder / "background.png")
    camera = Camera(ContactTracker(), background)
    camera.wait(1.5)
    camera.events.clear()
    presses = [read_view(path) for path in sorted(folder.glob("*mm/*/gelsight.png"))[::6]]
    for i, press in enumerate(presses):
        for shown, frames in ((background, 30), (press, 30), (background, 10)):
            camera.background = shown
            for _ in range(frames):
                camera.show(gain=1.0 + 0.2 * float(np.sin(camera.now / 5)), every=False)
        assert camera.names().count("PressSettled") == i + 1
    assert camera.names() == ["PressBegan", "PressSettled", "PressEnded"] * len(presses)
