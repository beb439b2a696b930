"""Which presses do not belong to the others, a sentence for each reason that names them and says what to do."""

import re
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.free_gel import view_of
from edge.core.contact.mask import squared_distance, touched
from edge.core.contact.reference import Reference
from edge.core.contact.settings import ContactSettings
from edge.core.imaging.quality import check_light

__all__ = [
    "find_copies",
    "find_empty",
    "find_misexposed",
    "find_pieces",
    "find_repeated",
    "find_strangers",
    "list_names",
    "small_view",
]

U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_FEWEST, _WITNESSES = 3, 16
# In levels, in the median over the view, and times the usual distance to the nearest press. That distance is 1.8 to 4.0
# on real and simulated sets, at most 2.5 times as much for a press; one that is mirrored is 8 to 18 away, one that is
# turned 20 and more, one of another unit 8 and more.
_STRANGE_LEVELS, _STRANGE_TIMES = 6.0, 3.0
# Two presses of one part in a fixture differ by 2.8 levels and more at some place of 0.4 mm, two frames of one press by
# 1.1, a copy that was compressed again by 1.
_SAME_LEVELS, _PLACE_PX = 2.0, 1.5
# In a film a frame differs from the next one by this share of what any two do at most, and most frames are most like a
# neighbour: of a rolling finger by 0.34, and 83 % are; of seven sets of presses one by one by 0.95 and more, and 15 %.
_FEWEST_FRAMES, _MOST_FRAMES, _FILM_SHARE = 8, 48, 0.5
# Levels of presses of 15 real and simulated parts lie within 0.92 and 1.07 of their median.
_EXPOSED_TIMES = 1.25
_MOST_NAMES = 8


def small_view(picture: U8) -> U8:
    """Return a picture in the size of contact detection, uint8 (120, 160, 3): of many presses little memory."""
    return np.asarray(np.rint(view_of(picture)), np.uint8)


def find_strangers(names: Sequence[str], views: Sequence[U8]) -> list[str]:
    """Name the presses of another light than most others. views: uint8 (120, 160, 3) each.

    Presses belong together that are near one another, or near a third one, in the median over the view: between the
    parts, so that no light has to be known. None are named of two presses, which do not tell who is the stranger.
    """
    if len(views) < _FEWEST:
        return []
    rows = np.unique(np.linspace(0, len(views) - 1, _WITNESSES).round().astype(int))
    levels = np.stack([_levels(views[k], views) for k in rows], axis=1)
    levels[rows, np.arange(len(rows))] = np.inf
    most = max(_STRANGE_LEVELS, _STRANGE_TIMES * float(np.median(levels.min(axis=1))))
    is_near = levels <= most
    is_near[rows, np.arange(len(rows))] = True
    belongs = is_near[:, is_near.sum(axis=0).argmax()]
    while np.any(more := is_near[:, belongs[rows]].any(axis=1) & ~belongs):
        belongs = belongs | more
    strange = np.flatnonzero(~belongs)
    if not len(strange):
        return []
    away = levels[strange][:, belongs[rows]].min()
    return [
        f"between the parts {list_names([names[k] for k in strange.tolist()], len(names))} differ from the others, by "
        f"{away:.0f} levels or more: turned or mirrored, or of another light, gel or sensor; look at them, and leave "
        f"them out (--leave-out '{names[int(strange[0])]}')"
    ]


def find_empty(names: Sequence[str], masks: Sequence[Mask | None]) -> list[str]:
    """Name the presses that show no contact. masks: where each touches in the view; None where it is not known."""
    known = [(name, mask) for name, mask in zip(names, masks, strict=True) if mask is not None]
    empty = [name for name, mask in known if touched(mask).area < ContactSettings.on_area]
    if not empty:
        return []
    if 2 * len(empty) > len(known):
        why = "the picture of the free gel may be of a press; take one with nothing on the gel"
    else:
        why = f"they may be of the free gel; look at them, and leave them out (--leave-out '{empty[0]}')"
    return [f"no contact is seen in {list_names(empty, len(known))}: {why}"]


