"""Nominal presses with small damage put into them, by which `fit` chooses a threshold, a pose, a method and a trunk.

Damage is put in two ways. Rendered from its height it knows the optics of the simulator, which a trunk may have been
trained with. A piece of another press's own relief, moved and shrunk, knows no simulator; where the part is smooth it
hardly shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damage import KINDS, Damage, Spot, surroundings
from calibration.fitting.damage.rendering import EditedPress, edit_touching
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.simulator.field_of_view import grids
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["DamagedPresses", "add_pieces", "damage_presses", "render_damage"]

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

SIZE_SHARES = (1 / 16, 1 / 8, 1 / 4)
"""Of a kind's largest size: dents of 0.025 to 0.1 mm, about the smallest that the shipped backbone shows."""

SPOTS = 16
"""Damage is rendered at this many places, in every size; fewer where frames are large, for the time that it takes."""

_FEWEST_SPOTS, _SPOTS_PX = 8, 16 * 320 * 240

PIECES = 96
"""Twice as many as of rendered damage. With 48 the choice changed with the draw where two trunks are close."""

# Standard deviations of a piece's elliptical window along its axes, and its half side; the piece is cut larger by a
# factor, and shrunk, so that it shows a smaller feature than the one that the part has.
_WINDOW_MM, _HALF_MM, _SHRUNK = (0.13, 0.29), 0.9, (1.2, 2.0)
# A pixel shows damage where it changes by this share of the largest change, in levels of the liveliest colour.
_VISIBLE, _LEAST_LEVELS = 0.25, 8.0
# Relief: levels summed over the colours, averaged over this many pixels, and the share of the largest.
_RELIEF_LEVELS, _RELIEF_SHARE, _AVERAGED_PX = 30.0, 0.3, 9
_DRAWS = 20
_CLOSED_PX = 7


@dataclass(frozen=True, eq=False)
class DamagedPresses:
    """Presses with damage, each a nominal press but for that."""

    frames: U8
    """uint8 (m, h, w, 3)."""
    press: NDArray[np.int64]
    """Which nominal press each was, (m,)."""
    masks: Mask
    """Where the damage is, bool (m, h, w): the pixels that show it, or where a score map may show it."""
    names: tuple[str, ...] = ()
    """Kind and size of each damage, where it was rendered."""

    def __len__(self) -> int:
        return len(self.press)

    def choose(self, rows: Sequence[int]) -> "DamagedPresses":
        """Return these presses alone."""
        kept = list(rows)
        names = tuple(self.names[k] for k in kept) if self.names else ()
        return DamagedPresses(self.frames[kept], self.press[kept], self.masks[kept], names)


