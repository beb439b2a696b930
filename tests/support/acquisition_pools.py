"""Presses of random simulated parts from which acquisitions are drawn, with features extracted once."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from random_part_presses import RandomPartPresses

from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.trunks import open_trunk
from edge.core.detector import Features, Grid, Nominal
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.session import open_session

PROFILE = profile("cropped_lr")
SIDE = 80
TAPS = ("layer1", "layer2")


@dataclass(frozen=True)
class Sizes:
    """nominal: presses that an acquisition may take. each: presses of each piece. fresh: sound presses of other pieces
    for the true rate of false alarms. damaged: presses with a mask."""

    nominal: int = 40
    each: int = 1
    fresh: int = 100
    damaged: int = 16
    free: int = 4


SIZES = {"presses": Sizes(), "pieces": Sizes(each=4)}


@dataclass(frozen=True)
class Pool:
    """One part. nominal: all presses that may be taken. fresh, damaged: features of presses that are only scored."""

    presses: NominalPresses
    nominal: Nominal
    grid: Grid
    fresh: Features
    damaged: Features
    masks: NDArray[np.bool_]


def made_frames(shapes: int, number: int, sizes: Sizes) -> dict[str, NDArray[np.generic]]:
    """The pictures of one part, uint8 (n, h, w, 3) of the whole sensor, and the masks, bool (n, h, w)."""
    part = RandomPartPresses(shapes, number, sizes.nominal + sizes.fresh + sizes.damaged)
    orders = iter(range(sizes.nominal + sizes.fresh + sizes.damaged))
    nominal = [part.press(k // sizes.each, 1 + k % sizes.each, next(orders)) for k in range(sizes.nominal)]
    fresh = [part.press(1000 + k, 1, next(orders)) for k in range(sizes.fresh)]
    damaged = [part.damaged(2000 + k, next(orders)) for k in range(sizes.damaged)]
    return {
        "nominal": np.stack(nominal),
        "fresh": np.stack(fresh),
        "damaged": np.stack([rgb for rgb, _ in damaged]),
        "masks": np.stack([mask for _, mask in damaged]),
        "free": np.stack([part.free_gel(k) for k in range(sizes.free)]),
    }


def pool(shapes: int, number: int, sizes: Sizes, cache: Path | None = None) -> Pool:
    """The part's presses with their features. cache: a folder where the pictures are kept."""
    frames = _kept(shapes, number, sizes, cache)
    names = [f"part_pos_s{k // sizes.each:03d}_p{1 + k % sizes.each:02d}.png" for k in range(sizes.nominal)]
    pictures, free = dict(zip(names, frames["nominal"], strict=True)), list(frames["free"])
    region = _around(gather_presses(pictures, PROFILE, Region.full(PROFILE.size), no_contact=free))
    presses = gather_presses(pictures, PROFILE, region, no_contact=free)
    session = open_session(open_trunk("tactile_resnet18", TAPS).graph, 1, "trunk")
    grid = trunk_grid(session, TAPS, (SIDE, SIDE), PROFILE.pixels_per_mm)

    def features(pictures: NDArray[np.uint8]) -> Features:
        return extract(session, np.stack([region.crop(rgb) for rgb in pictures]), grid, lambda done: None)

    nominal = Nominal(features(frames["nominal"]), presses.touched, features(frames["free"]))
    masks = np.stack([region.crop(mask) for mask in frames["masks"]])
    return Pool(presses, nominal, grid, features(frames["fresh"]), features(frames["damaged"]), masks)


def _around(presses: NominalPresses) -> Region:
    """A square of SIDE pixels around the middle of the contacts, inside the picture."""
    width, height = PROFILE.size
    x = round(float(np.mean([touch.x for touch in presses.touches])) * width - SIDE / 2)
    y = round(float(np.mean([touch.y for touch in presses.touches])) * height - SIDE / 2)
    return Region(min(max(x, 0), width - SIDE), min(max(y, 0), height - SIDE), SIDE, SIDE)


def _kept(shapes: int, number: int, sizes: Sizes, cache: Path | None) -> dict[str, NDArray[np.generic]]:
    file = (
        None if cache is None else cache / f"{shapes}-{number}-{sizes.each}-{sizes.nominal}-{sizes.fresh}.npz"
    )
    if file is not None and file.exists():
        with np.load(file) as found:
            return dict(found)
    made = made_frames(shapes, number, sizes)
    if file is not None:
        part = file.with_suffix(".part.npz")
        np.savez(part, **made)
        part.replace(file)
    return made
