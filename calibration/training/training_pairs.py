"""Pairs of simulated presses of one random part: a nominal one, and one whose part may be damaged.

The two differ as two presses on a line do: pose, pressure, tool marks, lamp level, noise. The gel's colours, dust, wear
and grain are the same. `change_mm` is the difference of the imprint by the damage alone.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from calibration.training import render
from calibration.training.random_parts import Parts, add_damage, draw_parts, draw_waves, turned, waves
from calibration.training.random_sensors import Draws, appearance, draws_for, gains, under_dots
from calibration.training.render import BatchAppearance, Spacing
from edge.core.imaging.known_profiles import MINI_LR_MM_PER_PX

__all__ = ["Pairs", "draw_pairs"]

# 1280x720 pictures: 0.0159 and 0.0211 mm per pixel; high-resolution batches draw spacings about these.
_FINE_MM = (0.0145, 0.045)
_MARKER_SHARE = 0.2
# Cameras compress; lossless recordings do not.
_JPEG_SHARE = 0.7
_JPEG_QUALITY = (75.0, 96.0)


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


@dataclass(frozen=True)
class _Views:
    """Poses of 2n presses; x, y: their part coordinates (2n, h, w)"""

    x: Tensor
    y: Tensor
    tilt_mm: Tensor
    """Height added (2n, h, w)."""
    depth_mm: Tensor


@torch.no_grad()  # type: ignore[untyped-decorator]
def draw_pairs(
    seed: int,
    purpose: str,
    step: int,
    *,
    pairs: int,
    side: int,
    device: torch.device,
    high_resolution: float = 0.25,
) -> Pairs:
    """Draw the batch of one step: a function of seed, purpose and step alone."""
    host = draws_for(seed, f"{purpose}/host", step, torch.device("cpu"))
    spacing = _draw_spacing(host, high_resolution)
    centre = _draw_centre(host, side, spacing)
    draws = draws_for(seed, purpose, step, device)
    view_mm = side * max(spacing)
    scale = math.sqrt(view_mm / (side * MINI_LR_MM_PER_PX))
    at_x = (torch.arange(side, device=device) + (0.5 - side / 2)) * spacing[0]
    at_y = (torch.arange(side, device=device) + (0.5 - side / 2)) * spacing[1]
    x, y = at_x[None, :].expand(side, side), at_y[:, None].expand(side, side)

    views = _draw_views(draws, pairs, x, y, scale)
    height = _heights(draws, draw_parts(draws, pairs, view_mm), views)
    broken = add_damage(draws, height[pairs:], views.depth_mm[pairs:], x, y, spacing, scale)
    obstacles = (
        torch.cat([height, broken]) + torch.cat([views.depth_mm, views.depth_mm[pairs:]])[:, None, None]
    )
    surfaces = render.deform(obstacles.clamp(min=0), spacing, float(host.uniform(0.8, 1.25)))
    change = (surfaces[2 * pairs :] - surfaces[pairs : 2 * pairs]).abs()
    surface = torch.cat([surfaces[:pairs], surfaces[2 * pairs :]])
    lens_mm = float(host.uniform(0.02, 0.05))
    u, v = render.unit_grid(side, spacing, centre, device)
    frames = _photograph(draws, surface, appearance(draws, pairs, u, v), x, y, spacing, lens_mm)
    return Pairs(frames, surface, change, spacing)


def _draw_spacing(host: Draws, high_resolution: float) -> Spacing:
    if float(host.uniform(0, 1)) >= high_resolution:
        return (MINI_LR_MM_PER_PX, MINI_LR_MM_PER_PX)
    fine = float(host.log_uniform(*_FINE_MM))
    # Half of the fine batches have the 16:9 squeeze of the published pictures.
    squeeze = 4 / 3 if float(host.uniform(0, 1)) < 0.5 else 1.0
    return (fine, fine * squeeze)


def _draw_centre(host: Draws, side: int, spacing: Spacing) -> tuple[float, float]:
    """The region's place in the crop: at its centre every second time, else anywhere inside."""
    if float(host.uniform(0, 1)) < 0.5:
        return (0.0, 0.0)
    free = [max(0.0, 1 - side * s / extent) for s, extent in zip(spacing, (20.288, 15.216), strict=True)]
    return (float(host.uniform(-1, 1)) * free[0], float(host.uniform(-1, 1)) * free[1])


