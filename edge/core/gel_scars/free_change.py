"""The free gel between two presses, and what has changed on it: the marks that it will show under every part.

Light and shading are taken out, and the imprint that the last press has left behind.
"""

from collections import deque
from dataclasses import dataclass
from typing import final

import cv2
import numpy as np

from edge.core.arrays import F32, Mask
from edge.core.contact.mask import largest_colour, squared_distance
from edge.core.contact.reference import View, fit_levels
from edge.core.contact.table import State

__all__ = ["FreeViews", "Marks", "find_clear_marks", "marks"]

# Lengths are in pixels of the 160x120 view, 0.127 mm each on a GelSight Mini, and scale with the view.
_PIXELS_ACROSS = 160
# Wider changes are shading: 2 mm (sigma). Worn coat is up to 2.5 mm across.
_SHADING_SIGMA = 16.0
# Averages the noise of single pixels.
_NOISE_SIGMA = 0.7
# 5 to 25 % of a press's signal is still there half a second after its release (docs/simulator.md).
_MOST_LEFT = 0.3
# Light is not linear in the slope: of what the last press has left, this share may remain when it is taken out.
_LEFT_DOUBT = 0.3
# Just after a release more is left, and less alike of shallow and of deep places: all of it may be what is seen.
_FRESH_DOUBT = 1.0
# A marker dot or a dark rim moves by a fraction of a pixel between presses: what such a move would change is no mark.
_MOVES_PX = 0.25
# A change of this many levels is a mark, or of this many times the median change where the pictures are noisier. Chosen
# on simulated gels (docs/gel.md): every scar that makes a sound part fail has more.
_MARK_LEVELS = 1.2
_MARK_TIMES = 5.0
# A person is told of a mark that no press exceeds by only where it is plain to see, also in a single frame: finer than
# 0.3 mm (sigma), as grains, hairs and cuts are and stains of a worn coat are not, and of so many levels beside so many
# times the doubt that the gel has moved. Of simulated gels up to twice their life, of public pictures of one gel at two
# times, of presses on four gels and of a film of a marker gel none shows one at one place five times. A grain 0.2 mm
# across and 0.05 mm high shows each time.
_CLEAR_SIGMA = 2.5
_CLEAR_LEVELS = 2.2
_CLEAR_TIMES = 4.0
_CLEAR_DOUBTS = 3.0
# A mark is wider than what is clearly seen of it: its change counts up to this distance, and fades there over this many
# pixels (sigma), because a sharp end would be an edge in the picture.
_AROUND_PX = 3
_FADES_SIGMA = 1.0


@dataclass(frozen=True, eq=False)
class Marks:
    """Where the free gel is marked, bool (h, w), and how it has changed there, signed levels, float32 (h, w, 3): 0 away
    from the marks."""

    places: Mask
    change: View


def marks(first: View, now: View, left: View | None = None, *, is_fresh: bool = False) -> Marks | None:
    """Find the marks of the free gel; None where it has changed all over: a moved camera, or another gel.

    first, now: pictures of the free gel, means of several frames. left: what the press before added to it, whose rest
    may still be there. All float32 (h, w, 3). is_fresh: `now` is of a moment after the release. Errors: ValueError for
    two shapes.
    """
    detail, doubtful = _compare(first, now, left, _FRESH_DOUBT if is_fresh else _LEFT_DOUBT)
    levels = np.maximum(largest_colour(np.abs(_smooth(detail, _NOISE_SIGMA))) - doubtful, 0)
    places = _clear(levels, float(np.median(levels)), _MARK_LEVELS, _MARK_TIMES)
    return None if places is None else Marks(places, _at(places, detail))


def find_clear_marks(first: View, now: View, left: View | None = None) -> Mask | None:
    """Find the marks that are plain to see, bool (h, w), also in a picture of one frame; None as of `marks`. What lay
    on the gel in its first picture and is gone is none."""
    detail, doubtful = _compare(first, now, left, _LEFT_DOUBT)
    seen = largest_colour(np.abs(_smooth(detail, _NOISE_SIGMA) - _smooth(detail, _CLEAR_SIGMA)))
    levels = seen - np.float32(_CLEAR_DOUBTS) * doubtful
    places = _clear(levels, float(np.median(seen)), _CLEAR_LEVELS, _CLEAR_TIMES)
    if places is None or not places.any():
        return places
    before = _detail(first)
    return places & (_energy(before + detail) > _energy(before))


def _smooth(view: View, sigma: float) -> View:
    return np.asarray(cv2.GaussianBlur(view, (0, 0), sigma * _scale(view)), np.float32)


def _energy(detail: View) -> F32:
    """Measure how much structure lies around each pixel, levels squared, float32 (h, w)."""
    return np.asarray(cv2.boxFilter(squared_distance(detail), -1, (5, 5)), np.float32)


