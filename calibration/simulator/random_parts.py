"""Random parts, for training and for tests that must not be tuned to five shapes.

None of them is, or contains, one of the analogues in `parts`. There is no helical thread, slotted ring with a bore, row
of grooves with a tooth, pinion, or plate with an eye and a rib. Ridges are straight, wavy or crossed with rounded
crests, never a 60 degree profile round a cylinder.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.pose import HeightField, Pose
from calibration.simulator.shapes import FLOOR_MM, box, f32, plateau, ramp, rotate
from edge.core.arrays import F32

__all__ = ["RandomPart", "Relief", "random_part"]

Relief = Callable[[F32, F32], F32]


@dataclass(frozen=True)
class RandomPart:
    """One random part."""

    body: HeightField
    """An outline with a flat, domed or slanted top."""
    features: tuple[Relief, ...]
    """Relief that is added or cut in."""
    place: Pose

    def __call__(self, x_mm: F32, y_mm: F32) -> F32:
        x = x_mm - self.place.shift_mm[0]
        y = y_mm - self.place.shift_mm[1]
        x, y = rotate(x, y, self.place.turn_rad)
        height = self.body(x, y)
        for feature in self.features:
            height = height + feature(x, y)
        # The highest possible point is 0, as for every part.
        return f32(np.clip(height, FLOOR_MM, 0))


def random_part(
    rng: np.random.Generator, largest_mm: tuple[float, float] = (10.0, 8.0), most: int = 4
) -> RandomPart:
    """A part with one to `most` features, somewhere under the gel. largest_mm: half of its largest size, (x, y).

    The features' heights are between 0.05 and 0.6 mm: a press of about 0.4 mm shows them.
    """
    half = (float(rng.uniform(2.0, largest_mm[0])), float(rng.uniform(2.0, largest_mm[1])))
    body = _BODIES[rng.integers(len(_BODIES))](half, rng)
    count = int(rng.integers(1, most + 1))
    features = tuple(_FEATURES[rng.integers(len(_FEATURES))](half, rng) for _ in range(count))
    reach = (max(0.5, 8.0 - half[0]), max(0.5, 6.0 - half[1]))
    shift = (float(rng.uniform(-reach[0], reach[0])), float(rng.uniform(-reach[1], reach[1])))
    return RandomPart(body, features, Pose(shift, float(rng.uniform(0, 2 * math.pi))))


Half = tuple[float, float]


def _slab(half: Half, rng: np.random.Generator) -> HeightField:
    """A flat top with rounded corners and a broken edge, often cut off at a slant."""
    corner, edge = float(rng.uniform(0.05, 0.9)) * min(half) / 2, float(rng.uniform(0.05, 0.5))
    slant = rng.normal(0, 0.02, 2)
    top = -float(rng.uniform(0.0, 0.1))

    def height(x: F32, y: F32) -> F32:
        flat = plateau(box(x, y, half[0], half[1], corner), top, float(FLOOR_MM), edge)
        return f32(flat - np.abs(np.float32(slant[0]) * x + np.float32(slant[1]) * y))

    return height


def _barrel(half: Half, rng: np.random.Generator) -> HeightField:
    """A cylinder on its side or a flat ellipsoid, smooth."""
    radius, length, bow = float(rng.uniform(2, 15)), half[1], float(rng.choice([0.0, 0.0, 0.02, 0.05]))

    def height(x: F32, y: F32) -> F32:
        inside = np.maximum(radius * radius - x * x, 0)
        round_top = np.sqrt(inside) - radius - bow * y * y
        ends = ramp((length - np.abs(y)) / 0.3)
        return f32(np.where(ends > 0, round_top - 0.3 * (1 - ends), FLOOR_MM))

    return height


def _polygon(half: Half, rng: np.random.Generator) -> HeightField:
    """A convex polygon of three to seven sides with a flat top."""
    sides = int(rng.integers(3, 8))
    angles = np.sort(rng.uniform(0, 2 * math.pi, sides)) + np.linspace(0, 1.5, sides)
    distances = rng.uniform(0.6, 1.0, sides) * min(half)
    edge = float(rng.uniform(0.05, 0.5))

    def height(x: F32, y: F32) -> F32:
        planes = [
            math.cos(a) * x + math.sin(a) * y - d
            for a, d in zip(angles.tolist(), distances.tolist(), strict=True)
        ]
        outline = np.maximum.reduce([*planes, box(x, y, half[0], half[1])])
        return plateau(f32(outline), 0.0, float(FLOOR_MM), edge)

    return height


def _boss(half: Half, rng: np.random.Generator) -> Relief:
    """Make a raised or sunken shape: round, square or oblong, with soft or sharp flanks."""
    at = rng.uniform(-0.7, 0.7, 2) * half
    size, turn = rng.uniform(0.3, 1.8, 2), float(rng.uniform(0, math.pi))
    rise = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.5))
    flank, corner = float(rng.uniform(0.05, 0.5)), float(rng.uniform(0, 1)) * float(size.min())

    def relief(x: F32, y: F32) -> F32:
        u, v = rotate(x - np.float32(at[0]), y - np.float32(at[1]), turn)
        return f32(rise * ramp(-box(u, v, float(size[0]), float(size[1]), corner) / flank))

    return relief


def _bumps(half: Half, rng: np.random.Generator) -> Relief:
    """A lattice of round dimples or bumps, straight or skewed."""
    pitch, skew = rng.uniform(0.8, 2.5, 2), float(rng.uniform(-0.5, 0.5))
    radius = float(rng.uniform(0.2, 0.45)) * float(pitch.min())
    rise = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.3))
    reach = rng.uniform(0.3, 0.9, 2) * half

    def relief(x: F32, y: F32) -> F32:
        v = y - np.float32(pitch[1]) * np.round(y / np.float32(pitch[1]))
        u = x + skew * (y - v)
        u = u - np.float32(pitch[0]) * np.round(u / np.float32(pitch[0]))
        dome = np.maximum(1 - (u * u + v * v) / (radius * radius), 0)
        within = (np.abs(x) < np.float32(reach[0])) & (np.abs(y) < np.float32(reach[1]))
        return f32(rise * dome * within)

    return relief


def _ridges(half: Half, rng: np.random.Generator) -> Relief:
    """Parallel rounded ridges: straight or wavy, over a patch of the part."""
    wavelength, depth = float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.05, 0.3))
    turn, wave = float(rng.uniform(0, math.pi)), float(rng.choice([0.0, rng.uniform(0.1, 0.6)]))
    bend, reach = float(rng.uniform(0.5, 2.0)), rng.uniform(0.3, 1.0, 2) * half
    power = float(rng.uniform(0.5, 3.0))

    def relief(x: F32, y: F32) -> F32:
        u, v = rotate(x, y, turn)
        phase = (u + wave * reproducible_math.sin(v * bend)) * (2 * math.pi / wavelength)
        crest = reproducible_math.power(0.5 + 0.5 * reproducible_math.cos(phase), power)
        patch = ramp(-box(x, y, float(reach[0]), float(reach[1])) / 0.3)
        return f32(depth * (crest - 1) * patch)

    return relief


def _knurl(half: Half, rng: np.random.Generator) -> Relief:
    """Two crossing sets of rounded grooves: pyramids or diamonds."""
    first, second = _ridges(half, rng), _ridges(half, rng)
    return lambda x, y: f32(np.minimum(first(x, y), second(x, y)))


def _strokes(half: Half, rng: np.random.Generator) -> Relief:
    """A few raised or engraved strokes, as letters or weld beads have them."""
    rise = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.25))
    width = float(rng.uniform(0.12, 0.4))
    ends = rng.uniform(-0.7, 0.7, (int(rng.integers(2, 7)), 4)) * [half[0], half[1], half[0], half[1]]

    def relief(x: F32, y: F32) -> F32:
        nearest = np.full_like(x, np.float32(99))
        for x0, y0, x1, y1 in ends.tolist():
            dx, dy = x1 - x0, y1 - y0
            square = max(dx * dx + dy * dy, 1e-6)
            t = np.clip(((x - x0) * dx + (y - y0) * dy) / square, 0, 1)
            away = (x - x0 - t * dx) ** 2 + (y - y0 - t * dy) ** 2
            nearest = np.minimum(nearest, f32(away))
        return f32(rise * ramp(f32(1.5 - np.sqrt(nearest) / width)))

    return relief


def _step(half: Half, rng: np.random.Generator) -> Relief:
    """Make one side lower than the other along a straight or bent line."""
    turn, at = float(rng.uniform(0, 2 * math.pi)), float(rng.uniform(-0.5, 0.5)) * min(half)
    drop, run = float(rng.uniform(0.05, 0.5)), float(rng.uniform(0.05, 1.0))
    bend = float(rng.uniform(-0.1, 0.1))

    def relief(x: F32, y: F32) -> F32:
        u, v = rotate(x, y, turn)
        return f32(-drop * ramp((u - at + bend * v * v) / run))

    return relief


def _ripple(half: Half, rng: np.random.Generator) -> Relief:
    """Smooth uneven ground, as a casting or a moulding has it."""
    waves = [
        (rng.normal(0, 1.6, 2).tolist(), float(rng.uniform(0, 6.28)), float(rng.uniform(0.01, 0.06)))
        for _ in range(5)
    ]

    def relief(x: F32, y: F32) -> F32:
        total = np.zeros_like(x)
        for (kx, ky), phase, rise in waves:
            total += rise * (reproducible_math.sin(kx * x + ky * y + phase) - 1)
        return total

    return relief


_BODIES: tuple[Callable[[Half, np.random.Generator], HeightField], ...] = (_slab, _slab, _barrel, _polygon)
_FEATURES: tuple[Callable[[Half, np.random.Generator], Relief], ...] = (
    _boss,
    _boss,
    _bumps,
    _ridges,
    _knurl,
    _strokes,
    _step,
    _ripple,
)
