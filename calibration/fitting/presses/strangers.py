"""Which presses do not belong to the others, a sentence for each reason that names them and says what to do."""

import hashlib
import re
from collections.abc import Sequence

import cv2
import numpy as np

from calibration.fitting.presses.free_gel import view_of
from edge.core.arrays import F32, F64, U8, Mask
from edge.core.contact.mask import squared_distance, touched
from edge.core.contact.reference import fit_levels
from edge.core.contact.settings import ContactSettings
from edge.core.imaging.quality import check_light

__all__ = [
    "find_copies",
    "find_misexposed",
    "find_odd",
    "find_pieces",
    "find_repeated",
    "list_names",
    "merge_copies",
    "small_view",
]

_FEWEST, _WITNESSES = 3, 16
# In levels, in the median over the view, and times the usual distance to the nearest press. That distance is 1.8 to 4.0
# on real and simulated sets, at most 2.5 times as much for a press; one that is mirrored is 8 to 18 away, one that is
# turned 20 and more, one of another unit 8 and more.
_STRANGE_LEVELS, _STRANGE_TIMES = 6.0, 3.0
# Two presses of one part in a fixture differ by 2.8 levels and more at some place of 0.4 mm, two frames of one press by
# 1.1, under 3 or 10 % more light too once that is taken out, a copy that was compressed again by 1 to 2.3.
_SAME_LEVELS, _PLACE_PX = 2.0, 1.5
_COARSE = 4
# In a film frames differ from the next one by less than this share of what any two do, in the mean, and this share of
# the others at most is nearer than the next one. Of 60 stretches each of a finger's film (10 to 32 frames, 25 a second)
# all are known where every third frame is taken, 98 % of every fourth, 88 to 75 of every fifth to eighth, 52 and 32 of
# every ninth and tenth: there a frame is hardly more like the next than like another. Of 4,950 draws of 8 to 48 presses
# from 33 sets, real and simulated, 7 are called a film; of a ball that a hand moved on step by step three in four.
_FEWEST_FRAMES, _MOST_FRAMES, _FILM_SHARE, _NEARER_SHARE, _LEAST_SPREAD = 8, 48, 0.85, 0.3, 0.1
# Levels of presses of 15 real and simulated parts lie within 0.92 and 1.07 of their median.
_EXPOSED_TIMES = 1.25
# Grain is what a blur of a pixel takes away, at the quietest quarter of the places: of presses of 22 real and simulated
# sets 0.71 to 1.16 times that of the others; blurred by 2 pixels at most 0.61 on simulated ones, 0.49 on real ones.
_GRAIN_PX, _GRAIN_QUANTILE, _GRAIN_TIMES, _LEAST_GRAIN = 1.0, 0.25, 1.6, 0.1
# A lens out of focus leaves the grain. Where a press is steepest, a twentieth of the view, its slopes without a blur by
# 1.5 pixels of the view are so many times as steep as with it. The least gap below eight sharp presses or more, of
# their own range and 0.03: none on the same sets, and on 0.7 and 0.1 % of draws of 12 and 20 of their presses. Half
# blurred by 3 pixels under the grain of before: 15 of 28 sets, those of parts with edges.
_STEEP_PX, _STEEP_QUANTILE, _STEEP_RANGE, _BLURRED_GAP, _FEWEST_SHARP = 1.5, 0.95, 0.03, 0.8, 8
_MOST_NAMES = 8


def small_view(picture: U8) -> U8:
    """Return a picture in the size of contact detection, uint8 (120, 160, 3): of many presses little memory."""
    return np.asarray(np.rint(view_of(picture)), np.uint8)


def find_odd(
    names: Sequence[str], frames: Sequence[U8], views: Sequence[U8], masks: Sequence[Mask | None]
) -> list[str]:
    """Name the presses that do not belong to the others, touch nothing, are too bright, or of the others blurred.

    frames: uint8 (h, w, 3) each. views: uint8 (120, 160, 3) each. masks: where each touches in the view; None where it
    is not known.
    """
    strangers, belong = _find_strangers(names, views)
    return [
        *strangers,
        *_find_empty(names, masks),
        *find_misexposed(names, views),
        *find_blurred([names[k] for k in belong], [frames[k] for k in belong], [views[k] for k in belong]),
    ]


def _find_strangers(names: Sequence[str], views: Sequence[U8]) -> tuple[list[str], list[int]]:
    """Name the presses of another light than most others; return the rows of these. views: uint8 (120, 160, 3) each.

    Presses belong together that are near one another, or near a third one, in the median over the view: between the
    parts, so that no light has to be known. None are named of two presses, which do not tell who is the stranger.
    """
    if len(views) < _FEWEST:
        return [], list(range(len(views)))
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
        return [], list(range(len(views)))
    away = levels[strange][:, belongs[rows]].min()
    return [
        f"between the parts {list_names([names[k] for k in strange.tolist()], len(names))} differ from the others, by "
        f"{away:.0f} levels or more: turned or mirrored, or of another light, gel or sensor; look at them, and leave "
        f"them out (--leave-out '{names[int(strange[0])]}')"
    ], np.flatnonzero(belongs).tolist()


