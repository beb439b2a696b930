"""Pairs of simulated presses of one random part: a nominal one, and one whose part may be damaged.

The two differ as two presses on a line do: pose, pressure, tool marks, lamp level, noise. The gel's colours, dust, wear
and grain are the same. `change_mm` is the difference of the imprint by the damage alone. The simulator draws them, with
sensors about two measured ones and some of its effects; the damage is none of its defects, which evaluation uses.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from calibration.simulator.field_of_view import CROP_MM, LR, Field, grids
from calibration.simulator.gel import GEL, Gel
from calibration.simulator.parts import specimen
from calibration.simulator.pose import HeightField, Jitter, Pose, partial_contact, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from calibration.simulator.shapes import f32, ramp, rotate
from calibration.simulator.streams import Streams
from edge.core.arrays import F32, U8

__all__ = ["TRAINING_UNITS", "Pairs", "draw_pairs"]

Spacing = tuple[float, float]

# Training mixes and varies these two measured sensors; `unit_c` is reserved for evaluation.
TRAINING_UNITS = ("unit_a", "unit_b")
# 1280x720 pictures: 0.0159 and 0.0211 mm per pixel; high-resolution batches draw spacings about these.
_FINE_MM = (0.0145, 0.045)
_ALWAYS = ("pose_jitter", "deformation", "illumination", "vignette", "noise")
# How many of the pairs have each of the other effects.
_SOMETIMES = {
    **dict.fromkeys(("dust", "wear", "shadows", "specular", "grain", "lens_blur", "led_drift"), 0.8),
    "residual_imprint": 0.25,
    "markers": 0.2,
    "jpeg": 0.7,
}


@dataclass(frozen=True)
class Pairs:
    """n pairs. The first n samples are nominal, the last n their partners."""

    frames: Tensor
    """(2n, 3, h, w), whole grey levels 0 to 255, RGB."""
    surface_mm: Tensor
    """(2n, h, w), the imprint without dust."""
    change_mm: Tensor
    """(n, h, w), how much the damage alone moves the partner's imprint."""
    spacing: Spacing
    """Mm per pixel (x, y)."""

    def to(self, device: torch.device) -> "Pairs":
        """Copy the pairs to a device."""
        frames, surface_mm, change_mm = self.frames, self.surface_mm, self.change_mm
        return Pairs(frames.to(device), surface_mm.to(device), change_mm.to(device), self.spacing)


def draw_pairs(
    seed: int, purpose: str, step: int, *, pairs: int, side: int, high_resolution: float = 0.25
) -> Pairs:
    """Draw the batch of one step: a function of seed, purpose and step alone."""
    streams = Streams(seed)
    field = _draw_field(streams(purpose, step), side, high_resolution)
    with reproducible_opencv():
        drawn = [_draw_pair(streams, (purpose, step, k), field) for k in range(pairs)]
    frames = np.stack([pair.transpose(2, 0, 1) for press in (0, 1) for pair in (d[0][press] for d in drawn)])
    surfaces = np.stack([d[1][press] for press in (0, 1) for d in drawn])
    changes = np.stack([d[2] for d in drawn])
    return Pairs(
        torch.from_numpy(frames).float(),
        torch.from_numpy(surfaces),
        torch.from_numpy(changes),
        field.mm_per_px,
    )


def _draw_field(rng: np.random.Generator, side: int, high_resolution: float) -> Field:
    """A square region: at the centre of the crop every second time, else anywhere inside."""
    spacing = LR.mm_per_px
    if rng.random() < high_resolution:
        fine = _log_uniform(rng, *_FINE_MM)
        # Half of the fine batches have the 16:9 squeeze of the published pictures.
        spacing = (fine, fine * (4 / 3 if rng.random() < 0.5 else 1.0))
    free = [max(0.0, (mm - side * px) / 2) for mm, px in zip(CROP_MM, spacing, strict=True)]
    place = rng.uniform(-1, 1, 2) * (rng.random() < 0.5) * free
    return Field((side, side), spacing, (float(place[0]), float(place[1])))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


Drawn = tuple[tuple[U8, U8], tuple[F32, F32], F32]
"""The two pictures, the two imprints, and the change by the damage."""


def _draw_pair(streams: Streams, key: tuple[str | int, ...], field: Field) -> Drawn:
    rng = streams("pair", *key)
    # Fine pictures show smaller parts and damage, by the root of the ratio.
    scale = math.sqrt(max(field.mm_per_px) / LR.mm_per_px[0])
    effects = [*_ALWAYS, *(name for name, share in _SOMETIMES.items() if rng.random() < share)]
    words = "/".join(map(str, key))
    renderer = Renderer(field, effects, _draw_sensor(rng), _draw_jitter(rng, scale), streams, words, words)
    part, depth = _draw_part(rng, scale), rng.uniform(0.15, 0.7)
    commanded = partial_contact(Pose(), rng) if rng.random() < 0.3 else Pose()
    commanded = replace(commanded, shift_mm=field.centre_mm)
    places = [renderer.place(commanded, (*key, press)) for press in (0, 1)]
    nominal, partner = (sample(specimen(part, rng), place, field) for place in places)
    top = nominal.max()
    nominal, partner = nominal - top, partner - top
    depths = [depth * place.depth_factor for place in places]
    damaged = _add_damage(rng, partner, depths[1], field, scale)
    first = renderer.imprint(nominal, depths[0])
    sound, second = (renderer.imprint(height, depths[1]) for height in (partner, damaged))
    leak = _draw_leak(rng)
    worn = int(rng.integers(1500))
    frames = []
    for press, imprint in enumerate((first, second)):
        surface = renderer.surface(imprint, worn + press, (imprint[::-1, ::-1], rng.uniform(0.2, 3.0)))
        light = np.tensordot(leak, renderer.light(surface, worn + press), 1)
        frames.append(renderer.expose(light, (*key, press), Exposure(0, rng.uniform(0, 100))))
    return (frames[0], frames[1]), (first, second), np.abs(second - sound)


