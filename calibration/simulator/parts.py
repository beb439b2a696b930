"""Analogues of the five inspected parts, as height maps for any resolution.

Each is a pure function of x and y in mm, 0 at its highest nominal point. They represent kinds of parts: a thread, a
fitting, grooves with a tooth, two small hand-placed pieces. Their sizes fit the sensor's view and are not those of a
real component.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.pose import FIXTURE, HeightField, Jitter
from calibration.simulator.shapes import FLOOR_MM, box, disc, f32, plateau, ramp, rotate
from edge.core.arrays import F32

__all__ = ["PARTS", "Part", "Specimen", "specimen"]


@dataclass(frozen=True)
class Part:
    """A part: what it is, its positions (name to geometry), how deep it is pressed and how well it is held."""

    name: str
    summary: str
    positions: Mapping[str, HeightField]
    depth_mm: float
    jitter: Jitter


# ISO metric thread M10x1.5: 60 degree flanks, crest an eighth and root a quarter of the pitch wide (ISO 68-1).
_THREAD_RADIUS_MM = 5.0
_THREAD_PITCH_MM = 1.5
_FLANK = math.tan(math.radians(60))
_THREAD_START_MM = -5.6


def _thread(turn: float) -> HeightField:
    """An external thread with its axis vertical in the picture, after a turn (in revolutions) about that axis."""

    def height(x_mm: F32, y_mm: F32) -> F32:
        side = np.clip(x_mm / _THREAD_RADIUS_MM, -1, 1)
        angle = reproducible_math.arcsin(side) / (2 * math.pi)
        phase = y_mm / _THREAD_PITCH_MM - angle + turn
        from_crest = np.abs(phase - np.round(phase)) * _THREAD_PITCH_MM
        flat = _THREAD_PITCH_MM / 16
        cut = np.clip((from_crest - flat) * _FLANK, 0, 0.6134 * _THREAD_PITCH_MM)
        radius = _THREAD_RADIUS_MM - cut
        # The point of the bolt is chamfered at 45 degrees, so the first crest is cut short.
        radius = np.minimum(radius, (_THREAD_RADIUS_MM - _THREAD_START_MM) + y_mm)
        top = radius * np.sqrt(1 - side * side) - _THREAD_RADIUS_MM
        return f32(np.maximum(np.where(np.abs(side) < 1, top, FLOOR_MM), FLOOR_MM))

    return height


def _connector(x_mm: F32, y_mm: F32) -> F32:
    """A round fitting: a flat sealing face with an O-ring groove, two bayonet slots and three contact pins."""
    height = plateau(disc(x_mm, y_mm, 6.2), 0.0, FLOOR_MM, 0.25)
    groove = np.abs(disc(x_mm, y_mm, 4.9)) - 0.45
    height = np.minimum(height, -0.7 * ramp(-groove / 0.2))
    bore = plateau(disc(x_mm, y_mm, 3.3), 1.0, 0.0, 0.2)
    height = np.where(bore > 0, np.minimum(height, -1.6 * ramp(bore)), height)
    for angle in (0.6, 0.6 + math.pi):
        along, across = rotate(x_mm, y_mm, angle)
        slot = box(along - 5.9, across, 0.9, 0.55, 0.3)
        height = np.minimum(height, -1.2 * ramp(-slot / 0.15))
    for angle in (math.pi / 2, math.pi / 2 + 2.1, math.pi / 2 - 2.1):
        px, py = x_mm - 1.75 * math.cos(angle), y_mm - 1.75 * math.sin(angle)
        dome = np.sqrt(np.maximum(0.55**2 - px * px - py * py, 0)) - 0.62
        height = np.maximum(height, np.where(disc(px, py, 0.54) < 0, dome, FLOOR_MM))
    return f32(height)


def _grooves(offset: tuple[float, float], half_turn: bool) -> HeightField:
    """A block with five grooves, a cross slot and one tooth, seen from one of two places."""

    def height(x_mm: F32, y_mm: F32) -> F32:
        x, y = (-x_mm, -y_mm) if half_turn else (x_mm, y_mm)
        x, y = x + offset[0], y + offset[1]
        solid = plateau(box(x, y, 8.0, 5.6, 0.4), 0.0, FLOOR_MM, 0.15)
        for k in range(-2, 3):
            groove = box(x + 1.6, y - 1.9 * k, 4.6, 0.42, 0.1)
            solid = np.minimum(solid, -0.8 * ramp(-groove / 0.16))
        slot = box(x - 4.4, y, 0.45, 4.4, 0.2)
        solid = np.minimum(solid, -1.0 * ramp(-slot / 0.14))
        tooth = box(x - 6.3, y, 0.9, 1.1, 0.1)
        pocket = box(x - 6.6, y, 1.5, 2.4, 0.3)
        solid = np.minimum(solid, -0.9 * ramp(-pocket / 0.15))
        return f32(np.maximum(solid, plateau(tooth, -0.02, FLOOR_MM, 0.3)))

    return height


def _bracket(x_mm: F32, y_mm: F32) -> F32:
    """A stepped plate 7 mm long with an eye, two notches and a raised rib."""
    plate = np.minimum(box(x_mm, y_mm, 3.4, 2.1, 0.5), box(x_mm + 2.4, y_mm, 1.4, 2.8, 0.6))
    height = plateau(plate, -0.15, FLOOR_MM, 0.15)
    eye = disc(x_mm + 2.3, y_mm, 0.95)
    height = np.maximum(height, plateau(np.abs(eye - 0.3) - 0.35, 0.0, FLOOR_MM, 0.12))
    height = np.where(eye < 0, np.minimum(height, -1.2), height)
    rib = box(x_mm - 1.2, y_mm, 1.7, 0.3, 0.1)
    height = np.maximum(height, plateau(rib, 0.0, FLOOR_MM, 0.12))
    for side in (-1.0, 1.0):
        notch = box(x_mm - 1.3, y_mm - side * 2.1, 0.4, 0.5, 0.15)
        height = np.minimum(height, np.where(notch < 0, np.float32(-1.2), np.float32(0)))
    return f32(height)


def _pinion(x_mm: F32, y_mm: F32) -> F32:
    """A pinion 7 mm across, face on: twelve teeth, a recessed web and a hub with a bore and a flat."""
    radius = np.sqrt(x_mm * x_mm + y_mm * y_mm)
    angle = reproducible_math.arctan2(y_mm, x_mm)
    wave = np.clip(reproducible_math.cos(12 * angle) * 2.2, -1, 1)
    outline = radius - 3.1 - 0.42 * wave
    height = plateau(f32(outline), 0.0, FLOOR_MM, 0.12)
    web = np.abs(radius - 1.95) - 0.45
    height = np.minimum(height, -0.35 * ramp(-web / 0.12))
    bore = np.maximum(disc(x_mm, y_mm, 0.75), x_mm - 0.5)
    return f32(np.where(bore < 0, np.minimum(height, -1.5), height))


# A hand repeats a part's place within a few tenths of a millimetre.
_BY_HAND = Jitter(0.35, 3.0, 0.6, 0.08)

PARTS: Mapping[str, Part] = {
    part.name: part
    for part in (
        Part(
            "PZ1",
            "external thread, four positions around it",
            {f"pos{k + 1}": _thread(0.25 * k) for k in range(4)},
            0.55,
            FIXTURE,
        ),
        Part("PZ2", "connector with a fitting interface", {"pos1": _connector}, 0.4, FIXTURE),
        Part(
            "PZ3",
            "grooves, slots and a tooth, two positions",
            {"pos1": _grooves((-1.8, 0.0), False), "pos2": _grooves((2.9, 0.6), True)},
            0.4,
            FIXTURE,
        ),
        Part("PZ4", "stepped bracket under a centimetre, placed by hand", {"pos1": _bracket}, 0.4, _BY_HAND),
        Part("PZ5", "pinion under a centimetre, placed by hand", {"pos1": _pinion}, 0.4, _BY_HAND),
    )
}


@dataclass(frozen=True)
class Specimen:
    """One piece of a part: the nominal geometry within its tolerance, with its own tool marks."""

    nominal: HeightField
    scale: float
    """About 1."""
    marks: tuple[tuple[float, float, float, float], ...]
    """(x, y wave number in rad/mm, phase in rad, amplitude in mm) of shallow waves."""

    def __call__(self, x_mm: F32, y_mm: F32) -> F32:
        height = self.nominal(x_mm * self.scale, y_mm * self.scale)
        for kx, ky, phase, amplitude in self.marks:
            wave = reproducible_math.sin(kx * x_mm + ky * y_mm + phase)
            height = f32(height + amplitude * wave)
        return height


def specimen(nominal: HeightField, rng: np.random.Generator) -> Specimen:
    """A piece within tolerance: scale within 0.1 %, tool marks up to a micrometre high (assumed, turned metal)."""
    angle, phase = rng.uniform(0, math.pi, 2), rng.uniform(0, 2 * math.pi, 2)
    wavelength, amplitude = rng.uniform(0.25, 0.9, 2), rng.uniform(0.0002, 0.001, 2)
    number = 2 * math.pi / wavelength
    marks = tuple(
        (float(n * math.cos(a)), float(n * math.sin(a)), float(p), float(h))
        for n, a, p, h in zip(number, angle, phase, amplitude, strict=True)
    )
    return Specimen(nominal, 1 + float(np.clip(rng.normal(0, 0.0005), -0.001, 0.001)), marks)