def _draw_views(draws: Draws, n: int, x: Tensor, y: Tensor, scale: float) -> _Views:
    """A command per part and a jitter per press; the size of the jitter differs from part to part."""
    shift_sd = draws.log_uniform(0.02, 0.2, n) * scale
    turn_sd = draws.log_uniform(0.15, 2.0, n) * (math.pi / 180)
    tilt_sd = draws.log_uniform(0.1, 0.6, n) * (math.pi / 180)
    lean = draws.chance(0.3, n) * draws.uniform(0, 2.0, n) * (math.pi / 180)
    side = draws.uniform(0, 2 * math.pi, n)
    depth = draws.uniform(0.15, 0.7, n)
    depth_sd = draws.log_uniform(0.02, 0.08, n)

    def twice(values: Tensor) -> Tensor:
        return torch.cat([values, values])

    jitter = draws.normal(1.0, 6, 2 * n).clamp(-2.5, 2.5)
    dx, dy = jitter[0] * twice(shift_sd), jitter[1] * twice(shift_sd)
    part_x, part_y = turned(x - dx[:, None, None], y - dy[:, None, None], jitter[2] * twice(turn_sd))
    tilt_x = twice(lean * torch.cos(side)) + jitter[3] * twice(tilt_sd)
    tilt_y = twice(lean * torch.sin(side)) + jitter[4] * twice(tilt_sd)
    tilt = tilt_x[:, None, None] * x + tilt_y[:, None, None] * y
    return _Views(part_x, part_y, tilt, twice(depth) * (1 + jitter[5] * twice(depth_sd)))


def _heights(draws: Draws, parts: Parts, views: _Views) -> Tensor:
    """Heights of the sound parts in all 2n views, 0 at the highest point that the nominal view sees."""
    n = len(views.x) // 2
    marks = draw_waves(draws, 2 * n, 2, (0.25, 0.9), (0.0005, 0.004))
    nominal = parts.height(views.x[:n], views.y[:n])
    partner = parts.height(views.x[n:], views.y[n:])
    top = nominal.amax(dim=(1, 2), keepdim=True)
    sound = torch.cat([nominal - top, partner - top])
    return sound + waves(marks, views.x, views.y) + views.tilt_mm


def _photograph(
    draws: Draws,
    surface: Tensor,
    sensors: BatchAppearance,
    x: Tensor,
    y: Tensor,
    spacing: Spacing,
    lens_mm: float,
) -> Tensor:
    """Frames of 2n imprints through n gels and cameras."""
    n = len(surface) // 2

    def both(values: Tensor) -> Tensor:
        return torch.cat([values, values])

    relief, light = _draw_coat(draws, n, x, y, spacing)
    # One gel in four has the residual imprint of another press.
    left = draws.chance(0.25, 2 * n) * draws.uniform(0, 0.1, 2 * n)
    seen = torch.maximum(surface, left[:, None, None] * surface.roll(1, 0)) + relief
    nx, ny = render.normals(*render.slopes(seen, spacing))
    planes = render.shade(
        nx, ny, BatchAppearance(both(sensors.free), both(sensors.per_normal), both(sensors.curvature))
    )
    keeps, level = 1 - 0.4 * both(draws.uniform(0, 1, n)), both(draws.uniform(0, 26, n))
    planes = render.gloss(render.shadows(planes, seen, keeps, spacing), nx, ny, level) * light[:, None]
    count = round(_MARKER_SHARE * n)
    dotted = torch.cat([torch.arange(count), torch.arange(n, n + count)]).to(planes.device)
    if count:
        planes[dotted] = under_dots(planes[dotted], surface[dotted], x, y, spacing)
    white = both(draws.normal(1.0, n, *surface.shape[1:]))
    planes = render.grain(planes, surface, white, both(draws.uniform(0, 3, n)), spacing)
    planes = render.lens(planes, lens_mm, spacing).clamp(min=0) * gains(draws, 2 * n)[:, :, None, None]
    noise, strength = draws.normal(1.0, *planes.shape), both(draws.log_uniform(0.5, 1.6, n))
    frames = render.quantise(render.sensor_noise(planes, noise, strength))
    sent, quality = both(draws.chance(_JPEG_SHARE, n)), both(draws.uniform(*_JPEG_QUALITY, n))
    for k in sent.nonzero()[:, 0].tolist():
        frames[k] = compress(frames[k], round(float(quality[k])))
    return frames


