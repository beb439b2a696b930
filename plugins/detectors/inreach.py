"""InReaCh: patches that keep finding each other across nominal presses are normal; those that do not are left out.

Definition (McIntosh and Branzan Albu, "Inter-realization channels: unsupervised anomaly detection beyond one-class
classification", ICCV 2023), written from the paper and from an account of DeclanMcIntosh/InReaCh @a0d54ba, which has no
licence and was not copied. The first ten presses are realisations: each of their patches opens a channel, and a
patch of a later press joins the channel of its mutual nearest neighbour. Channels that stay too short are dropped, and
members that lie too far from their channel's mean. What remains is the bank; a press scores by the distance to its
nearest row. Because strays are left out, a few bad presses among the nominal ones do little harm.

`max_dispersion` is 5.0 in the paper's words "internal dispersion below 5.0": in the published code it multiplies the
standard deviation of the members' distances to their mean, and is no length of its own. So it is here.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from edge.core.errors import FitError
from plugins.detectors.choices import choose, repaired, require_fittable, require_scorable
from plugins.detectors.maths.coreset import k_centre
from plugins.detectors.maths.descriptor import Descriptor, Kind
from plugins.detectors.maths.mosaic import layout
from plugins.detectors.maths.patchbank import PatchBank
from plugins.detectors.maths.shortlist import PRODUCT_LIMIT
from plugins.detectors.maths.smoothing import PAPER_SIGMA_PX, Smoothing, Upsampling, emit_scores
from plugins.graph import Graph

__all__ = ["InreachParameters", "associate", "inreach", "prune"]

# The taps of the published descriptor on Wide-ResNet-50-2; layer3.0 is skipped there.
PAPER_TAPS = (
    "layer1.0", "layer1.1", "layer1.2",
    "layer2.0", "layer2.1", "layer2.2", "layer2.3",
    "layer3.1", "layer3.2", "layer3.3", "layer3.4", "layer3.5",
    "layer4.0",
)  # fmt: skip
# InReaCh.py: the blur of the score map, in pixels of a 224 crop.
PUBLISHED_SIGMA_PX = 13.0
# Distances to a channel's mean beyond this quantile of all members' are strays, whatever their channel's own spread.
# The rarest nominal patches are what the bank needs most: at 0.95 AU-PRO was lower by 0.045 (six random parts).
STRAY_QUANTILE = 0.99
# Two distances that differ by less than this part are equal: rounding of float32.
EQUAL = 1e-5
# A squared distance below this part of the two squared lengths is rounding of the product, in float32.
ROUNDING = 1e-6
# The paper's four pixels at 320x240, where a millimetre is 15.77 pixels.
SIGMA_MM = PAPER_SIGMA_PX / 15.77


@dataclass(frozen=True)
class InreachParameters:
    """What InReaCh can be told; every repair is a switch of its own.

    taps, grid_tap, descriptor: see maths/descriptor.py; any trunk's taps will do, and layer1 alone on its own grid is
    what touch wants: see PatchcoreParameters. dims: leading directions kept, plus
    the length of the rest; None keeps all. is_balanced: each tap is divided by its nominal deviation. position_weight:
    two more numbers in each descriptor, the place times this; the published code switches 5.0 on by a test of the
    frames themselves, which a fit from features cannot make.
    realisations: presses that open channels. is_index_right: a member is the patch that matched; published, the two
    patch numbers of a match are swapped. is_mutual_sought: a patch joins the closest realisation that is mutual,
    instead of being lost when the closest of all is not. is_tie_local: among equally near patches the one at the same
    place wins, so that constant gel keeps its channels.
    minimum_length: elements that a channel needs, its opener counted. is_minimum_exceeded: it needs one more, as
    published. length_fraction: when positive, the minimum is this share of what a channel can have, at least 2,
    because few presses cannot make long channels.
    max_dispersion: see the module. is_floored: a member may also lie as far as the stray distance that 99 % of all
    members keep, so that a channel without spread keeps its members. is_spread_limited: channels whose root mean
    square distance exceeds that are dropped.
    is_touched_only: patches are of cells that a nominal press touches; to the bank come a few of free gel.
    most_patches: patches of each press that take part, drawn for each anew; None: all. AU-PRO on those parts with
    400, 640 and 1000: 0.717, 0.737, 0.738; the time of a fit grows with the square.
    is_fallback: when no channel remains the bank is every patch, with a warning, instead of no bank.
    most_rows: the bank is thinned to so many rows by k-centre; None keeps all. is_squared: squared distances, as
    published. upsampling: of the grid to pixels. sigma: the blur, in `sigma_unit`.
    """

    mode: Mode = "corrected"
    taps: tuple[str, ...] = ("layer1",)
    grid_tap: str = "layer1"
    descriptor: Kind = "cells"
    dims: int | None = 64
    is_balanced: bool = True
    position_weight: float = 0.0
    realisations: int = 10
    is_index_right: bool = True
    is_mutual_sought: bool = True
    is_tie_local: bool = True
    minimum_length: int = 3
    is_minimum_exceeded: bool = False
    length_fraction: float = 0.5
    max_dispersion: float = 5.0
    is_floored: bool = True
    is_spread_limited: bool = True
    is_touched_only: bool = True
    most_patches: int | None = 640
    is_fallback: bool = True
    most_rows: int | None = 768
    is_squared: bool = False
    upsampling: Upsampling = "sampled"
    sigma: float = SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    packing: Packing = "float16"

    def __post_init__(self) -> None:
        for name, least in (
            ("realisations", 1),
            ("minimum_length", 1),
            ("length_fraction", 0),
            ("position_weight", 0),
            ("max_dispersion", 0),
            ("sigma", 0),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                raise ValueError(f"{name} is at least {least}, found {value}")
        for name in ("dims", "most_patches", "most_rows"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} is at least 1, or None for all, found {value}")
        for name, known in (
            ("upsampling", ("sampled", "bilinear", "nearest")),
            ("sigma_unit", ("mm", "px")),
            ("packing", ("none", "float16", "int8")),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is one of {', '.join(known)}, found '{getattr(self, name)}'")
        _ = self.rows

    @property
    def rows(self) -> PatchBank:
        descriptor = Descriptor(self.taps, self.grid_tap, self.descriptor, self.upsampling == "sampled")
        return PatchBank(descriptor, self.dims, self.is_balanced, self.position_weight)

    def smoothing(self, grid: Grid) -> Smoothing:
        sigma_px = self.sigma * (grid.pixels_per_mm if self.sigma_unit == "mm" else 1.0)
        cells = grid.taps[self.grid_tap][1:]
        return Smoothing(cells, grid.frame, sigma_px, self.upsampling, grid.tiles)

    def shortest(self, presses: int) -> int:
        """Elements that a channel needs when there are so many presses."""
        if self.length_fraction > 0:
            depth = min(self.realisations, presses)
            return max(2, math.ceil(self.length_fraction * (presses - 1) / depth))
        return self.minimum_length + self.is_minimum_exceeded


PAPER = InreachParameters(
    mode="paper",
    taps=PAPER_TAPS,
    grid_tap="layer1.0",
    descriptor="binned",
    dims=None,
    is_balanced=False,
    is_index_right=False,
    is_mutual_sought=False,
    is_tie_local=False,
    is_minimum_exceeded=True,
    length_fraction=0.0,
    is_floored=False,
    is_spread_limited=False,
    is_touched_only=False,
    most_patches=None,
    is_fallback=False,
    most_rows=None,
    is_squared=True,
    upsampling="nearest",
    sigma=PUBLISHED_SIGMA_PX,
    sigma_unit="px",
    packing="none",
)


class Channels(NamedTuple):
    """Elements of channels, sorted by channel. key: the channel, realisation * cells + its patch. press, patch: whose
    descriptor the element is."""

    key: NDArray[np.int64]
    press: NDArray[np.int64]
    patch: NDArray[np.int64]


REPAIRS = (
    "is_balanced",
    "is_index_right",
    "is_mutual_sought",
    "is_tie_local",
    "is_minimum_exceeded",
    "length_fraction",
    "is_floored",
    "is_spread_limited",
    "is_touched_only",
    "is_fallback",
    "is_squared",
    "upsampling",
)
"""The switches that set the corrected mode apart; the others are operating points."""


class Inreach:
    """InReaCh under the entry points `gelgate.detectors`."""

    name = "inreach"

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> InreachParameters:
        """The mode's parameters with overrides. Errors: FitError."""
        return choose(self.name, PAPER if mode == "paper" else InreachParameters(), overrides)

    def taps(self, parameters: InreachParameters) -> tuple[str, ...]:
        return parameters.taps

    def fit(
        self,
        nominal: Nominal,
        grid: Grid,
        parameters: InreachParameters,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Bank:
        """Find the channels and keep their members: `bank` (rows, width), beside `mean`, `basis` and `scales`.
        Errors: FitError, also for an empty bank where there is no fallback.
        """
        p = parameters
        require_fittable(self.name, nominal, grid, p.taps, is_tileable=True)
        arrays, rows = p.rows.learn(nominal.features, grid, rng)
        touched, free = np.ones(rows.shape[1], bool), rows[:0, 0]
        if p.is_touched_only:
            touched, free = p.rows.touched(nominal, grid), p.rows.free_gel(nominal, grid, arrays, rows, rng)
        taking_part, tiles = _taking_part(touched, math.prod(layout(grid)), len(rows), p, rng)
        rows = np.take_along_axis(rows, taking_part[:, :, None], axis=1)
        channels = _associate_tiles(rows, tiles, p, lambda fraction: progress(0.9 * fraction))
        kept = prune(rows, channels, p)
        members = rows[kept.press, kept.patch]
        facts: dict[str, Any] = {
            "presses": nominal.presses,
            "realisations": min(p.realisations, nominal.presses),
            "patches": rows.shape[0] * rows.shape[1],
            "channels_found": len(np.unique(channels.key)),
            "channels_kept": len(np.unique(kept.key)),
            "shortest_channel": p.shortest(nominal.presses),
            "patches_kept": len(members),
            "repairs": repaired(p, PAPER, REPAIRS),
            "warnings": [],
        }
        if not len(members):
            members = self._fallback(rows, facts, p)
        pressed, members = len(members), np.concatenate([members, free])
        chosen = np.arange(len(members))
        if p.most_rows is not None and len(members) > p.most_rows:
            start = int(rng.integers(len(members)))
            found = k_centre(members, p.most_rows, start)
            chosen, facts["start"], facts["radius"] = found.rows, start, found.radius
        arrays["bank"] = np.ascontiguousarray(members[chosen])
        facts |= {"rows": len(chosen), "rows_of_free_gel": int((chosen >= pressed).sum())}
        progress(1.0)
        return Bank(arrays, {"bank": p.packing}, facts)

    def _fallback(
        self, rows: NDArray[np.float32], facts: dict[str, Any], p: InreachParameters
    ) -> NDArray[np.float32]:
        """Every patch of every press, and a warning. Errors: FitError where that is not wanted."""
        if not p.is_fallback:
            raise FitError(
                f"inreach: none of {facts['channels_found']} channels of {len(rows)} presses has "
                f"{p.shortest(len(rows))} elements within the dispersion; press more good parts"
            )
        facts["warnings"].append(
            f"no channel of {len(rows)} presses remained; the bank is every patch, strays among them"
        )
        return rows.reshape(-1, rows.shape[2])

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: InreachParameters
    ) -> ScoreMaps:
        """The float64 oracle. Errors: NotScorable for features that are not finite."""
        p = parameters
        require_scorable(self.name, features, p.taps)
        return p.smoothing(grid).score_maps(p.rows.distances(features, grid, bank.arrays, p.is_squared))

    def head(self, grid: Grid, bank: Bank, parameters: InreachParameters) -> bytes:
        """The graph; the number of rows in the bank is free."""
        p = parameters
        graph = Graph(self.name)
        emit_scores(graph, p.rows.emit(graph, grid, bank, p.is_squared), p.smoothing(grid))
        return graph.serialise()


