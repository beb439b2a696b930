"""One settled frame to one verdict: decode, crop, check light, sensor and contact, score, decide."""

import math
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.contact.reference import View
from edge.core.contact.relief import find_contact, find_expected_reach
from edge.core.drawn_regions import LEAST_JUDGED_MM2
from edge.core.errors import FrameCorrupt, NotScorable, PoseNotFound
from edge.core.imaging.decode import decode
from edge.core.imaging.followed_light import FollowedLight, find_light
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import (
    Reason,
    Rejection,
    check_contact,
    check_freshness,
    check_light,
)
from edge.core.imaging.sensor_check import check_sensor
from edge.core.ports import Clock
from edge.core.press import Press
from edge.core.registration.pose import Registered
from edge.core.sentence import Sentence
from edge.core.verdict import Kind
from edge.model.manifest_facts import USUAL_CONTACT
from edge.model.scorer import Scorer

__all__ = ["Inspector"]

MOST_AHEAD: Final = 4
"""Frames of a press that are scored before it rests and wait, with their maps; the oldest make room."""


class Inspector:
    """Judges settled frames with one bundle.

    light: how presses are brought to the light of the fit; None scores them as they are. new_gel: the first picture of
    a gel that was mounted in place of an earlier one, whose shading is followed; None for the first gel. fault: why its
    scores cannot be trusted now; then a press gives this error and no verdict. expected: where nominal presses reach,
    bool (h, w) of the region in the bank's pose; None where the bundle does not show it. took_s: how long the last
    score took, from the camera's bytes on; without end before the first.
    """

    light: FollowedLight | None = None
    new_gel: View | None = None
    fault: Sentence | None = None
    took_s: float = math.inf

    def __init__(self, scorer: Scorer, clock: Clock) -> None:
        self.scorer = scorer
        self.bundle = scorer.bundle
        self._clock = clock
        self._ahead: deque[tuple[CameraFrame, Touch, Press]] = deque(maxlen=MOST_AHEAD)
        colours = self.bundle.manifest.colours
        self._colours = colours.nominal() if colours else None
        free = None if self.bundle.blind is None else self.bundle.free_region
        self._free = None if free is None else self.bundle.prepare(free)
        self.expected = find_expected_reach(
            [
                press.rgb
                for press in self.bundle.golden
                if press.score <= self.bundle.manifest.threshold.value
            ],
            self.bundle.free_view,
            self.bundle.bank.get(USUAL_CONTACT),
            self.bundle.region,
            self.bundle.profile.size,
            self.bundle.prepare,
        )

    def inspect(
        self, frame: CameraFrame, touch: Touch, press: Press | None = None, came_ns: int | None = None
    ) -> Press:
        """Judge one frame; `touch` is the touched part of the gel. Returns the press, a new one by default, with what
        was found. came_ns: since when it waits for its verdict, by default since its own time. Never raises because of
        a frame's content."""
        press = press or Press()
        if self.fault is not None:
            return replace(press, error=self.fault)
        now_ns = self._clock.monotonic_ns()
        came_ns = frame.timestamp_ns if came_ns is None else came_ns
        stale = None if frame.is_on_demand else check_freshness(came_ns, now_ns)
        if stale:
            return press.reject(stale)
        examined = self._find_ahead(frame, touch) or self._examine(frame, touch)
        self._ahead.clear()
        return replace(
            press,
            verdict=examined.verdict,
            error=examined.error,
            rgb=examined.rgb,
            score_map=examined.score_map,
            latency_ms=examined.latency_ms,
            registered=examined.registered,
            light=examined.light,
        )

    def follow_light(self, free: View | None, *, is_doubtful: bool = False) -> None:
        """Bring presses from now on from the light of this free gel to that of the fit, where it is proven.
        is_doubtful: the view may show what a press has left behind, and changes nothing where it proves nothing."""
        reference = self.bundle.free_reference
        light, is_proven = find_light(free, None if reference is None else reference.view, self.new_gel)
        if is_proven or not is_doubtful:
            self.set_light(light)

    def set_light(self, light: FollowedLight | None) -> None:
        """Bring presses to the light of the fit in this way; None scores them as they are."""
        if light != self.light:
            self.light = light
            self.forget_ahead()

    def restore_light(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a picture of the region under the light of the fit; the same array where it is that light."""
        bundle = self.bundle
        return rgb if self.light is None else self.light.restore(rgb, bundle.region, bundle.profile.size)

    def warm_up(self, frame: CameraFrame) -> None:
        """Score a frame for nothing before the first press: once for memory, once for the time that a score takes."""
        if self.took_s == math.inf:
            for _ in range(2):
                self._examine(frame, None)

    def examine_ahead(self, frame: CameraFrame, touch: Touch) -> Press | None:
        """Score a frame that is probably inspected next, and return what is found, which waits until then; None where
        it waits already."""
        if self._find_ahead(frame, touch) is not None:
            return None
        self._ahead.append((frame, touch, self._examine(frame, touch)))
        return self._ahead[-1][2]

    def forget_ahead(self) -> None:
        """Let go of the frames that wait: another bundle is in use, or another light."""
        self._ahead.clear()

    def _find_ahead(self, frame: CameraFrame, touch: Touch) -> Press | None:
        return next((press for *asked, press in self._ahead if asked == [frame, touch]), None)

    def _examine(self, frame: CameraFrame, touch: Touch | None) -> Press:
        """Say what the frame shows. touch: None for one that is of no press."""
        began_ns = self._clock.monotonic_ns()
        try:
            picture = decode(frame, self.bundle.profile)
        except FrameCorrupt as error:
            return Press(error=str(error))
        latency = {"decode": (self._clock.monotonic_ns() - began_ns) / 1e6}
        press = self.judge_picture(picture, touch, latency)
        if press.score_map is not None:
            self.took_s = (self._clock.monotonic_ns() - began_ns) / 1e9
        return press

    def judge_picture(
        self, picture: NDArray[np.uint8], touch: Touch | None, latency: dict[str, float] | None = None
    ) -> Press:
        """Judge a picture of the profile's size, uint8 (h, w, 3) RGB. touch: None leaves the contact unchecked.
        latency: gets the milliseconds of each stage."""
        latency = {} if latency is None else latency
        rgb = np.ascontiguousarray(self.bundle.region.crop(picture))
        press = Press(rgb=rgb, light=self.light, latency_ms=latency)
        started_ns = self._clock.monotonic_ns()
        prepared = self.bundle.prepare(rgb)
        if self.bundle.manifest.dots is not None:
            latency["dots"] = (self._clock.monotonic_ns() - started_ns) / 1e6
        prepared = self.restore_light(prepared)
        rejection = check_light(picture)
        if rejection is None and self._colours is not None:
            rejection = check_sensor(prepared, self._colours)
        contact = self.bundle.manifest.contact
        if rejection is None and contact is not None and touch is not None:
            rejection = check_contact(touch, contact, self.bundle.profile.size)
        if rejection is not None:
            return press.reject(rejection)
        return self._score(press, prepared)

    def score_map(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32] | None:
        """Score another picture of the region, uint8 (h, w, 3); float32 (h, w), None where it cannot be scored."""
        try:
            return self.scorer.score_prepared(self.restore_light(self.bundle.prepare(rgb))).score_map
        except (PoseNotFound, NotScorable):
            return None

    def _score(self, press: Press, prepared: NDArray[np.uint8]) -> Press:
        latency = dict(press.latency_ms)
        try:
            scored = self.scorer.score_prepared(prepared)
            verdict = self.bundle.manifest.decide(scored.anomaly_score)
        except PoseNotFound as error:
            return press.reject(Rejection(Reason.NO_POSE, Sentence(str(error))))
        except NotScorable as error:
            return replace(press, error=str(error))
        if verdict.kind in (Kind.PASS, Kind.UNSURE) and not self._touches_judged(prepared, scored.registered):
            return press.reject(
                Rejection(
                    Reason.ALL_IGNORED,
                    Sentence(
                        "the press touches the part only where drawn regions ignore it, so nothing was judged; check "
                        "how the part meets the sensor, or draw the regions again"
                    ),
                )
            )
        if scored.registered is not None:
            latency["registration"] = scored.registration_ms
        latency |= {"trunk": scored.trunk_ms, "head": scored.head_ms}
        return replace(
            press,
            verdict=verdict,
            score_map=scored.score_map,
            latency_ms=latency,
            registered=scored.registered,
        )

    def _touches_judged(self, prepared: NDArray[np.uint8], registered: Registered | None) -> bool:
        """Tell whether a press touches the gel where it is judged."""
        blind, profile = self.bundle.blind, self.bundle.profile
        if blind is None or self._free is None:
            return blind is None
        if registered is not None:
            blind = registered.unseen_in_press | registered.mask_in_press(blind)
        contact = find_contact(prepared, self._free, profile.size)
        x_mm, y_mm = profile.mm_per_pixel
        return bool(np.count_nonzero(contact & ~blind) * x_mm * y_mm >= LEAST_JUDGED_MM2)