def compress(frame: Tensor, quality: int) -> Tensor:
    """Give a frame (3, h, w) of whole grey levels as the camera's JPEG shows it. quality: 0 to 100."""
    bgr = np.ascontiguousarray(frame.byte().cpu().numpy()[::-1].transpose(1, 2, 0))
    sent = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    seen = np.asarray(cv2.imdecode(sent, cv2.IMREAD_COLOR))
    return torch.from_numpy(seen[..., ::-1].transpose(2, 0, 1).copy()).to(frame)


# Per region: grains of both presses, grains of the partner only, scratches and stains.
_GRAINS, _NEW_GRAINS, _SCRATCHES, _STAINS = 8, 2, 2, 2


def _draw_coat(draws: Draws, n: int, x: Tensor, y: Tensor, spacing: Spacing) -> tuple[Tensor, Tensor]:
    """Relief in mm and share of light, both (2n, h, w), of dust and wear; the same in both presses except for new
    grains."""
    half_x, half_y = spacing[0] * x.shape[1] / 2, spacing[1] * x.shape[0] / 2

    def place(count: int) -> tuple[Tensor, Tensor]:
        return draws.uniform(-half_x, half_x, n, count), draws.uniform(-half_y, half_y, n, count)

    def bumps(count: int, share: float) -> Tensor:
        px, py = place(count)
        radius, high = draws.log_uniform(0.025, 0.11, n, count), draws.uniform(0.005, 0.05, n, count)
        high = high * draws.chance(share, n, count)
        return _bells(px, py, radius, high, x, y)

    dust = bumps(_GRAINS, 0.5)
    relief = torch.cat([dust, dust + bumps(_NEW_GRAINS, 0.15)])
    px, py = place(_SCRATCHES)
    deep = draws.chance(0.35, n, _SCRATCHES) * draws.uniform(0.002, 0.009, n, _SCRATCHES)
    length, turn = draws.log_uniform(1.0, 5.0, n, _SCRATCHES), draws.uniform(0, math.pi, n, _SCRATCHES)
    furrows = torch.zeros_like(dust)
    for k in range(_SCRATCHES):
        u, v = turned(x - px[:, k, None, None], y - py[:, k, None, None], turn[:, k])
        ends = ((length[:, k, None, None] / 2 - u.abs()) / 0.3).clamp(0, 1)
        furrows = furrows + deep[:, k, None, None] * ends * torch.exp(-(((v + 0.03 * u * u) / 0.05) ** 2))
    sx, sy = place(_STAINS)
    lost = draws.chance(0.3, n, _STAINS) * draws.uniform(0.01, 0.12, n, _STAINS)
    stains = _bells(sx, sy, draws.uniform(0.4, 1.8, n, _STAINS), lost, x, y)
    return relief - torch.cat([furrows, furrows]), 1 - torch.cat([stains, stains])


def _bells(px: Tensor, py: Tensor, radius: Tensor, high: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Sums of Gaussian bells, separable: (n, h, w) from (n, count) centres, radii and heights."""
    along_x = torch.exp(-0.5 * ((x[0] - px[:, :, None]) / radius[:, :, None]) ** 2)
    along_y = torch.exp(-0.5 * ((y[:, 0] - py[:, :, None]) / radius[:, :, None]) ** 2)
    return torch.einsum("nky,nkx->nyx", along_y * high[:, :, None], along_x)