inreach = Inreach()


def _taking_part(
    touched: NDArray[np.bool_], tiles: int, presses: int, p: InreachParameters, rng: np.random.Generator
) -> tuple[NDArray[np.int64], list[slice]]:
    """The cells of each press that take part, int64 (presses, m), and where each tile's stand among them.

    Where not all do, each press has its own draw: together they see every place, and a bank has to know every place.
    """
    cells = len(touched) // tiles
    parts: list[NDArray[np.int64]] = []
    tile_of: list[slice] = []
    for tile in range(tiles):
        here = tile * cells + np.flatnonzero(touched[tile * cells : (tile + 1) * cells])
        if not len(here):
            continue
        most = len(here) if p.most_patches is None else min(p.most_patches, len(here))
        drawn = [np.sort(rng.choice(here, most, replace=False)) for _ in range(presses)]
        first = tile_of[-1].stop if tile_of else 0
        parts.append(np.stack(drawn) if most < len(here) else np.tile(here, (presses, 1)))
        tile_of.append(slice(first, first + most))
    return np.concatenate(parts, axis=1), tile_of


def _associate_tiles(
    rows: NDArray[np.float32], tiles: list[slice], p: InreachParameters, progress: Progress
) -> Channels:
    """Channels tile by tile: a patch is looked for in its own tile alone, as if each tile were a model of its own."""
    found = []
    for number, tile in enumerate(tiles):
        channels = associate(rows[:, tile], p, _part_of(progress, number, len(tiles)))
        found.append(
            Channels(channels.key + tile.start * len(rows), channels.press, channels.patch + tile.start)
        )
    return Channels(*(np.concatenate(fields) for fields in zip(*found, strict=True)))