def _compare(first: View, now: View, left: View | None, left_doubt: float) -> tuple[View, F32]:
    """Return what has changed, signed levels, float32 (h, w, 3), and how much of it may be no mark, float32 (h, w)."""
    if first.shape != now.shape or first.ndim != 3 or first.shape[2] != 3:
        raise ValueError(
            f"two free-gel pictures have one shape (h, w, 3), found {first.shape} and {now.shape}"
        )
    detail, doubtful = _detail(fit_levels(now, first).applied(now) - first), _apparent_change(first)
    if left is None:
        return detail, doubtful
    rest = _find_rest(detail, _detail(left))
    return detail - rest, doubtful + np.float32(left_doubt) * _widest(rest, 1)


def _clear(levels: F32, typical: float, least: float, times: float) -> Mask | None:
    """Find where a change is a mark, bool (h, w); single pixels are noise. None where all of it has changed. A mark has
    `least` levels, and so many times the change that is `typical`."""
    if typical > least:
        return None
    far = (levels > max(least, times * typical)).astype(np.uint8)
    neighbours = cv2.boxFilter(far, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray((far > 0) & (neighbours >= 2))


def _at(places: Mask, detail: View) -> View:
    """Keep what lies at these places and around, and put 0 elsewhere."""
    if not places.any():
        return np.zeros_like(detail)
    scale = _scale(detail)
    away = cv2.distanceTransform((~places).astype(np.uint8), cv2.DIST_L2, 5)
    share = cv2.GaussianBlur((away <= _AROUND_PX * scale).astype(np.float32), (0, 0), _FADES_SIGMA * scale)
    return np.asarray(detail * share[..., None], np.float32)


def _apparent_change(first: View) -> F32:
    """Compute what would seem to change if the gel moved a little, levels, float32 (h, w)."""
    scale = _scale(first)
    across, down = (cv2.Sobel(first, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    return np.float32(_MOVES_PX * scale) * _widest(
        np.maximum(np.abs(across), np.abs(down)), max(1, round(scale))
    )


def _widest(view: View, reach: int) -> F32:
    """The largest of all colours within this many pixels, float32 (h, w)."""
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.dilate(largest_colour(np.abs(view)), kernel), np.float32)


def _find_rest(detail: View, left: View) -> View:
    """Return the share of the last press that explains most of the change, by least squares, times that press."""
    energy = float(np.vdot(left, left))
    if energy <= 0:
        return np.zeros_like(left)
    share = min(max(float(np.vdot(detail, left)) / energy, 0.0), _MOST_LEFT)
    return np.asarray(np.float32(share) * left, np.float32)


def _detail(view: View) -> View:
    sigma = _SHADING_SIGMA * _scale(view)
    # A small kernel on a quarter of the pixels: shading has no detail.
    small = cv2.resize(view, (view.shape[1] // 4, view.shape[0] // 4), interpolation=cv2.INTER_AREA)
    shading = cv2.GaussianBlur(small, (0, 0), sigma / 4, borderType=cv2.BORDER_REFLECT)
    return np.asarray(
        view - cv2.resize(shading, (view.shape[1], view.shape[0]), interpolation=cv2.INTER_LINEAR), np.float32
    )


def _scale(view: View) -> float:
    return float(view.shape[1] / _PIXELS_ACROSS)


# About this many views are averaged: a second of an idle station, whose last ones count most.
_AVERAGED = 10
# Fewer are of a moment: of at most half a second after the release.
_SEVERAL = 3
# The last views before a press may show its approach: as long, which is more than one look at an idle gel (0.15 s), and
# two frames of ten a second, which leaves one of a lift of 0.3 s.
_HELD_BACK_NS = 180_000_000

_FREE = (State.NO_CONTACT, State.RECOVERY)


@final
class FreeViews:
    """Feed every view that is looked at; the mean is of those after the last press. It keeps few views."""

    def __init__(self) -> None:
        self._mean: View | None = None
        self._count = 0
        self._waiting: deque[tuple[int, View]] = deque()
        self._was_free = False

    def see(self, state: State, view: View | None, timestamp_ns: int, *, is_faint: bool = False) -> None:
        """Take a view, float32 (h, w, 3); None while none is known. state: of the contact table, with this view.
        is_faint: something may touch all the same."""
        is_free = state in _FREE and view is not None
        if is_free and not self._was_free:
            self._mean, self._count = None, 0
        while view is not None and self._waiting and timestamp_ns - self._waiting[0][0] >= _HELD_BACK_NS:
            self._add(self._waiting.popleft()[1])
        if view is not None and is_free and not is_faint:
            self._waiting.append((timestamp_ns, view))
        else:
            self._waiting.clear()
        self._was_free = is_free

    def mean(self) -> View | None:
        """The free gel after the last press, float32 (h, w, 3), of one view at least; None where it was not seen, or
        just before the next press alone."""
        return self._mean

    @property
    def is_fresh(self) -> bool:
        """Whether the mean is of a moment after the release of the last press alone."""
        return self._count < _SEVERAL

    def clear(self) -> None:
        """Forget it: another gel is mounted."""
        self._mean, self._count, self._was_free = None, 0, False
        self._waiting.clear()

    def _add(self, view: View) -> None:
        self._count += 1
        if self._mean is None:
            self._mean = view.copy()
        else:
            self._mean = self._mean + np.float32(1 / min(self._count, _AVERAGED)) * (view - self._mean)
