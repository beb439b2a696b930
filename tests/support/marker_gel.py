"""Pictures of a marker gel: regular dark dots over a picture, where they lie, and where shear moves them."""

import numpy as np

from edge.core.arrays import F64, U8

APART_PX, WIDTH_PX, KEEPS = 30.0, 11.0, 0.3
"""As on real gels at 320x240: how far dots lie apart, how wide they are, and what share of the light a dot keeps."""


def light(height: int = 224, width: int = 224) -> U8:
    """A plain gel, whose colours change over it."""
    v, u = np.mgrid[0:height, 0:width] / max(height, width)
    planes = [150 - 60 * v, 90 + 60 * u * v, 70 + 80 * v - 30 * u]
    return np.asarray(np.rint(np.stack(planes, axis=-1)), np.uint8)


def lattice(shape: tuple[int, ...], turn_deg: float = 0.0) -> F64:
    """Centres of dots that cover (h, w) and more, (n, 2), x and y."""
    steps = (np.arange(-12, 13) + 0.37) * APART_PX
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    places = grid @ np.array([[cos, sin], [-sin, cos]]) + np.array([shape[1], shape[0]]) / 2
    near = (places > -APART_PX).all(axis=1) & (places < np.array([shape[1], shape[0]]) + APART_PX).all(axis=1)
    return np.asarray(places[near], np.float64)


def dotted(rgb: U8, places: F64, width_px: float = WIDTH_PX) -> U8:
    """The picture with dots at these places, each with an edge of one pixel."""
    covered = np.zeros(rgb.shape[:2])
    reach = int(width_px / 2 + 2)
    for x, y in places:
        near = tuple(slice(max(int(at) - reach, 0), max(int(at) + reach + 1, 0)) for at in (y, x))
        v, u = np.indices(covered[near].shape)
        away = np.hypot(u + near[1].start - x, v + near[0].start - y)
        dot = np.clip(width_px / 2 - away + 0.5, 0, 1)
        covered[near] = np.maximum(covered[near], dot)
    return np.asarray(np.rint(rgb * (1 - (1 - KEEPS) * covered)[..., None]), np.uint8)


def spread(places: F64, centre: tuple[float, float] = (120.0, 100.0), px: float = 8.0) -> F64:
    """Dots that move away from a bulge, by up to so many pixels."""
    away = places - np.array(centre)
    near = np.exp(-np.square(away).sum(axis=1, keepdims=True) / (2 * 45.0**2))
    return np.asarray(places + px * away / 45.0 * near * np.exp(0.5), np.float64)