def _part_of(progress: Progress, number: int, count: int) -> Progress:
    return lambda done: progress((number + done) / count)


def associate(
    rows: NDArray[np.float32], p: InreachParameters, progress: Progress = lambda fraction: None
) -> Channels:
    """The channels of presses (n, cells, width), openers included, before any is dropped.

    Only the best realisation so far is remembered for each patch. Among equally near realisations the first wins.
    """
    n, cells = rows.shape[:2]
    keys, presses, patches = [], [], []
    # Two more columns each, so that a product is the squared distance: (-2a, |a|^2, 1) with (b, 1, |b|^2).
    ones = np.ones((n, cells, 1), np.float32)
    lengths = np.einsum("npc,npc->np", rows, rows)[:, :, None]
    asking, asked_of = (
        np.concatenate(columns, axis=2) for columns in ((-2 * rows, lengths, ones), (rows, ones, lengths))
    )
    for press in range(1, n):
        best = np.full(cells, np.inf, np.float32)
        opener, is_joined = np.zeros(cells, np.int64), np.zeros(cells, bool)
        seeds = min(press, p.realisations)
        nearest = _nearest(asking[press], asked_of[:seeds])
        for seed in range(seeds):
            found = _match(
                rows[press], rows[seed], Nearest(*(each[seed] for each in nearest)), p.is_tie_local
            )
            is_better = found.squared < best
            if p.is_mutual_sought:
                is_better &= found.is_mutual
            best[is_better] = found.squared[is_better]
            opener[is_better] = seed * cells + found.patch[is_better]
            is_joined[is_better] = found.is_mutual[is_better]
        patch = np.flatnonzero(is_joined)
        key = opener[patch]
        if not p.is_index_right:
            key, patch = key // cells * cells + patch, key % cells
        keys.append(key)
        presses.append(np.full(len(key), press))
        patches.append(patch)
        progress(press / max(1, n - 1))
    return _with_openers(keys, presses, patches, cells)


