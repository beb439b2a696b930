"""A part found in a press, and the press brought to the pose in which the bank was learnt."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edge.core.arrays import F32, U8, Mask
from edge.core.printable import score_texts
from edge.core.registration.coarse import CoarseSearch, shifts_alike
from edge.core.registration.colours import FreeLight, SlopeColours
from edge.core.registration.fine import Alignment, FineSearch
from edge.core.registration.pose import (
    Pose,
    PoseUncertainty,
    Registered,
    depth_inside,
    gel_limits_in_pose,
    turn_slopes,
    warp,
)
from edge.core.sentence import Sentence

__all__ = ["SIDE_PX", "PartInPose", "PoseSearch", "Registrar", "shrunk"]

SIDE_PX = 112
"""The longer side of the picture in which a pose is found; half of that where candidates are refined."""

# Cells along the longer side, and turns, of the coarse search; a peak is found between them. With 28 cells 2 of 336
# presses of six simulated parts got a worse pose, with 32 to 56 cells and 36 to 72 turns at most one.
_COARSE_CELLS, _TURNS = 32, 36
# Poses that are refined, and how often; one more round moves none by a hundredth of a pixel. After the first round
# those alone that match best go on and are rated: of 1,300 presses of 15 real and simulated parts none got a worse pose
# by that, with four 3 of them did.
_CANDIDATES, _RATED, _FIRST_ROUNDS, _FINE_ROUNDS = _TURNS, 8, 3, 2
# A part near its own pose needs five rounds where it lies within 0.15 mm, seven at a millimetre. The smaller picture is
# left, and the search ends, after a round that moved it by less, pixels of each.
_NEAR_ROUNDS, _SMALL_STILL_PX, _STILL_PX = 10, 0.3, 0.05
_INSIDE_POWER = 0.05
# Slopes of a press count up to this many times the steepest of the learnt part: a dark spot or a hair must not hide
# where the part lies. No sound press of two real balls and of a simulated one on a marker gel has steeper ones.
_STEEPER = 2.0
# A part lies beside itself from three pixels of the smaller picture on, 0.75 mm of a Mini; before it is refined a shift
# agrees by up to so much less.
_BESIDE_PX, _ALIKE_DOUBT = 3.0, 0.15
# A held part that repeats itself lies elsewhere than next to the bank's pose where it agrees better by more than this:
# a plate of ridges, turned by 2 degrees, agreed by 0.57 a pitch off and by 0.94 at its place.
_CLEARLY = 0.05
# Less of a part says nothing of it.
_LEAST_INSIDE = 0.25
# What the agreement at the telling places counts beside that of all. Of a connector with three pins right turns gained
# 8 times there of what they lost in all, and more; of a long edge wrong ones gained 2.6 times of it at most.
_TELLING = 0.2
_TINY = float(np.finfo(np.float32).tiny)


def shrunk(picture: F32, side: int = SIDE_PX) -> F32:
    """The picture with this longer side, (h, w, c); a smaller one as it is."""
    h, w = picture.shape[:2]
    factor = side / max(h, w)
    if factor >= 1:
        return picture
    size = max(1, round(w * factor)), max(1, round(h * factor))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


class PoseSearch:
    """Finds a part. slopes: float32 (h, w, 2), shrunk. is_turning: False where the part has no turn, as a ball.

    nearly: as `PartInPose`. By all of a press such turns agree nearly as well, and its light, which does not turn with
    the part, may decide; so they are compared again at the places where the part differs from itself turned so.
    """

    def __init__(self, slopes: F32, is_turning: bool = True, nearly: int = 1) -> None:
        small, cells = shrunk(slopes, SIDE_PX // 2), shrunk(slopes, _COARSE_CELLS)
        self._factor = max(slopes.shape) / max(small.shape)
        self._cell = max(small.shape) / max(cells.shape)
        self._coarse = CoarseSearch(cells, _TURNS if is_turning else 1)
        self._middle = FineSearch(small, is_turning)
        self._fine = FineSearch(slopes, is_turning)
        turns = [2 * math.pi * k / nearly for k in range(1, nearly)]
        self._steps = [one.pose for one in self.find_at(slopes, turns)]
        turned = np.stack([slopes, *(turn_slopes(slopes, step) for step in self._steps)])
        inside = [field_depth(step, slopes.shape[:2]) >= 1 for step in (Pose(), *self._steps)]
        self._tells = turned.var(axis=0).sum(axis=2) * np.logical_and.reduce(inside)

    def find(self, slopes: F32) -> Alignment:
        """Find the best pose. It is in pixels of these slopes, float32 (h, w, 2) in the size of the part's."""
        first = self._coarse.candidates(shrunk(slopes, _COARSE_CELLS), _CANDIDATES)
        best = self._refine(slopes, first)
        return best if not self._steps else self.rate_turns(slopes, best)[0][1]

    def rate_turns(self, slopes: F32, best: Alignment) -> list[tuple[float, Alignment]]:
        """Rate the turns at which the part nearly looks the same, the best first: by all of a press, and by the places
        that tell them apart."""
        others = [self._fine.align(slopes, best.pose.after(step), _FINE_ROUNDS) for step in self._steps]
        alike = [best, *(one for one in others if one.match > best.match - _CLEARLY)]
        rated = [(one.match + _TELLING * self._tell(slopes, one.pose), one) for one in alike]
        return sorted(rated, key=lambda each: -each[0])

    def _tell(self, slopes: F32, pose: Pose) -> float:
        """Correlate a press in a pose with the part at the places that tell its turns apart."""
        part, moved = self._fine.slopes, turn_slopes(slopes, pose)
        weight = (self._tells * (field_depth(pose, part.shape[:2]) >= 1))[..., None]
        energy = float((weight * moved * moved).sum()) * float((weight * part * part).sum())
        return float((weight * moved * part).sum()) / math.sqrt(max(energy, _TINY))

    def find_at(self, slopes: F32, turns_rad: Iterable[float]) -> list[Alignment]:
        """Find the best pose near each of these turns; slopes and poses as for `find`."""
        cells = shrunk(slopes, _COARSE_CELLS)
        return [
            self._refine(slopes, first) for first in self._coarse.candidates_at(cells, _CANDIDATES, turns_rad)
        ]

    def _refine(self, slopes: F32, first: Sequence[tuple[Pose, float]]) -> Alignment:
        small = shrunk(slopes, SIDE_PX // 2)
        coarse = [pose.scale(self._cell) for pose, _ in first]
        tried = self._middle.refine_best(small, coarse, _FIRST_ROUNDS, _RATED)
        best = max(tried, key=lambda pose: self._worth(small, pose))
        return self._fine.align(slopes, best.scale(self._factor), _FINE_ROUNDS)

    def find_near(self, slopes: F32) -> Alignment:
        """Find the pose that is nearest to the part's own; slopes and pose as for `find`."""
        near, _ = self._middle.settle(shrunk(slopes, SIDE_PX // 2), Pose(), _NEAR_ROUNDS, _SMALL_STILL_PX)
        return self._fine.align(slopes, near.scale(self._factor), _NEAR_ROUNDS, _STILL_PX)

    def repeats(self, least_match: float, least_inside: float) -> bool:
        """Tell whether the part looks nearly the same somewhere beside itself: a pitch further on, or along an edge.

        It agrees there by `least_match` where it shows, at least this share of it.
        """
        part = self._middle.slopes
        starts = shifts_alike(part, _CANDIDATES, _BESIDE_PX, least_match - _ALIKE_DOUBT, least_inside)
        for pose in self._middle.refine(part, starts, _NEAR_ROUNDS) if starts else []:
            match, inside = self._middle.agreement(part, pose)
            if (
                match >= least_match
                and inside >= least_inside
                and math.hypot(pose.x_px, pose.y_px) >= _BESIDE_PX
            ):
                return True
        return False

    def _worth(self, slopes: F32, pose: Pose) -> float:
        """Weigh a pose: a regular part agrees with itself a pitch further on, where less of it lies in the field.

        The small power lets a clearly better match win all the same.
        """
        match, inside = self._middle.agreement(slopes, pose)
        return match * float(inside**_INSIDE_POWER)


# Interpolation reads two pixels around a place, and a resized picture is less sharp at its rim.
_RIM_PX = 2
# A part shows where its slopes are at least this share of its steepest, or within the closing of such places.
_RELIEF_SHARE, _CLOSED_SHARE = 0.1, 0.05
# Width of the seam between what is seen and what fills the rest.
_FADE_SHARE = 0.03


@dataclass(frozen=True, eq=False)
class PartInPose:
    """What is needed to find a part."""

    free: U8
    """The free gel, uint8 (h, w, 3)."""
    template: U8
    """The mean nominal press in the bank's pose, uint8 (h, w, 3)."""
    learnt: Mask
    """bool (h, w): places of the bank that enough nominal presses show."""
    colours: SlopeColours
    symmetry: int = 1
    """The part looks the same this many times in a full turn: 1 where its turn is known, 0 for a round part without."""
    nearly: int = 1
    """It nearly looks the same this many times: a press may be turned by such a part of a turn; 0 by other angles. As
    often as `symmetry` where nominal presses do not tell these turns apart."""
    least_match: float = 0.5
    """Below it a press shows no such part."""
    least_seen: float = 0.5
    """The share of the part that must lie in the field."""
    is_held: bool = False
    """A fixture or a hand holds it: where it looks nearly the same a pitch or half a turn away, the pose next to the
    bank's is meant. Where it is not recognised there, or repeats itself and agrees clearly better elsewhere, it is
    looked for anywhere."""
    scores_relief_to_end: bool = True
    """Score relief up to the end of what a press shows; bundles of earlier fits leave the seam unscored."""
    gel_limits: F32 | None = None
    """How many times the limit is at each place of the gel, float32 (h, w) of the press, at least 1: sound presses
    score high at a cut wherever their part lies. None for one limit everywhere."""

    @property
    def is_turning(self) -> bool:
        """False for a round part, which has no turn."""
        return self.symmetry > 0

    def __post_init__(self) -> None:
        if not self.free.shape == self.template.shape == (*self.learnt.shape, 3):
            raise ValueError(
                f"free gel, template and learnt places have one size, found {self.free.shape}, "
                f"{self.template.shape} and {self.learnt.shape}"
            )
        if self.gel_limits is not None and (
            self.gel_limits.shape != self.learnt.shape or not self.gel_limits.min() >= 1
        ):
            raise ValueError(
                f"limits of the gel are at least 1 in the size {self.learnt.shape}, found {self.gel_limits.shape}"
            )
        if not (0 < self.least_match < 1 and 0 <= self.least_seen <= 1):
            raise ValueError(
                f"least_match lies in (0, 1) and least_seen in [0, 1], found {self.least_match}, {self.least_seen}"
            )

    def open(self) -> "Registrar":
        """Make what finds it in presses."""
        return Registrar(self)


class Registrar:
    """Finds a part and brings it to the bank's pose."""

    def __init__(self, part: PartInPose) -> None:
        self.part = part
        self.light = FreeLight(part.free)
        self._template = self.light.find_change(part.template) * part.learnt[..., None]
        self._ground = self.light.levels(self._template)
        slopes = part.colours.slopes(shrunk(self._template))
        self._search = PoseSearch(slopes, part.is_turning, part.nearly)
        self._steepest = _STEEPER * float(_steepness(slopes).max())
        self._factor = max(part.learnt.shape) / max(slopes.shape)
        self._shown = find_relief(part.colours.slopes(self._template)) & part.learnt
        self._shown_px = max(1, int(np.count_nonzero(self._shown)))
        self._away = depth_of(part.learnt)
        to_end = self._shown if part.scores_relief_to_end else np.zeros_like(self._shown)
        least_inside = max(_LEAST_INSIDE, 2 * part.least_seen - 1)  # half a pitch off, either way
        self.is_unique = part.symmetry == 1 and not self._search.repeats(part.least_match, least_inside)
        self._least_depth = np.where(to_end, np.float32(1), np.float32(_fade_px(part.learnt.shape)))

    def register(self, rgb: U8) -> Registered:
        """The press in the bank's pose. rgb: uint8 (h, w, 3). Errors: ValueError for another size."""
        if rgb.shape != self.part.free.shape or rgb.dtype != np.uint8:
            raise ValueError(
                f"a press to register is uint8 {self.part.free.shape}, found {rgb.dtype} {rgb.shape}"
            )
        added = self.light.find_change(rgb)
        alignment = self._find(_limit(self.part.colours.slopes(shrunk(added)), self._steepest))
        pose = alignment.pose.scale(self._factor)
        moved = turn_colours(added, pose, self.part.colours)
        away = field_depth(pose, self.part.learnt.shape)
        seen_share = int(np.count_nonzero((away >= 1) & self._shown)) / self._shown_px
        np.minimum(away, self._away, out=away)
        moved -= self._template
        x, y, turn = np.sqrt(np.maximum(np.diag(alignment.covariance), 0)).tolist()
        return Registered(
            self.light.apply_change(self._ground, moved, fade(away, away.shape)),
            away >= self._least_depth,
            pose,
            PoseUncertainty(self._factor * x, self._factor * y, turn if self.part.is_turning else None),
            alignment.match,
            seen_share,
            self.part.symmetry,
            self._refusal(alignment.match, seen_share),
            None if (limits := self.part.gel_limits) is None else gel_limits_in_pose(limits, pose),
            self.is_unique,
        )

    def _find(self, slopes: F32) -> Alignment:
        near = self._search.find_near(slopes) if self.part.is_held else None
        is_alone = self.is_unique and self.part.nearly == 1
        if near and near.match >= (self.part.least_match if is_alone else 1 - _CLEARLY):
            return near
        best = self._search.find(slopes)
        is_near = near and near.match >= max(self.part.least_match, best.match - _CLEARLY)
        return near if near and is_near else best

    def _refusal(self, match: float, seen_share: float) -> str | None:
        if not match >= self.part.least_match:
            agrees, least = score_texts(match, self.part.least_match, 2)
            return Sentence(
                f"the part is not recognised: at its best place the press agrees with the nominal ones by {agrees}, at "
                f"least {least} is expected; check which part is pressed, that its relief lies on the gel, and that "
                "the gel is clean"
            )
        if seen_share < self.part.least_seen:
            share, most = score_texts(1 - seen_share, 1 - self.part.least_seen, 0, "%")
            return Sentence(
                f"{share} of the part lie outside the inspected region, at most {most} are accepted; press it nearer "
                "to the middle"
            )
        return None


def _limit(slopes: F32, steepest: float) -> F32:
    """Return slopes of which none is steeper, float32 (h, w, 2)."""
    steep = _steepness(slopes)
    if steep.max() <= steepest:
        return slopes
    return np.asarray(slopes * (steepest / np.maximum(steep, steepest))[..., None], np.float32)


def _steepness(slopes: F32) -> F32:
    """Compute the length of slopes, float32 (h, w); np.linalg.norm is ten times slower on pairs."""
    across, down = slopes[..., 0], slopes[..., 1]
    return np.asarray(np.sqrt(across * across + down * down), np.float32)


def in_pose(added: F32, pose: Pose, colours: SlopeColours) -> tuple[F32, Mask]:
    """Bring to the bank's pose what a press adds, (h, w, 3), and the places that its field shows, bool (h, w)."""
    return turn_colours(added, pose, colours), np.asarray(field_depth(pose, added.shape[:2]) >= 1)


def turn_colours(added: F32, pose: Pose, colours: SlopeColours) -> F32:
    """Bring to the bank's pose what a press adds, float32 (h, w, 3)."""
    return np.asarray(
        cv2.transform(warp(added, pose, cv2.INTER_CUBIC), colours.turn_matrix(-pose.turn_rad)), np.float32
    )


def field_depth(pose: Pose, shape: tuple[int, ...]) -> F32:
    """Measure how far each place of the bank lies inside what a press shows, float32 (h, w), px; 0 and less: unseen."""
    depth = depth_inside(pose, (shape[1], shape[0]))
    depth -= np.float32(_RIM_PX - 1)
    return depth


def depth_of(shows: Mask) -> F32:
    """Measure how far inside these places each of them lies, float32 (h, w), pixels; 0 for the others."""
    framed = cv2.copyMakeBorder(shows.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return np.asarray(cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1], np.float32)


def fade(away: F32, frame: tuple[int, ...]) -> F32:
    """Weigh how much each place shows of a press, 0 to 1: it fades into what fills it, for a seam would score.

    away: from the end of what the press shows, as `depth_of`. frame: the shape of a complete press.
    """
    return np.asarray(np.clip(away * np.float32(1 / _fade_px(frame)), 0, 1))


def _fade_px(shape: tuple[int, ...]) -> int:
    return max(1, round(_FADE_SHARE * max(shape)))


def find_relief(slopes: F32) -> Mask:
    """Find where a part has relief, bool (h, w), and what such places enclose narrowly. slopes: float32 (h, w, 2)."""
    steep = cv2.blur(_steepness(slopes), (5, 5))
    relief = (steep > _RELIEF_SHARE * float(steep.max())).astype(np.uint8)
    side = 2 * round(_CLOSED_SHARE * max(relief.shape)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return np.asarray(cv2.morphologyEx(relief, cv2.MORPH_CLOSE, kernel) > 0)
