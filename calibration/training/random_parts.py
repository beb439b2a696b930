"""Random parts for training, as batches of height maps: plates, curved bodies, ridges, pins, slots, teeth, at random.

The evaluated parts are not used: no scene is read, no part of `calibration.simulator.parts` is called, and sizes are
drawn from wide ranges. Heights are in mm, coordinates in mm of the part's own plane, tensors (n, h, w).
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from calibration.training.random_sensors import Draws
from calibration.training.render import Spacing, blur

__all__ = ["FLOOR_MM", "Parts", "add_damage", "draw_parts", "ramp", "turned"]

# The height around a part: far below any press.
FLOOR_MM = -4.0
_SOLIDS = 7
# Field of view at 320x240 in mm; the ranges below are for this size.
_REFERENCE_MM = 14.2


def ramp(t: Tensor) -> Tensor:
    """0 below 0, 1 above 1, smooth between."""
    t = t.clamp(0, 1)
    return t * t * (3 - 2 * t)


def turned(x: Tensor, y: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    """Coordinates in axes turned by an angle per sample, (n,)."""
    c, s = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    return c * x + s * y, c * y - s * x


def _at(values: Tensor) -> Tensor:
    return values[:, None, None]


@dataclass(frozen=True)
class Solid:
    """A rounded box, ring or gear per sample, raised or cut; every field is (n,)."""

    x: Tensor
    y: Tensor
    angle: Tensor
    half_x: Tensor
    half_y: Tensor
    corner: Tensor
    ring: Tensor
    teeth: Tensor
    tooth: Tensor
    level: Tensor
    dome: Tensor
    edge: Tensor
    is_raised: Tensor
    is_cut: Tensor

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Signed distance to the outline, negative inside."""
        u, v = turned(x - _at(self.x), y - _at(self.y), self.angle)
        dx, dy = u.abs() - _at(self.half_x - self.corner), v.abs() - _at(self.half_y - self.corner)
        outside = torch.sqrt(dx.clamp(min=0) ** 2 + dy.clamp(min=0) ** 2)
        distance = outside + torch.maximum(dx, dy).clamp(max=0) - _at(self.corner)
        wave = (2.2 * torch.cos(_at(self.teeth) * torch.atan2(v, u))).clamp(-1, 1)
        distance = distance - _at(self.tooth) * wave
        return torch.where(_at(self.ring) > 0, distance.abs() - _at(self.ring), distance)

    def on(self, height: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """The height with this solid added or taken away."""
        distance = self.distance(x, y)
        edge = ramp(-distance / _at(self.edge))
        r2 = (x - _at(self.x)) ** 2 + (y - _at(self.y)) ** 2
        top = _at(self.level) - _at(self.dome) * r2 - _at(self.edge.clamp(max=0.25)) * (1 - edge)
        raised = torch.where(distance < 0, torch.maximum(height, top), height)
        height = torch.where(_at(self.is_raised) > 0, raised, height)
        return height - _at(self.is_cut * self.level.abs()) * edge


@dataclass(frozen=True)
class Ridges:
    """Parallel ridges with any section from rounded to sharp, over all or a band of the part; fields are (n,)."""

    depth: Tensor
    angle: Tensor
    wave_number: Tensor
    phase: Tensor
    bend: Tensor
    flat: Tensor
    flank: Tensor
    reach: Tensor

    def on(self, height: Tensor, x: Tensor, y: Tensor) -> Tensor:
        u, v = turned(x, y, self.angle)
        turn = u * _at(self.wave_number) + _at(self.bend) * v * v + _at(self.phase)
        from_crest = 2 * (turn - turn.round()).abs()
        cut = ((from_crest - _at(self.flat)) / _at(self.flank)).clamp(0, 1)
        window = ramp((_at(self.reach) - v.abs()) / 0.2 + 1)
        return height - _at(self.depth) * cut * window


@dataclass(frozen=True)
class Parts:
    """n parts. has_plate: an outlined plate, has_body: a curved body; a part with neither has only solids."""

    plate: Solid
    has_body: Tensor
    body_angle: Tensor
    body_bends: tuple[Tensor, Tensor]
    ridges: Ridges
    solids: tuple[Solid, ...]
    waves: Tensor

    def height(self, x: Tensor, y: Tensor) -> Tensor:
        """Heights at points of the part's plane; not yet 0 at the highest."""
        u, v = turned(x, y, self.body_angle)
        body = -_at(self.body_bends[0]) * u * u - _at(self.body_bends[1]) * v * v
        height = torch.where(
            _at(self.has_body) > 0, body.clamp(min=FLOOR_MM), torch.full_like(body, FLOOR_MM)
        )
        height = self.plate.on(height, x, y)
        height = self.ridges.on(height, x, y)
        for solid in self.solids:
            height = solid.on(height, x, y)
        return (height + waves(self.waves, x, y)).clamp(min=FLOOR_MM)


def waves(table: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The sum of plane waves; table: (n, waves, 4) of wave numbers along x and y in rad/mm, phase, amplitude in mm."""
    total = torch.zeros_like(x)
    for k in range(table.shape[1]):
        kx, ky, phase, amplitude = table[:, k].unbind(1)
        total = total + _at(amplitude) * torch.sin(_at(kx) * x + _at(ky) * y + _at(phase))
    return total


def draw_waves(
    draws: Draws, n: int, count: int, length_mm: tuple[float, float], high_mm: tuple[float, float]
) -> Tensor:
    """A table for `waves` with lengths and amplitudes in these ranges."""
    k = 2 * math.pi / draws.log_uniform(*length_mm, n, count)
    angle, phase = draws.uniform(0, math.pi, n, count), draws.uniform(0, 2 * math.pi, n, count)
    return torch.stack(
        [k * torch.cos(angle), k * torch.sin(angle), phase, draws.log_uniform(*high_mm, n, count)], 2
    )


def draw_parts(draws: Draws, n: int, view_mm: float) -> Parts:
    """n random parts for a view this wide. A narrower view has smaller features, by the root of the ratio."""
    scale = math.sqrt(view_mm / _REFERENCE_MM)
    base = draws.kind((0.45, 0.35, 0.2), n)
    main_angle = draws.uniform(0, math.pi, n)
    plate = _draw_solid(draws, n, main_angle, view_mm, scale)
    large = 0.5 * draws.log_uniform(0.35, 2.0, 2, n) * view_mm
    zero, one = torch.zeros_like(main_angle), torch.ones_like(main_angle)
    plate = _replace(
        plate,
        x=draws.normal(0.08 * view_mm, n),
        y=draws.normal(0.08 * view_mm, n),
        half_x=large[0],
        half_y=large[1],
        corner=draws.uniform(0.02, 0.95, n) * large.amin(0),
        ring=zero,
        tooth=zero,
        dome=zero,
        level=-draws.uniform(0, 0.4, n) * draws.chance(0.5, n),
        is_raised=(base == 0).float(),
        is_cut=zero,
    )
    solids = tuple(_draw_solid(draws, n, main_angle, view_mm, scale) for _ in range(_SOLIDS))
    # A part without plate or body is its first solid.
    alone = (base == 2).float()
    first = solids[0]
    solids = (
        _replace(
            first,
            x=first.x * (1 - 0.7 * alone),
            y=first.y * (1 - 0.7 * alone),
            level=first.level * (1 - alone),
            is_raised=torch.maximum(first.is_raised, alone),
            is_cut=first.is_cut * (1 - alone),
        ),
        *solids[1:],
    )
    bends = (0.5 / draws.log_uniform(2, 40, n), 0.5 / draws.log_uniform(4, 400, n))
    return Parts(
        plate=plate,
        has_body=(base == 1).float(),
        body_angle=main_angle,
        body_bends=bends,
        ridges=_draw_ridges(draws, n, main_angle, scale, one),
        solids=solids,
        waves=draw_waves(draws, n, 3, (1.0, 8.0), (0.0005, 0.04)),
    )


def _draw_solid(draws: Draws, n: int, main_angle: Tensor, view_mm: float, scale: float) -> Solid:
    half_x, half_y = draws.log_uniform(0.2, 4.0, 2, n) * scale
    square = draws.chance(0.35, n)
    half_y = square * half_x + (1 - square) * half_y
    aligned = draws.chance(0.7, n)
    quarter = math.pi / 2 * draws.kind((1, 1), n)
    angle = aligned * (main_angle + quarter) + (1 - aligned) * draws.uniform(0, math.pi, n)
    kind = draws.kind((0.48, 0.4, 0.12), n)
    rises = (kind == 0).float()
    level = rises * -draws.uniform(0, 0.5, n) * draws.chance(0.6, n) + (1 - rises) * draws.log_uniform(
        0.08, 1.5, n
    )
    least = torch.minimum(half_x, half_y)
    round_one = draws.chance(0.35, n)
    return Solid(
        x=draws.normal(0.25 * view_mm, n),
        y=draws.normal(0.25 * view_mm, n),
        angle=angle,
        half_x=half_x,
        half_y=half_y,
        corner=least * torch.maximum(round_one, draws.uniform(0.02, 0.8, n)),
        ring=draws.chance(0.2, n) * draws.log_uniform(0.15, 0.7, n) * scale,
        teeth=draws.kind((1.0,) * 20, n) + 5.0,
        tooth=draws.chance(0.12, n) * draws.uniform(0.05, 0.3, n) * least,
        level=level,
        dome=rises * draws.chance(0.25, n) * 0.5 / draws.log_uniform(0.5, 8.0, n),
        edge=draws.log_uniform(0.05, 0.4, n),
        is_raised=rises,
        is_cut=(kind == 1).float(),
    )


def _draw_ridges(draws: Draws, n: int, main_angle: Tensor, scale: float, one: Tensor) -> Ridges:
    across = draws.chance(0.7, n)
    flat = draws.uniform(0.02, 0.6, n)
    return Ridges(
        depth=draws.chance(0.4, n) * draws.log_uniform(0.04, 1.0, n),
        angle=across * (main_angle + math.pi / 2) + (1 - across) * draws.uniform(0, math.pi, n),
        wave_number=1 / (draws.log_uniform(0.3, 3.5, n) * scale),
        phase=draws.uniform(0, 1, n),
        bend=draws.chance(0.4, n) * draws.normal(0.03, n),
        flat=flat,
        flank=draws.uniform(0.2, 1.0, n) * (1 - flat),
        reach=draws.log_uniform(1.5, 40, n) * one,
    )


def _replace(solid: Solid, **fields: Tensor) -> Solid:
    return Solid(**(vars(solid) | fields))


_SLOTS = 3
# Shares of bells, flattened places, filled relief and rough patches.
_KINDS = (0.5, 0.2, 0.15, 0.15)
# A defect starts where the part enters the gel by at least this share of the press.
_TOUCH_SHARE = 0.25


def add_damage(
    draws: Draws, height: Tensor, depth_mm: Tensor, x: Tensor, y: Tensor, spacing: Spacing, scale: float
) -> Tensor:
    """Heights (n, h, w) with up to three defects each; nine of ten samples have at least one.

    depth_mm: (n,) of the press, so that the defects are in the contact. x, y: pixel coordinates in mm, (h, w).
    """
    touched = (height > -(1 - _TOUCH_SHARE) * depth_mm[:, None, None]).flatten(1).float() + 1e-6
    filled = blur(height.clamp(min=-1.2), (0.5 * scale / spacing[0], 0.5 * scale / spacing[1]))
    for slot in range(_SLOTS):
        spot = draws.pick(touched)
        u, v = turned(
            x[None] - x.flatten()[spot][:, None, None],
            y[None] - y.flatten()[spot][:, None, None],
            draws.uniform(0, math.pi, len(height)),
        )
        height = _one(draws, height, filled, u, v, 0.9 if slot == 0 else 0.35, scale)
    return height


def _one(
    draws: Draws, height: Tensor, filled: Tensor, u: Tensor, v: Tensor, share: float, scale: float
) -> Tensor:
    """Make one defect per sample; u, v: coordinates along and across it, (n, h, w)."""
    n = len(height)

    def per(values: Tensor) -> Tensor:
        return values[:, None, None]

    size = draws.log_uniform(0.15, 1.6, n) * scale
    aspect = draws.log_uniform(0.12, 1.0, n)
    v = v - per(draws.chance(0.4, n) * draws.normal(0.15, n) / size) * u * u
    kind = draws.kind(_KINDS, n)
    amount = draws.chance(share, n) * draws.log_uniform(0.025, 0.5, n)

    bell_amount = amount * (kind == 0)
    r = torch.sqrt((u / per(size)) ** 2 + (v / per(size * aspect)) ** 2)
    sign = 1 - 1.5 * draws.chance(0.65, n)  # 1 or -0.5: raised metal shows at a smaller height
    lips = draws.chance(0.5, n) * draws.uniform(0, 0.25, n)
    bell = per(sign) * 2 * ramp(1 - r) + per(lips) * torch.exp(-(((r - 1.15) / 0.25) ** 2))
    height = height + per(bell_amount.clamp(max=0.35)) * bell.clamp(-1, 0.7)

    inside = ramp((1.2 - u.abs() / per(size)) * 3) * ramp(
        (1.2 - v.abs() / per(size * aspect.clamp(min=0.4))) * 3
    )
    local_top = torch.where(inside > 0.3, height, torch.full_like(height, -9.0)).amax(dim=(1, 2))
    plane = per(local_top - amount) + per(draws.chance(0.5, n) * draws.normal(0.2, n)) * u
    flattened = height - inside * (height - plane).clamp(min=0)
    height = torch.where(per((kind == 1) & (amount > 0)), flattened, height)

    is_filled = (kind == 2) & (amount > 0)
    height = height + per(is_filled * draws.uniform(0.3, 1.0, n)) * inside * (filled - height)

    rough = blur(draws.normal(1.0, *height.shape), (1.2, 1.2)) * 3.0
    return height + per(amount.clamp(max=0.2) * (kind == 3)) * 0.3 * inside * rough