class Match(NamedTuple):
    """For each patch of a press, its nearest patch of a realisation. squared: float32 (cells,). patch: int64 (cells,).
    is_mutual: whether that patch's nearest is this one."""

    squared: NDArray[np.float32]
    patch: NDArray[np.int64]
    is_mutual: NDArray[np.bool_]


def _with_openers(
    keys: list[NDArray[np.int64]],
    presses: list[NDArray[np.int64]],
    patches: list[NDArray[np.int64]],
    cells: int,
) -> Channels:
    key = np.concatenate([np.empty(0, np.int64), *keys])
    opened = np.unique(key)
    key = np.concatenate([opened, key])
    press = np.concatenate([opened // cells, *presses]).astype(np.int64)
    patch = np.concatenate([opened % cells, *patches]).astype(np.int64)
    order = np.argsort(key, kind="stable")
    return Channels(key[order], press[order], patch[order])


class Nearest(NamedTuple):
    """Both ways between a press and each of k realisations, by the product. there: int64 (k, cells), for each patch of
    the press the nearest of the realisation. away: float32 (k, cells), how far, squared. back: float32 (k, cells), how
    far the nearest patch of the press is from each of the realisation's."""

    there: NDArray[np.int64]
    away: NDArray[np.float32]
    back: NDArray[np.float32]


def _nearest(asking: NDArray[np.float32], asked_of: NDArray[np.float32]) -> Nearest:
    """One product serves all realisations both ways; so many rows at a time that it stays bounded."""
    seeds, cells, width = asked_of.shape
    there, away = np.empty((seeds, cells), np.int64), np.empty((seeds, cells), np.float32)
    back = np.full((seeds, cells), np.inf, np.float32)
    step = max(1, PRODUCT_LIMIT // (seeds * cells))
    for first in range(0, cells, step):
        part = slice(first, first + step)
        squared = (asking[part] @ asked_of.reshape(-1, width).T).reshape(-1, seeds, cells)
        found = squared.argmin(axis=2)
        there[:, part] = found.T
        away[:, part] = np.take_along_axis(squared, found[:, :, None], axis=2)[:, :, 0].T
        np.minimum(back, squared.min(axis=0), out=back)
    return Nearest(there, away, back)


def _match(
    asked: NDArray[np.float32], seed: NDArray[np.float32], nearest: Nearest, is_tie_local: bool
) -> Match:
    """The matches of a press's patches (cells, width) with a realisation's, measured exactly.

    Among equally near patches the lowest wins, or the one at the same place.
    """
    every, there = np.arange(len(asked)), nearest.there
    exact, back = _squared(asked, seed[there]), np.full(len(asked), -1)
    both = np.flatnonzero(nearest.away <= nearest.back[there])[::-1]
    back[there[both]] = both
    if is_tie_local:
        here = _squared(asked, seed)
        lengths = sum(np.einsum("pc,pc->p", each, each) for each in (asked, seed))
        is_there = here <= exact * (1 + EQUAL)
        is_back = here <= np.maximum(nearest.back, 0) * (1 + EQUAL) + ROUNDING * lengths
        there, back = np.where(is_there, every, there), np.where(is_back, every, back)
        exact = np.where(is_there, here, exact)
    return Match(exact, there, back[there] == every)


def _squared(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    difference = a - b
    squares: NDArray[np.float32] = np.einsum("pc,pc->p", difference, difference)
    return squares


def prune(rows: NDArray[np.float32], channels: Channels, p: InreachParameters) -> Channels:
    """The members of channels that are long and tight enough."""
    shortest = p.shortest(len(rows))
    channels = _longer(channels, shortest)
    if not len(channels.key):
        return channels
    values = rows[channels.press, channels.patch].astype(np.float64)
    _, first, number, length = np.unique(
        channels.key, return_index=True, return_inverse=True, return_counts=True
    )
    mean = np.add.reduceat(values, first, axis=0) / length[:, None]
    away = np.linalg.norm(values - mean[number], axis=1)
    mean_square = np.add.reduceat(away**2, first) / length
    mean_away = np.add.reduceat(away, first) / length
    deviation = np.sqrt(np.add.reduceat((away - mean_away[number]) ** 2, first) / length)
    stray = float(np.quantile(away, STRAY_QUANTILE))
    limit = p.max_dispersion * deviation[number]
    is_kept = away <= np.maximum(limit, stray) if p.is_floored else away < limit
    if p.is_spread_limited:
        is_kept &= np.sqrt(mean_square)[number] <= stray * (1 + EQUAL)
    return _longer(Channels(*(field[is_kept] for field in channels)), shortest)


def _longer(channels: Channels, shortest: int) -> Channels:
    """Channels with at least so many elements."""
    _, number, length = np.unique(channels.key, return_inverse=True, return_counts=True)
    is_kept = length[number] >= shortest
    return Channels(*(field[is_kept] for field in channels))
