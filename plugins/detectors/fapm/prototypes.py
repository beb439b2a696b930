"""A few prototypes for each group of places: which places share a bank, and which of their nominal rows it keeps.

k-centre within each group: each pick is the row farthest from those before it. Groups whose cell has the rows farthest
from its prototypes keep more of them ("far").
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, Mask
from plugins.detectors.common.batched_nearest import SHORTLIST, emit_closest, emit_group_nearest, emit_ranked
from plugins.detectors.common.distances import nearest
from plugins.detectors.common.untouched_places import emit_gel_distances, gel_distances
from plugins.onnx_builder import Graph, Value

__all__ = [
    "Chosen",
    "Layout",
    "Prototypes",
    "cell_layout",
    "cell_scales",
    "choose_prototypes",
    "emit_prototype_distances",
    "pick",
    "prototype_distances",
]

# Numbers of rows held at once during a fit (32 MB).
HELD = 8 * 2**20
# A squared distance below this part of the two squared lengths is rounding of the float32 product form.
ROUNDING = 2e-6


class Layout(NamedTuple):
    """One layer's places."""

    cell: NDArray[np.int64]
    """The cell of each group, int64 (groups,)."""
    groups: NDArray[np.int64]
    """The places that share a bank, int64 (g, s); the last cell of an axis repeats its border where the grid ends
    inside it."""

    def only(self, chosen: Mask) -> "Layout":
        """The chosen groups."""
        return Layout(self.cell[chosen], self.groups[chosen])


