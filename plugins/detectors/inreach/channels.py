"""Channels of patches across nominal presses: which patches keep finding each other, and which of them are strays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Progress
from plugins.detectors.common.batched_nearest import PRODUCT_LIMIT
from plugins.detectors.inreach.parameters import InreachParameters

__all__ = ["Channels", "associate", "prune"]

# Distances to a channel's mean beyond this quantile of all members' are strays, whatever their channel's own spread.
# The rarest nominal patches are what the bank needs most: at 0.95 AU-PRO was lower by 0.045 (six random parts).
STRAY_QUANTILE = 0.99
# Two distances that differ by less than this part are equal: rounding of float32.
EQUAL = 1e-5
# A squared distance below this part of the two squared lengths is rounding of the product, in float32.
ROUNDING = 1e-6


class Channels(NamedTuple):
    """Elements of channels, sorted by channel. key: the channel, realisation * cells + its patch. press, patch: whose
    descriptor the element is."""

    key: NDArray[np.int64]
    press: NDArray[np.int64]
    patch: NDArray[np.int64]


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
