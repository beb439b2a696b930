"""One settled frame to one verdict: decode, crop, check light, sensor and contact, score, decide."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.contact.reach import expected_reach
from edge.core.contact.reference import View
from edge.core.errors import FrameCorrupt, NotScorable, PoseNotFound
from edge.core.gel_scars.causes import Blame
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import (
    NominalContact,
    QualitySettings,
    Reason,
    Rejection,
    check_contact,
    check_freshness,
    check_light,
)
from edge.core.imaging.sensor_check import check_sensor
from edge.core.overview.rules import OverviewView
from edge.core.ports import Clock
from edge.core.press_label import PressLabel
from edge.core.reference_press.measures import Imprint
from edge.core.registration.registrar import Registered
from edge.core.verdict import Kind, Verdict
from edge.model.limit_facts import USUAL_CONTACT
from edge.model.manifest import ContactRange
from edge.model.scorer import Scorer

__all__ = ["Again", "Inspection", "Inspector", "JudgedFrame", "ScarFindings"]


@dataclass(frozen=True)
class JudgedFrame:
    """What a press was judged by. touch: where that frame touches. reference: the free gel that it was compared with,
    float32 (h, w, 3)."""

    frame: CameraFrame
    touch: Touch
    reference: View | None = None


@dataclass(frozen=True, eq=False)
class ScarFindings:
    """A press and the scars of its gel.

    blame: why it is not passed, should it not be. masked: bool (h, w) of the region, places that were not judged, None
    for none. blind_mm2, blind_share: their area within the contact, and its share of it. is_too_blind: more than is
    accepted. score: with those places.
    """

    blame: Blame
    masked: NDArray[np.bool_] | None = None
    blind_mm2: float = 0.0
    blind_share: float = 0.0
    is_too_blind: bool = False
    score: float | None = None


@dataclass(frozen=True)
class Again:
    """One more press of the same piece. reason: one sentence. is_asked: it is asked for. second_of, first_score: of the
    first press, where this is the second. bound: up to this score a second press is asked for."""

    reason: str
    is_asked: bool
    second_of: str | None = None
    first_score: float | None = None
    bound: float | None = None


@dataclass(frozen=True)
class Inspection:
    """The result of one frame: a verdict, or an error and then no verdict.

    rgb: uint8 (h, w, 3) of the inspected region. score_map: float32 (h, w), raw. Both are None where the frame did not
    get that far. latency_ms: stage to milliseconds. judged_ns: when the judged frame came, monotonic; None without one.
    overview: the look before the press, None without such a camera. registered: how the press was brought to the bank's
    pose, None where it was scored as it lies. judged: what it was judged by, None where no frame was. label: what the
    press is for, None for a part's. imprint: what is measured of it where it is a master piece's.
    again: what it has to do with another press of the same piece, None for nothing. scars:
    what is known of the gel's scars, None where nothing was scored.
    """

    verdict: Verdict | None
    error: str | None = None
    rgb: NDArray[np.uint8] | None = None
    score_map: NDArray[np.float32] | None = None
    latency_ms: dict[str, float] = field(default_factory=dict)
    judged_ns: int | None = None
    overview: OverviewView | None = None
    registered: Registered | None = None
    judged: JudgedFrame | None = None
    label: PressLabel | None = None
    imprint: Imprint | None = None
    again: Again | None = None
    scars: ScarFindings | None = None

    @property
    def blame(self) -> Blame | None:
        """Of a fail or unsure: part, gel or unsure, and why."""
        is_blamed = self.verdict is not None and self.verdict.kind in (Kind.FAIL, Kind.UNSURE)
        return self.scars.blame if self.scars is not None and is_blamed else None

    @property
    def word(self) -> str:
        """The verdict, or `error`."""
        return "error" if self.verdict is None else self.verdict.kind.value


class Inspector:
    """Judges settled frames with one bundle.

    fault: why its scores cannot be trusted now; then a press gives this error and no verdict. expected: where nominal
    presses reach, bool (h, w) of the region in the bank's pose; None where the bundle does not show it.
    """

    fault: str | None = None

    def __init__(self, scorer: Scorer, clock: Clock, quality: QualitySettings | None = None) -> None:
        self.scorer = scorer
        self.bundle = scorer.bundle
        self._clock = clock
        self._quality = quality or QualitySettings()
        colours = self.bundle.manifest.colours
        self._colours = colours.nominal() if colours else None
        self._nominal = _nominal_contact(self.bundle.manifest.contact, self.bundle.profile.size)
        self.expected = expected_reach(
            [one.rgb for one in self.bundle.golden if one.score <= self.bundle.manifest.threshold.value],
            self.bundle.free_view,
            self.bundle.bank.get(USUAL_CONTACT),
            self.bundle.region,
            self.bundle.profile.size,
        )

    def inspect(self, frame: CameraFrame, touch: Touch) -> Inspection:
        """Judge one frame; `touch` is the touched part of the gel. Never raises because of a frame's content."""
        if self.fault is not None:
            return Inspection(None, error=self.fault)
        now_ns = self._clock.monotonic_ns()
        stale = None if frame.is_on_demand else check_freshness(frame.timestamp_ns, now_ns, self._quality)
        if stale:
            return Inspection(Verdict.rejected(stale))
        started_ns = self._clock.monotonic_ns()
        try:
            picture = decode(frame, self.bundle.profile)
        except FrameCorrupt as error:
            return Inspection(None, error=str(error))
        latency = {"decode": (self._clock.monotonic_ns() - started_ns) / 1e6}
        rgb = np.ascontiguousarray(self.bundle.region.crop(picture.rgb))
        rejection = check_light(picture, self._quality)
        if rejection is None and self._colours is not None:
            rejection = check_sensor(rgb, self._colours)
        if rejection is None and self._nominal is not None:
            rejection = check_contact(touch, self._nominal, self.bundle.profile.size)
        if rejection is not None:
            return Inspection(Verdict.rejected(rejection), rgb=rgb, latency_ms=latency)
        return self._scored(rgb, latency)

    def score_map(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32] | None:
        """Of another picture of the region, uint8 (h, w, 3); float32 (h, w), None where it cannot be scored."""
        try:
            return self.scorer.score(rgb).score_map
        except (PoseNotFound, NotScorable):
            return None

    def _scored(self, rgb: NDArray[np.uint8], latency: dict[str, float]) -> Inspection:
        try:
            scored = self.scorer.score(rgb)
            verdict = self.bundle.manifest.decide(scored.anomaly_score)
        except PoseNotFound as error:
            rejection = Rejection(Reason.NO_POSE, str(error))
            return Inspection(Verdict.rejected(rejection), rgb=rgb, latency_ms=latency)
        except NotScorable as error:
            return Inspection(None, error=str(error), rgb=rgb, latency_ms=latency)
        if scored.registered is not None:
            latency["registration"] = scored.registration_ms
        latency |= {"trunk": scored.trunk_ms, "head": scored.head_ms}
        return Inspection(
            verdict, rgb=rgb, score_map=scored.score_map, latency_ms=latency, registered=scored.registered
        )


def _nominal_contact(found: ContactRange | None, size: tuple[int, int]) -> NominalContact | None:
    """The manifest's fractions of the picture, in its pixels."""
    if found is None:
        return None
    x_px, y_px = (
        (low * side, high * side) for (low, high), side in zip((found.x, found.y), size, strict=True)
    )
    return NominalContact(x_px, y_px, found.area)