def cell_layout(shape: tuple[int, int], side: int, is_shared: bool) -> Layout:
    """The places of a map (h, w) in cells of side x side. is_shared: a cell's places share a bank."""
    h, w = shape
    rows, columns = -(-h // side), -(-w // side)
    if not is_shared:
        cell = (np.arange(h)[:, None] // side * columns + np.arange(w)[None] // side).ravel()
        return Layout(cell, np.arange(h * w)[:, None])
    y = np.minimum(np.arange(rows * side), h - 1).reshape(rows, 1, side, 1)
    x = np.minimum(np.arange(columns * side), w - 1).reshape(1, columns, 1, side)
    return Layout(np.arange(rows * columns), (y * w + x).reshape(rows * columns, -1))


class Prototypes(NamedTuple):
    """The chosen rows."""

    mean: F32
    """The mean of each group, float32 (g, c)."""
    rows: F32
    """Centred, in the order of picking, float32 (g, far, c); a group that is not far has `near` of them, and zeros."""
    near: int
    is_far: Mask
    """Whether a group is far, bool (g,)."""
    apart: F64
    """Float64 (g, s * n): the distance of each nominal row to the kept prototypes of other presses, infinite where
    there are none."""


class _Learnt(NamedTuple):
    """What one number of prototypes gives."""

    mean: F32
    rows: F32
    radius: F64
    """How far the rows of a place are from the prototypes, float64 (g, s)."""
    apart: F64
    """As in `Prototypes`, for one number of prototypes."""


def choose_prototypes(
    rows: NDArray[np.floating], places: Layout, counts: tuple[int, int], far_quantile: float, start: float
) -> Prototypes:
    """Prototypes of each group from nominal rows (n, places, c).

    counts: near and far. far_quantile: cells at or above this quantile are far. start: which row is picked first, as a
    share of the set, so that it means the same at every size.
    """
    near, far = counts
    all_near = _learn(rows, places.groups, near, start)
    cells, of_group = np.unique(places.cell, return_inverse=True)
    reach = np.bincount(of_group, all_near.radius.mean(axis=1), len(cells)) / np.bincount(of_group)
    is_far = (reach >= np.quantile(reach, far_quantile))[of_group]
    more = _learn(rows, places.groups[is_far], far, start)
    chosen = np.zeros((len(places.groups), far, rows.shape[2]), np.float32)
    chosen[:, :near] = all_near.rows
    chosen[is_far], all_near.apart[is_far] = more.rows, more.apart
    return Prototypes(all_near.mean, chosen, near, is_far, all_near.apart)


def _learn(rows: NDArray[np.floating], groups: NDArray[np.int64], count: int, start: float) -> _Learnt:
    """`count` prototypes of each group (g, s) of places."""
    n, _, c = rows.shape
    s = groups.shape[1]
    learnt = _Learnt(
        np.empty((len(groups), c), np.float32),
        np.empty((len(groups), count, c), np.float32),
        np.empty((len(groups), s)),
        np.empty((len(groups), s * n)),
    )
    at_once = max(1, HELD // (n * s * c))
    for first in range(0, len(groups), at_once):
        part = slice(first, first + at_once)
        x = _rows_of(rows, groups[part])
        learnt.mean[part] = x.mean(axis=1, dtype=np.float64)
        x -= learnt.mean[part, None]
        for group, centred in enumerate(x, first):
            chosen = pick(centred, count, int(start * n * s), s)
            learnt.rows[group] = centred[chosen.picks]
            learnt.radius[group] = np.sqrt(chosen.nearest, dtype=np.float64).reshape(n, s).max(axis=0)
            learnt.apart[group] = np.sqrt(chosen.apart, dtype=np.float64)
    return learnt


class Chosen(NamedTuple):
    """Rows of a group, and how far every row is from them."""

    picks: NDArray[np.int64]
    """The rows in the order of picking, int64 (count,)."""
    nearest: F32
    """Squared distances to the nearest pick, float32 (n,)."""
    apart: F32
    """Squared distances to the nearest pick of another press, infinite where there is none, float32 (n,)."""


def pick(rows: F32, count: int, start: int, s: int) -> Chosen:
    """Pick rows of a group's centred ones (n, c), of which each press has s: first `start`, then always the farthest.

    Among equals the lowest is picked. No row is picked twice.
    """
    n, c = rows.shape
    lengths = np.einsum("nc,nc->n", rows, rows)
    # A product of (-2a, |a|^2, 1) with columns (b, 1, |b|^2) is the squared distance.
    columns = np.ones((c + 2, n), np.float32)
    columns[:c], columns[-1] = rows.T, lengths
    asking = -2 * columns.T
    asking[:, -2], asking[:, -1] = lengths, 1
    picks, left = np.full(count, start), np.full(n, np.inf, np.float32)
    for number in range(count):
        if number:
            picks[number] = left.argmax()
        np.minimum(left, np.maximum(asking[picks[number]] @ columns, 0), out=left)
        left[picks[number]] = -1
    squared = asking[picks] @ columns
    squared[squared <= ROUNDING * (lengths[picks, None] + lengths)] = 0
    nearest = squared.min(axis=0)
    squared[picks[:, None] // s == np.arange(n) // s] = np.inf
    return Chosen(picks, nearest, squared.min(axis=0))


def _rows_of(rows: NDArray[np.floating], groups: NDArray[np.int64]) -> NDArray[np.floating]:
    """The rows (g, n * s, c) of groups (g, s) of places, press by press."""
    n, _, c = rows.shape
    columns = np.empty((n, groups.size, c), rows.dtype)
    # In memory a channel's places follow each other: taken as columns and turned while they are in the cache.
    for press, taken in zip(rows, columns, strict=True):
        taken[:] = press.T[:, groups.ravel()].T
    return columns.reshape(n, len(groups), -1).swapaxes(0, 1).reshape(len(groups), -1, c)


def cell_scales(apart: F64, cell: NDArray[np.int64], floor_quantile: float) -> F64:
    """The scale of each group's cell (g,): the median of its nominal distances to other presses' prototypes.

    Scales are floored at a quantile of all; where no press can be compared with another, they are all 1.
    """
    cells, of_group = np.unique(cell, return_inverse=True)
    scale = np.empty(len(cells))
    for number in range(len(cells)):
        values = apart[of_group == number]
        values = values[np.isfinite(values)]
        scale[number] = np.median(values) if values.size else np.nan
    known = scale[np.isfinite(scale) & (scale > 0)]
    if not known.size:
        return np.ones(len(cell))
    scale = np.where(np.isfinite(scale), scale, np.median(known))
    floored: F64 = np.maximum(scale, np.quantile(known, floor_quantile))[of_group]
    return floored


def prototype_distances(
    rows: NDArray[np.floating], tap: str, arrays: Mapping[str, NDArray[Any]], k: int
) -> F64:
    """The oracle: distances (n, places, k) of rows (n, places, c) to each place's nearest prototypes.

    The last distance is repeated where there are fewer than k. arrays: FAPM's bank, see `Fapm.fit`.
    """
    distances = np.empty((*rows.shape[:2], k))
    for kind in ("near", "far"):
        names = (f"{tap}_{kind}", f"{tap}_{kind}_mean", f"{tap}_{kind}_places")
        for bank, mean, places in zip(*(arrays.get(name, ()) for name in names), strict=True):
            asked = rows[:, places] - mean
            nearest_k = nearest(asked.reshape(-1, rows.shape[2]), bank, k).distances
            repeated = nearest_k[:, np.minimum(np.arange(k), nearest_k.shape[1] - 1)]
            distances[:, places] = repeated.reshape(len(rows), len(places), -1)
    if f"{tap}_gel" in arrays:
        places = arrays[f"{tap}_gel_places"]
        gel = gel_distances(rows[:, places], arrays[f"{tap}_gel"], arrays[f"{tap}_gel_weight"])
        distances[:, places] = gel[:, :, None]
    return distances


def emit_prototype_distances(
    graph: Graph, rows: Value, tap: str, arrays: Mapping[str, NDArray[Any]], k: int
) -> Value:
    """Give the same distances in a graph. rows: (n, places, c). Groups, prototypes and touched places are free."""
    parts = [
        _emit_kind(graph, rows, f"{tap}_{kind}", arrays, k)
        for kind in ("near", "far")
        if f"{tap}_{kind}" in arrays
    ]
    if f"{tap}_gel" in arrays:
        parts.append(_emit_gel(graph, rows, tap, arrays[f"{tap}_gel"].shape[1], k))
    distances = graph.concat(parts, 1)
    order = graph.input(f"{tap}_order", arrays[f"{tap}_order"].shape, "int64")
    return graph.op("Gather", distances, order, axis=1)


def _emit_kind(graph: Graph, rows: Value, name: str, arrays: Mapping[str, NDArray[Any]], k: int) -> Value:
    """Distances (n, groups * s, k) of the groups of one kind."""
    c, s = arrays[name].shape[2], arrays[f"{name}_places"].shape[1]
    groups = f"{name}_groups"
    here = graph.op("Gather", rows, graph.input(f"{name}_places", (groups, s), "int64"), axis=1)
    mean = graph.unsqueeze(graph.input(f"{name}_mean", (groups, c)), 1)
    asked = graph.op("Sub", here, mean)
    prototypes = graph.input(name, (groups, f"{name}_prototypes", c))
    if k == 1:
        return graph.reshape(emit_closest(graph, asked, prototypes, c), 0, -1, 1)
    # All presses under their group's bank at once: (groups, s * n, c).
    asked = graph.reshape(graph.transpose(asked, 1, 2, 0, 3), 0, -1, c)
    distances = emit_group_nearest(graph, asked, emit_ranked(graph, prototypes), c, k, max(k, SHORTLIST))
    last = graph.op("Sub", graph.op("Shape", distances, start=2, end=3), graph.ints(1))
    repeated = graph.op("Gather", distances, graph.op("Min", graph.ints(*range(k)), last), axis=2)
    by_press = graph.transpose(graph.reshape(repeated, 0, s, -1, k), 2, 0, 1, 3)
    return graph.reshape(by_press, 0, -1, k)


def _emit_gel(graph: Graph, rows: Value, tap: str, c: int, k: int) -> Value:
    """Distances (n, places, k) from the free gel, the same for all neighbours."""
    count = f"{tap}_gel_places"
    here = graph.op("Gather", rows, graph.input(f"{tap}_gel_places", (count,), "int64"), axis=1)
    mean, weight = graph.input(f"{tap}_gel", (count, c)), graph.input(f"{tap}_gel_weight", (1,))
    distances = graph.unsqueeze(emit_gel_distances(graph, here, mean, weight), 2)
    return graph.op("Concat", *[distances] * k, axis=2) if k > 1 else distances