def _draw_part(rng: np.random.Generator, scale: float) -> HeightField:
    """A part with much relief about the middle of the view."""
    part = random_part(rng, largest_mm=(9.0, 9.0), most=8)
    at = rng.normal(0, 2.0, 2)
    part = replace(part, place=Pose((float(at[0]), float(at[1])), part.place.turn_rad))
    return lambda x, y: part(x / np.float32(scale), y / np.float32(scale))


def _draw_jitter(rng: np.random.Generator, scale: float) -> Jitter:
    """Draw how much the presses of one part differ: some are held well, some badly."""
    shift = _log_uniform(rng, 0.02, 0.2) * scale
    turn, tilt, depth = (_log_uniform(rng, *ends) for ends in ((0.15, 2.0), (0.1, 0.6), (0.02, 0.08)))
    return Jitter(shift, turn, tilt, depth)


def _draw_sensor(rng: np.random.Generator) -> SensorAppearance:
    """A sensor about the two training units: exposure, white balance, falloff, response, gel and noise all vary."""
    first, second = (SENSORS[name] for name in TRAINING_UNITS)
    share, level = rng.random(), rng.normal(0, 0.15) + rng.normal(0, 0.07, 3)
    free = share * first.free_gel + (1 - share) * second.free_gel + rng.normal(0, 0.05, (3, 15))
    free[:, 0] += level
    gain = np.exp(level + rng.normal(0, 0.12) + rng.normal(0, 0.08, 3))[:, None]
    answer = share * first.slope_response + (1 - share) * second.slope_response
    answer = answer * rng.normal(1, 0.1, (3, 15)) + rng.normal(0, 4.0, (3, 15))
    stiffness, noise = rng.uniform(0.8, 1.25), _log_uniform(rng, 0.5, 1.6)
    gel = Gel(GEL.short_mm * stiffness, GEL.long_mm * stiffness, GEL.long_share)
    red, green, blue = (noise * sd for sd in first.noise_sd)
    return SensorAppearance("drawn", free, answer * gain, gel=gel, noise_sd=(red, green, blue))


def _draw_leak(rng: np.random.Generator) -> F32:
    """A matrix that mixes the colours: filters leak up to a quarter of each channel from the others."""
    leak = rng.uniform(0, 0.25)
    return f32((1 - leak) * np.eye(3) + leak * rng.uniform(0, 0.6, (3, 3)))


# How many presses have no defect, one, two and three.
_COUNTS = (0.1, 0.3, 0.3, 0.3)
# A defect starts where the part enters the gel by at least this share of the press.
_TOUCH_SHARE = 0.25


def _add_damage(rng: np.random.Generator, height: F32, depth_mm: float, field: Field, scale: float) -> F32:
    """The height with up to three defects in the contact: bells, flattened places, filled relief, rough patches."""
    x, y = grids(field)
    # A partner that jitter lifted may touch nowhere deep: then its highest point is damaged.
    touched = np.flatnonzero(height >= min(height.max(), -(1 - _TOUCH_SHARE) * depth_mm))
    for _ in range(rng.choice(4, p=_COUNTS)):
        spot = rng.choice(touched)
        u, v = rotate(x - x.flat[spot], y - y.flat[spot], rng.uniform(0, math.pi))
        height = _add_defect(rng, height, u, v, field, scale)
    return height


def _add_defect(rng: np.random.Generator, height: F32, u: F32, v: F32, field: Field, scale: float) -> F32:
    """The height with one defect; u, v: coordinates along and across it, float32 (h, w)."""
    size, aspect = _log_uniform(rng, 0.15, 1.6) * scale, _log_uniform(rng, 0.12, 1.0)
    amount, bend = _log_uniform(rng, 0.04, 0.6), rng.normal(0, 0.15) * (rng.random() < 0.4)
    v = v - np.float32(bend / size) * u * u
    kind = rng.choice(4, p=(0.5, 0.2, 0.15, 0.15))
    across = size * max(aspect, 0.4)
    inside = ramp((1.2 - np.abs(u) / size) * 3) * ramp((1.2 - np.abs(v) / across) * 3)
    if kind == 0:  # a bell: raised metal shows at a smaller height than a hollow of the same depth
        r = np.hypot(u / size, v / (size * aspect))
        sign, lips = rng.choice((-0.5, 1.0), p=(0.65, 0.35)), rng.uniform(0, 0.25) * (rng.random() < 0.5)
        bell = 2 * sign * ramp(1 - r) + lips * np.exp(-(((r - 1.15) / 0.25) ** 2))
        change = min(amount, 0.35) * bell.clip(-1, 0.7)
    elif kind == 1:  # a flattened place
        top = height[inside > 0.3].max(initial=-9.0)
        plane = top - amount + rng.normal(0, 0.2) * (rng.random() < 0.5) * u
        change = -inside * np.maximum(height - plane, 0)
    elif kind == 2:  # filled relief
        sx, sy = (0.5 * scale / mm for mm in field.mm_per_px)
        filled = cv2.GaussianBlur(height.clip(-1.2), (0, 0), sx, sigmaY=sy)
        change = rng.uniform(0.3, 1.0) * inside * (filled - height)
    else:  # a rough patch
        rough = cv2.GaussianBlur(rng.standard_normal(height.shape, np.float32), (0, 0), 1.2)
        change = 0.9 * min(amount, 0.2) * inside * rough
    return f32(height + change)
