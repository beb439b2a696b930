"""A press: the one value that grows from the frame that settles to the row and the message that it becomes."""

import json
import math
from collections.abc import Callable, Set
from dataclasses import asdict, dataclass, field, replace
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.contact.reference import View
from edge.core.defects import Defect, Measured, find_defects
from edge.core.imaging.followed_light import FollowedLight
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import Rejection
from edge.core.overview.view import OverviewView
from edge.core.piece import PlacePress
from edge.core.reference_press.outcome import Imprint
from edge.core.registration.pose import Registered
from edge.core.verdict import Blame, Kind, Verdict

__all__ = [
    "AGREED",
    "Again",
    "JudgedFrame",
    "Press",
    "PressLabel",
    "ReferenceLabel",
    "ScarFindings",
    "ShadowVerdict",
    "StudyLabel",
]

AGREED: Final = 0.95
"""The share of the threshold that both presses of a damaged piece show at its place. Of 0.9, 0.95 and 1, in
simulated months of development parts."""

# Rounding of a score that is the highest value of its map.
_SAME: Final = 1e-4


@dataclass(frozen=True)
class ReferenceLabel:
    """A master piece."""

    kind: ClassVar = "reference"
    piece: str
    expected: str
    """The verdict that it must give."""
    learn: int
    """Presses that its limits are made from."""
    is_start: bool = False
    """Its charts begin again."""


@dataclass(frozen=True)
class StudyLabel:
    """One step of the plan of a gauge study; repeat counts from 1."""

    kind: ClassVar = "study"
    study_id: str
    step: int
    piece: str
    operator: str
    repeat: int


PressLabel = ReferenceLabel | StudyLabel


@dataclass(frozen=True)
class JudgedFrame:
    """What a press was judged by."""

    frame: CameraFrame
    touch: Touch
    """Where that frame touches."""
    reference: View | None = None
    """The free gel that it was compared with, float32 (h, w, 3)."""


@dataclass(frozen=True, eq=False)
class ScarFindings:
    """A press and the scars of its gel.

    blind_mm2, blind_share: the area of the masked places within the contact, and its share of it.
    """

    blame: Blame
    """Why it is not passed, should it not be."""
    masked: NDArray[np.bool_] | None = None
    """bool (h, w) of the region, places that were not judged, None for none."""
    blind_mm2: float = 0.0
    blind_share: float = 0.0
    is_too_blind: bool = False
    """More than is accepted."""
    score: float | None = None
    """The score with the masked places."""


@dataclass(frozen=True)
class Again:
    """One more press of the same piece. second_of, first_score: of the first press, where this is the second.
    own_score: of this press, where it is decided by what both show at one place; shown_from: its score there counts
    from this value on."""

    reason: str
    """One sentence."""
    is_asked: bool
    """It is asked for."""
    second_of: str | None = None
    first_score: float | None = None
    own_score: float | None = None
    shown_from: float | None = None
    bound: float | None = None
    """Up to this score a second press is asked for."""


@dataclass(frozen=True)
class ShadowVerdict:
    """What a shadow says of one press."""

    bundle_id: str
    beside: str
    """The bundle that decided."""
    verdict: str
    """Pass, fail, unsure, rejected, or error for a press that it could not score."""
    score: float | None
    threshold: float

    def encode(self) -> str:
        """Write it as the row of the press has it."""
        return json.dumps(asdict(self))

    @classmethod
    def decode(cls, text: str) -> Self:
        """Read what `encode` wrote."""
        return cls(**json.loads(text))