def _find_empty(names: Sequence[str], masks: Sequence[Mask | None]) -> list[str]:
    """Name the presses that show no contact."""
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
    sentences = []
    if bright := [n for n, view in zip(names, views, strict=True) if check_light(view) is not None]:
        sentences.append(
            f"too bright a light in {list_names(bright, len(names))}: a gateway rejects such presses; lower the "
            f"exposure and press again, or leave them out (--leave-out '{bright[0]}')"
        )
    levels = np.array([np.median(view) for view in views]) + 1
    times = levels / np.sort(levels)[len(levels) // 2]
    odd = np.flatnonzero(np.maximum(times, 1 / times) > _EXPOSED_TIMES).tolist()
    if odd and len(views) >= _FEWEST:
        sentences.append(
            f"another exposure in {list_names([names[k] for k in odd], len(names))}: the level of "
            f"'{names[odd[0]]}' is {times[odd[0]]:.2f} times that of the others; fix the exposure and press again, or "
            f"leave them out (--leave-out '{names[odd[0]]}')"
        )
    return sentences


def find_blurred(names: Sequence[str], frames: Sequence[U8], views: Sequence[U8]) -> list[str]:
    """Name the presses of another grain, else those less sharp than the others where they are steepest."""
    if len(names) < _FEWEST:
        return []
    todo = "take every picture in the same way and press again, or leave them out (--leave-out"
    grain = np.array([_measure_grain(rgb) for rgb in frames])
    times = grain / np.sort(grain)[len(grain) // 2]
    if odd := np.flatnonzero(np.maximum(times, 1 / times) > _GRAIN_TIMES).tolist():
        return [
            f"another sharpness in {list_names([names[k] for k in odd], len(names))}: the grain of '{names[odd[0]]}' "
            f"is {times[odd[0]]:.2f} times that of the others: blurred, resized or compressed otherwise; {todo} "
            f"'{names[odd[0]]}')"
        ]
    sharpness = np.array([_measure_sharpness(view) for view in views])
    order = np.argsort(sharpness, kind="stable")
    ordered = sharpness[order]
    for count in range(min(len(ordered) // 2, len(ordered) - _FEWEST_SHARP), 0, -1):
        if ordered[count] - ordered[count - 1] > _BLURRED_GAP * (np.ptp(ordered[count:]) + _STEEP_RANGE):
            odd = np.sort(order[:count]).tolist()
            return [
                f"{list_names([names[k] for k in odd], len(names))} are less sharp than the others: out of focus, or "
                f"moved; {todo} '{names[odd[0]]}')"
            ]
    return []


def _measure_grain(rgb: U8) -> float:
    """Measure what varies from pixel to pixel, as a share of the level."""
    levels = rgb.astype(np.float32)
    squared = squared_distance(levels - cv2.GaussianBlur(levels, (0, 0), _GRAIN_PX)).ravel()
    rank = int(_GRAIN_QUANTILE * squared.size)
    quiet = float(np.sqrt(np.partition(squared, rank)[rank]))
    return max(quiet, _LEAST_GRAIN) / (float(np.median(rgb)) + 1)


def _measure_sharpness(view: U8) -> float:
    """Measure how much steeper a view is without a blur, where it is steepest: the logarithm."""
    levels = view.astype(np.float32)
    blurred = np.asarray(cv2.GaussianBlur(levels, (0, 0), _STEEP_PX), np.float32)
    fine, broad = _slope_energy(levels), _slope_energy(blurred)
    steep = broad >= np.quantile(broad, _STEEP_QUANTILE)
    return float(np.log((fine[steep].mean() + _LEAST_GRAIN) / (broad[steep].mean() + _LEAST_GRAIN)))


def _slope_energy(levels: F32) -> F32:
    """Sum the squared slopes over the colours, levels squared per pixel squared, float32 (h, w)."""
    slopes = (cv2.Sobel(levels, cv2.CV_32F, *axis, ksize=3, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    across, down = (squared_distance(np.asarray(slope, np.float32)) for slope in slopes)
    return np.asarray(across + down, np.float32)


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


def merge_copies(
    frames: Sequence[U8], names: Sequence[str], pieces: Sequence[str | None]
) -> list[str | None]:
    """Return the pieces, None where unknown: exact copies are of one, whatever they are named. frames: as above."""
    first, merged_pieces = dict[bytes, int](), list(pieces)
    for k in sorted(range(len(frames)), key=lambda k: pieces[k] is None):
        original = first.setdefault(hashlib.sha256(frames[k].tobytes()).digest(), k)
        if original != k:
            merged_pieces[original] = merged_pieces[k] = merged_pieces[original] or names[original]
    return merged_pieces


def find_repeated(
    names: Sequence[str], views: Sequence[U8], pieces: Sequence[str | None]
) -> tuple[list[str], list[str | None]]:
    """Name the presses that differ from another by noise or light alone; not its exact copies. views: as above.

    Returns the pieces too, None where unknown: copies, and presses that are the same without another piece's name, are
    of one piece, so that none is held out while another is learnt.
    """
    same, merged_pieces = list[str](), list(pieces)
    if not views:
        return same, merged_pieces
    named_first = sorted(range(len(views)), key=lambda k: pieces[k] is None)
    blurred = np.stack(_blur(views))[named_first]
    broad = _take_out_light(blurred)
    few = broad[:, ::_COARSE, ::_COARSE].reshape(len(broad), -1)  # two that differ here are not the same
    for place, k in enumerate(named_first):
        near = np.flatnonzero(np.abs(few[:place] - few[place]).max(axis=1) < _SAME_LEVELS).tolist()
        away = {one: float(np.abs(broad[place] - broad[one]).max()) for one in near}
        nearest = min(away, key=away.__getitem__, default=None)
        if nearest is None or not away[nearest] < _SAME_LEVELS:
            continue
        first, is_copy = named_first[nearest], np.array_equal(blurred[place], blurred[nearest])
        same += [] if is_copy else [names[k]]
        if is_copy or merged_pieces[k] is None:
            merged_pieces[first] = merged_pieces[k] = merged_pieces[first] or names[first]
    if not same:
        return [], merged_pieces
    return [
        f"{list_names(same, len(names))} are the same as another, but for noise or light: they teach nothing, and "
        "count as one piece where no other is named; give each press once"
    ], merged_pieces


def find_pieces(
    names: Sequence[str], views: Sequence[U8], pieces: Sequence[str | None]
) -> tuple[list[str], list[str | None], tuple[int, ...]]:
    """Find presses that are none of their own: what to say, the pieces, and the order of frames of one film.

    The order is empty for presses; a film is of one piece. views: as above.
    """
    same, merged_pieces = find_repeated(names, views, pieces)
    film = () if any(piece is not None for piece in pieces) else _find_film(names, views)
    if not film:
        return same, merged_pieces, ()
    first = names[film[0]]
    sentence = (
        f"the presses look like frames of one film: from '{first}' on each resembles the one before it. They count as "
        "one piece, and nothing is promised of other presses; lift the part between presses, and press anew; where "
        "each of several pieces was pressed several times, name piece and press (bolt_head_s001_p01.png)"
    )
    return [*same, sentence], [first] * len(names), film


def _find_film(names: Sequence[str], views: Sequence[U8]) -> tuple[int, ...]:
    """Return the presses in the order of their numbers where each resembles the next one; none where they do not."""
    order = sorted(range(len(names)), key=lambda k: split_numbers(names[k]))
    if len(order) < _FEWEST_FRAMES:
        return ()
    broad = np.stack(_blur([views[k] for k in order[:_MOST_FRAMES]]))
    # A light that drifts makes no film: neither its level counts nor its gain.
    broad -= np.median(broad, axis=(1, 2), keepdims=True)
    spread = np.median(np.abs(broad), axis=(1, 2), keepdims=True)
    broad *= np.median(spread, axis=0) / np.maximum(spread, _LEAST_SPREAD)
    away = np.stack([np.sqrt(np.square(broad - one).mean(axis=(1, 2, 3))) for one in broad])
    next_one, any_two = np.diagonal(away, 1), away[np.triu_indices(len(away), 1)]
    nearer = (away[:-1] < next_one[:, None]).sum(axis=1) - 1  # each is nearest to itself
    is_film = next_one.mean() < _FILM_SHARE * any_two.mean() and nearer.mean() < _NEARER_SHARE * (
        len(away) - 2
    )
    return tuple(order) if is_film else ()


def split_numbers(name: str) -> list[tuple[int, str]]:
    """Split a name so that names sort by their numbers: press 9 before press 10."""
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def list_names(names: Sequence[str], count: int) -> str:
    """Say which of so many presses are meant."""
    rest = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    quoted = ", ".join(f"'{name}'" for name in names[:_MOST_NAMES])
    return f"{len(names)} of {count} presses ({quoted}{rest})"


def _blur(views: Sequence[U8]) -> list[F32]:
    """Blur views a little, and take every second pixel, so that noise is small."""
    blurred = (cv2.GaussianBlur(view.astype(np.float32), (0, 0), _PLACE_PX) for view in views)
    return [np.asarray(one[::2, ::2], np.float32) for one in blurred]


def _take_out_light(views: F32) -> F32:
    """Bring views (n, h, w, 3) to one mean of each colour, as one lamp of another strength would."""
    means = np.maximum(views.mean(axis=(1, 2), keepdims=True), 1)
    return np.asarray(views * (np.median(means, axis=0) / means), np.float32)


def _levels(view: U8, others: Sequence[U8]) -> F64:
    """Measure by how many levels others differ from a view, in the median over every second pixel, float64 (n,)."""
    reference = view.astype(np.float32)
    levels = (fit_levels(one.astype(np.float32), reference) for one in others)
    differences = (
        level.applied(one[::2, ::2].astype(np.float32)) - reference[::2, ::2]
        for level, one in zip(levels, others, strict=True)
    )
    return np.array([np.median(np.sqrt(squared_distance(difference))) for difference in differences])