def render_damage(
    presses: NominalPresses, profile: SensorProfile, region: Region, rng: np.random.Generator
) -> DamagedPresses | None:
    """Render damage in every size of SIZE_SHARES at some spots; the masks hold it and its surroundings.

    None without a picture of the free gel, or a contact to damage.
    """
    shown = edit_touching(presses, profile, region, rng, SPOTS)
    if not shown:
        return None
    turns = [k for _ in range(SPOTS) for k in shown]
    frames, press, near, names = [], [], [], []
    spots = max(_FEWEST_SPOTS, min(SPOTS, _SPOTS_PX // (region.width * region.height)))
    for number, k in enumerate(islice(turns, spots)):
        spot, kind = _draw_spot(shown[k], rng), list(KINDS)[number % len(KINDS)]
        for share in SIZE_SHARES:
            damage = Damage(kind, share * KINDS[kind].largest_mm, spot)
            frames.append(shown[k].render(damage))
            press.append(k)
            near.append(surroundings(damage, shown[k].station.field))
            names.append(f"{kind} of {share * KINDS[kind].largest_mm:.3g} mm")
    return DamagedPresses(np.stack(frames), np.array(press), np.stack(near), tuple(names))


def _draw_spot(press: EditedPress, rng: np.random.Generator) -> Spot:
    """Draw a spot anywhere in the contact, in any direction."""
    x, y = (axis[press.contact] for axis in grids(press.station.field))
    pick = rng.integers(len(x))
    return Spot(float(x[pick]), float(y[pick]), float(rng.uniform(0, np.pi)))


def damage_presses(
    presses: NominalPresses, profile: SensorProfile, region: Region, seed: int
) -> dict[str, DamagedPresses]:
    """Put each kind of damage into these presses, by its name; only what shows, and nothing without the free gel."""
    if presses.no_contact is None:
        return {}
    rendered = render_damage(presses, profile, region, np.random.default_rng(seed))
    found = (
        {}
        if rendered is None
        else {"rendered damage": _keep_visible(presses, rendered.frames, rendered.press)}
    )
    # Fewer where frames are large, as of rendered damage.
    count = PIECES if rendered is None else min(PIECES, 2 * len(rendered))
    rng = np.random.default_rng(seed)
    found["pieces of relief"] = add_pieces(presses, profile.pixels_per_mm, rng, count)
    return {name: one for name, one in found.items() if len(one)}


def add_pieces(
    presses: NominalPresses, pixels_per_mm: float, rng: np.random.Generator, count: int = PIECES
) -> DamagedPresses:
    """Presses with a piece of another press's relief, raised or sunk, somewhere in the contact; none where none shows.

    presses: with the free gel.
    """
    assert presses.no_contact is not None
    free = presses.no_contact.mean(axis=0, dtype=np.float64).astype(np.float32)
    reliefs = [_relief(rgb, free) for rgb in presses.frames]
    half = round(_HALF_MM * pixels_per_mm)
    places = [np.argwhere(_touched(one, half)) for one in reliefs]
    order, frames, of = rng.permutation(len(reliefs)).tolist(), [], []
    for number in range(count if len(reliefs) > 1 else 0):
        k = order[number % len(order)]
        for _ in range(_DRAWS):
            donor = int(rng.choice([other for other in order if other != k]))
            piece = _piece(reliefs[donor], places[donor], half, pixels_per_mm, rng)
            if piece is None or not len(places[k]):
                continue
            frames.append(_add(presses.frames[k], piece, places[k][rng.integers(len(places[k]))]))
            of.append(k)
            break
    return _keep_visible(presses, np.stack(frames) if frames else presses.frames[:0], np.array(of, np.int64))


def _relief(rgb: U8, free: F32) -> F32:
    """The difference to the free gel in levels, float32 (h, w, 3), without a change of the light."""
    difference = rgb.astype(np.float32) - free
    return np.asarray(difference - np.median(difference, axis=(0, 1)), np.float32)


def _touched(relief: F32, margin: int) -> Mask:
    """Find where there is relief, bool (h, w), away from the border."""
    levels = cv2.blur(np.abs(relief).sum(axis=2), (_AVERAGED_PX, _AVERAGED_PX))
    found = np.zeros(levels.shape, np.bool_)
    inner = (slice(margin, -margin), slice(margin, -margin))
    found[inner] = (levels > max(_RELIEF_LEVELS, _RELIEF_SHARE * float(levels.max())))[inner]
    return found


def _piece(
    donor: F32, places: NDArray[np.int64], half: int, pixels_per_mm: float, rng: np.random.Generator
) -> F32 | None:
    """A piece (2 half + 1, 2 half + 1, 3) that fades out and whose mean is 0; None where it would leave the picture."""
    if not len(places):
        return None
    wide = int(np.ceil(half * rng.uniform(*_SHRUNK)))
    row, column = places[rng.integers(len(places))].tolist()
    if min(row, column) < wide or row + wide >= donor.shape[0] or column + wide >= donor.shape[1]:
        return None
    cut = donor[row - wide : row + wide + 1, column - wide : column + wide + 1]
    small = cv2.resize(cut, (2 * half + 1, 2 * half + 1), interpolation=cv2.INTER_AREA)
    weight = _window(half, pixels_per_mm, rng)[..., None]
    level = (small * weight).sum(axis=(0, 1)) / weight.sum()
    return np.asarray(float(rng.choice([-1.0, 1.0])) * (small - level) * weight, np.float32)


def _window(half: int, pixels_per_mm: float, rng: np.random.Generator) -> F32:
    """A Gaussian that is longer in one direction, 1 in the middle, float32 (2 half + 1, 2 half + 1)."""
    along, across = rng.uniform(*_WINDOW_MM, 2) * pixels_per_mm
    turn = rng.uniform(0, np.pi)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    return np.asarray(np.exp(-0.5 * ((u / along) ** 2 + (v / across) ** 2)), np.float32)


def _add(rgb: U8, piece: F32, centre: NDArray[np.int64]) -> U8:
    half, (row, column) = len(piece) // 2, centre.tolist()
    changed = rgb.astype(np.float32)
    changed[row - half : row + half + 1, column - half : column + half + 1] += piece
    return np.asarray(np.clip(np.rint(changed), 0, 255), np.uint8)


def _keep_visible(
    presses: NominalPresses, frames: U8, of: Sequence[int] | NDArray[np.int64]
) -> DamagedPresses:
    """Keep those whose damage shows, and find where."""
    press = np.asarray(of, np.int64)
    masks = np.zeros(frames.shape[:3], np.bool_)
    for mask, rgb, k in zip(masks, frames, press, strict=True):
        change = cv2.absdiff(rgb, presses.frames[k]).max(axis=2)
        if change.max() >= _LEAST_LEVELS:
            mask[:] = _close_gaps(change > _VISIBLE * change.max())
    kept = masks.any(axis=(1, 2))
    return DamagedPresses(frames[kept], press[kept], masks[kept])


def _close_gaps(changed: Mask) -> Mask:
    """Drop single pixels, which compression changes anywhere, and close the gaps between bright and dark sides."""
    grown = (cv2.blur(changed.astype(np.float32), (3, 3)) > 0.4).astype(np.uint8)
    gap = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_CLOSED_PX, _CLOSED_PX))
    return np.asarray(cv2.morphologyEx(grown, cv2.MORPH_CLOSE, gap) > 0, np.bool_)