@dataclass(frozen=True)
class Press:
    """One press, from its beginning to its verdict. An error has no verdict."""

    verdict: Verdict | None = None
    error: str | None = None
    rgb: NDArray[np.uint8] | None = None
    """The inspected region, (h, w, 3); None where the press did not get that far."""
    score_map: NDArray[np.float32] | None = None
    """Raw scores of the region, (h, w); higher is more anomalous."""
    light: FollowedLight | None = None
    """How it was brought to the light of the fit before its score; None where it was scored as it is."""
    latency_ms: dict[str, float] = field(default_factory=dict)
    """Stage to milliseconds."""
    judged_ns: int | None = None
    """When the judged frame came, monotonic; for a peak long before the end, `settle_s` before it was decided."""
    overview: OverviewView | None = None
    """What the overview camera saw before the press."""
    registered: Registered | None = None
    """How the press was brought to the bank's pose; None where it was scored without."""
    judged: JudgedFrame | None = None
    """What it was judged by."""
    is_at_rest: bool | None = None
    """False where it grew or moved until it was lifted, and is judged at its peak; None without a frame to judge."""
    label: PressLabel | None = None
    """What the press is for; None for a part."""
    imprint: Imprint | None = None
    """What is measured of a master piece."""
    again: Again | None = None
    """What it has to do with another press of the same piece."""
    scars: ScarFindings | None = None
    """What is known of the gel's scars; None where nothing was scored."""
    shadow: ShadowVerdict | None = None
    """What a bundle that decides nothing says of it; None without one."""
    piece: PlacePress | None = None
    """What it means for a piece of several places; None without a plan, and for a press of no piece."""
    trigger_id: int = 0
    """Of the trigger of a PLC that it answers; 0 for none."""
    asked_piece: str = ""
    """The piece that the PLC names with it; empty for none."""
    press_id: str = ""
    """Its ULID, given when it is judged."""
    time_ns: int = 0
    """When it was judged, wall clock."""
    bundle_id: str = ""
    """Digest of the bundle that judged it."""
    measure: Callable[[], Measured] | None = None
    """Measures its deviations in mm, which takes long; None where they cannot be measured."""
    evidence: bytes | None = None
    """SHA-256 of what was kept of it; None where nothing was."""

    @property
    def piece_names(self) -> tuple[Set[str], ...]:
        """What names its piece: the plan, a PLC, and the codes on it with the ids in them; where none does, the trigger
        of the PLC, which knows of no second press."""
        codes = [] if self.overview is None else [code.text for code in self.overview.codes]
        ids = () if self.overview is None else self.overview.piece_ids
        plan = set() if self.piece is None else {self.piece.piece_id}
        names = plan, {self.asked_piece} - {""}, set(codes), set(ids)
        return *names, set() if any(names) else {str(self.trigger_id or "")} - {""}

    @property
    def is_decided(self) -> bool:
        """True where nothing remains to be scored."""
        return self.verdict is not None or self.error is not None

    @property
    def blame(self) -> Blame | None:
        """The cause of a fail or unsure: part, gel or unsure, and why."""
        is_blamed = self.verdict is not None and self.verdict.kind in (Kind.FAIL, Kind.UNSURE)
        return self.scars.blame if self.scars is not None and is_blamed else None

    @property
    def word(self) -> str:
        """The verdict, or `error`."""
        return "error" if self.verdict is None else self.verdict.kind.value

    @property
    def shown(self) -> str | None:
        """What outputs show: the word, but of a piece of several places a pass only once all of it has passed."""
        return self.word if self.piece is None else self.piece.show(self.word)

    @property
    def reason(self) -> str | None:
        """The reason of a rejection, with its sentence."""
        rejection = self.verdict.rejection if self.verdict else None
        return f"{rejection.reason.value}: {rejection.text}" if rejection else None

    @property
    def score(self) -> float | None:
        return self.verdict.score if self.verdict else None

    @property
    def is_of_place(self) -> bool:
        """Whether the score is the highest value of its map, not of something else, as of relief that is missing."""
        if self.score is None or self.score_map is None:
            return False
        return math.isclose(float(self.score_map.max()), self.score, rel_tol=_SAME)

    def find_places(self, threshold: float) -> list[Defect]:
        """Find the places that are above the threshold, or that decided two presses, highest score first."""
        level = self.again.shown_from if self.again else None
        if self.score_map is None:
            return []
        return find_defects(self.score_map, threshold if level is None else level)

    def reject(self, rejection: Rejection) -> "Press":
        """Return it rejected, unless it is decided already."""
        return self if self.is_decided else replace(self, verdict=Verdict.rejected(rejection))

    def distrust(self) -> "Press":
        """Return it unsure instead of passed where scars hide more of it than is accepted."""
        verdict, scars = self.verdict, self.scars
        if verdict is None or scars is None or not scars.is_too_blind or verdict.kind is not Kind.PASS:
            return self
        return replace(self, verdict=replace(verdict, kind=Kind.UNSURE))

    def drop_pictures(self) -> "Press":
        """Return it without frame and maps, to wait for the database in little memory."""
        scars = None if self.scars is None else replace(self.scars, masked=None)
        return replace(
            self, rgb=None, score_map=None, judged=None, registered=None, scars=scars, measure=None
        )
