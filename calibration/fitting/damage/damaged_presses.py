"""Nominal presses with small damage rendered into them, by which `fit` chooses a limit and whether it registers."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damage import KINDS, Damage, Spot, surroundings
from calibration.fitting.damage.rendering import EditedPress, edit_touching
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.simulator.field_of_view import grids
from edge.core.arrays import U8, Mask
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["DamagedPresses", "render_damage"]

SIZE_SHARES = (1 / 16, 1 / 8, 1 / 4)
"""Of a kind's largest size: dents of 0.025 to 0.1 mm, about the smallest that the shipped backbone shows."""

SPOTS = 16
"""Damage is rendered at this many places, in every size; fewer where frames are large, for the time that it takes."""

_FEWEST_SPOTS, _SPOTS_PX = 8, 16 * 320 * 240


@dataclass(frozen=True, eq=False)
class DamagedPresses:
    """Presses with damage, each a nominal press but for that."""

    frames: U8
    """uint8 (m, h, w, 3)."""
    press: NDArray[np.int64]
    """Which nominal press each was, (m,)."""
    masks: Mask
    """Where a score map may show the damage, bool (m, h, w)."""
    names: tuple[str, ...] = ()
    """Kind and size of each damage."""

    def __len__(self) -> int:
        return len(self.press)

    def choose(self, rows: Sequence[int]) -> "DamagedPresses":
        """Return these presses alone."""
        kept = list(rows)
        names = tuple(self.names[k] for k in kept) if self.names else ()
        return DamagedPresses(self.frames[kept], self.press[kept], self.masks[kept], names)


def render_damage(
    presses: NominalPresses,
    profile: SensorProfile,
    region: Region,
    rng: np.random.Generator,
    shares: Sequence[float] = SIZE_SHARES,
) -> DamagedPresses | None:
    """Render damage in every size, as shares of the largest, at some spots; the masks hold it and its surroundings.

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
        for share in shares:
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