def find_misexposed(names: Sequence[str], views: Sequence[U8]) -> list[str]:
    """Name the presses that a gateway rejects as saturated, and those of another exposure. views: as above."""
    said = []
    if bright := [n for n, view in zip(names, views, strict=True) if check_light(view) is not None]:
        said.append(
            f"too bright a light in {list_names(bright, len(names))}: a gateway rejects such presses; lower the "
            f"exposure and press again, or leave them out (--leave-out '{bright[0]}')"
        )
    levels = np.array([np.median(view) for view in views]) + 1
    times = levels / np.sort(levels)[len(levels) // 2]
    odd = np.flatnonzero(np.maximum(times, 1 / times) > _EXPOSED_TIMES).tolist()
    if odd and len(views) >= _FEWEST:
        said.append(
            f"another exposure in {list_names([names[k] for k in odd], len(names))}: the level of "
            f"'{names[odd[0]]}' is {times[odd[0]]:.2f} times that of the others; fix the exposure and press again, or "
            f"leave them out (--leave-out '{names[odd[0]]}')"
        )
    return said


def find_copies(names: Sequence[str], frames: Sequence[U8]) -> list[str]:
    """Name the presses that are exact copies of an earlier one. frames: uint8 (h, w, 3) each."""
    first: dict[bytes, int] = {}
    copies = [k for k, rgb in enumerate(frames) if first.setdefault(rgb.tobytes(), k) != k]
    if not copies:
        return []
    return [
        f"{list_names([names[k] for k in copies], len(names))} are exact copies of another: they teach nothing; "
        "give each press once"
    ]


def find_repeated(
    names: Sequence[str], views: Sequence[U8], pieces: Sequence[str | None]
) -> tuple[list[str], list[str | None]]:
    """Name the presses that differ from another by noise alone; not its exact copies. views: as above.

    Returns the pieces too, None where unknown: copies, and presses that are the same without another piece's name, are
    of one piece, so that none is held out while another is learnt.
    """
    broad = _blur(views)
    same, found = list[str](), list(pieces)
    named_first = sorted(range(len(broad)), key=lambda k: pieces[k] is None)
    for place, k in enumerate(named_first[1:], 1):
        away = {one: float(np.abs(broad[k] - broad[one]).max()) for one in named_first[:place]}
        first = min(away, key=away.__getitem__)
        is_copy, is_same = away[first] == 0, away[first] < _SAME_LEVELS
        same += [names[k]] if is_same and not is_copy else []
        if is_copy or (is_same and found[k] is None):
            found[first] = found[k] = found[first] or names[first]
    if not same:
        return [], found
    return [
        f"{list_names(same, len(names))} are the same as another, but for noise: they teach nothing, and count "
        "as one piece where no other is named; give each press once"
    ], found


def find_pieces(
    names: Sequence[str], views: Sequence[U8], pieces: Sequence[str | None]
) -> tuple[list[str], list[str | None], tuple[int, ...]]:
    """Find presses that are none of their own: what to say, the pieces, and the order of frames of one film.

    The order is empty for presses; a film is of one piece. views: as above.
    """
    same, found = find_repeated(names, views, pieces)
    film = () if any(piece is not None for piece in pieces) else _find_film(names, views)
    if not film:
        return same, found, ()
    first = names[film[0]]
    said = (
        f"the presses look like frames of one film: from '{first}' on each resembles the one before it. They count as "
        "one piece, and nothing is promised of other presses; lift the part between presses, and press anew"
    )
    return [*same, said], [first] * len(names), film


def _find_film(names: Sequence[str], views: Sequence[U8]) -> tuple[int, ...]:
    """Return the presses in the order of their numbers where each resembles the next one; none where they do not."""
    order = sorted(range(len(names)), key=lambda k: _split_numbers(names[k]))
    if len(order) < _FEWEST_FRAMES:
        return ()
    broad = np.stack(_blur([views[k] for k in order[:_MOST_FRAMES]]))
    away = np.stack([np.abs(broad - one).max(axis=(1, 2, 3)) for one in broad])
    next_one, any_two = np.median(np.diagonal(away, 1)), np.median(away[np.triu_indices(len(away), 1)])
    np.fill_diagonal(away, np.inf)
    is_near = np.abs(away.argmin(axis=1) - np.arange(len(away))) == 1
    return tuple(order) if next_one < _FILM_SHARE * any_two and is_near.mean() > _FILM_SHARE else ()


def _split_numbers(name: str) -> list[tuple[int, str]]:
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def list_names(names: Sequence[str], count: int) -> str:
    """Say which of so many presses are meant."""
    rest = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    quoted = ", ".join(f"'{name}'" for name in names[:_MOST_NAMES])
    return f"{len(names)} of {count} presses ({quoted}{rest})"


def _blur(views: Sequence[U8]) -> list[NDArray[np.float32]]:
    """Blur views a little, and take every second pixel, so that noise is small."""
    blurred = (cv2.GaussianBlur(view.astype(np.float32), (0, 0), _PLACE_PX) for view in views)
    return [np.asarray(one[::2, ::2], np.float32) for one in blurred]


def _levels(view: U8, others: Sequence[U8]) -> NDArray[np.float64]:
    """Measure by how many levels others differ from a view, in the median over it, float64 (n,)."""
    reference = Reference(view.astype(np.float32))
    differences = (reference.difference(one.astype(np.float32)) for one in others)
    return np.array([np.median(np.sqrt(squared_distance(one))) for one in differences])
