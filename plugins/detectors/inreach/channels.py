"""Channels of patches across nominal presses: which patches match each other repeatedly, and which are strays."""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from edge.core.detector import Progress
from plugins.detectors.common.batched_nearest import PRODUCT_LIMIT
from plugins.detectors.inreach.parameters import InreachParameters, Match, Nearest, squared_distances

__all__ = ["Channels", "associate", "prune"]

# Members farther from their channel's mean than this quantile of all members are strays, whatever their channel's
# spread. The bank needs the rarest nominal patches most: at 0.95 AU-PRO was lower by 0.045 (six random parts).
STRAY_QUANTILE = 0.99


class Channels(NamedTuple):
    """Elements of channels, sorted by channel."""

    key: NDArray[np.int64]
    """The channel, realisation * cells + its patch."""
    press: NDArray[np.int64]
    patch: NDArray[np.int64]
    """Press and patch whose descriptor the element is."""


def associate(rows: F32, p: InreachParameters, progress: Progress = lambda fraction: None) -> Channels:
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
            match = _match(rows[press], rows[seed], Nearest(*(each[seed] for each in nearest)), p)
            is_better = p.is_taken(match, best)
            best[is_better] = match.squared[is_better]
            opener[is_better] = seed * cells + match.there[is_better]
            is_joined[is_better] = match.is_mutual[is_better]
        joined = np.flatnonzero(is_joined)
        key, patch = p.member(opener[joined], joined, cells)
        keys.append(key)
        presses.append(np.full(len(key), press))
        patches.append(patch)
        progress(press / max(1, n - 1))
    return _with_openers(keys, presses, patches, cells)


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


def _nearest(asking: F32, asked_of: F32) -> Nearest:
    """A product for each realisation, small enough for the cache, in slices of rows that limit the memory."""
    seeds, cells, _ = asked_of.shape
    there, away = np.empty((seeds, cells), np.int64), np.empty((seeds, cells), np.float32)
    back = np.full((seeds, cells), np.inf, np.float32)
    step = max(1, PRODUCT_LIMIT // cells)
    product = np.empty((min(step, cells), cells), np.float32)
    for seed, first in itertools.product(range(seeds), range(0, cells, step)):
        part = slice(first, min(first + step, cells))
        squared = np.matmul(asking[part], asked_of[seed].T, out=product[: part.stop - first])
        there[seed, part] = closest = squared.argmin(axis=1)
        away[seed, part] = squared[np.arange(len(closest)), closest]
        np.minimum(back[seed], squared.min(axis=0), out=back[seed])
    return Nearest(there, away, back, asking[:, -2] + asked_of[:, :, -1])


def _match(asked: F32, seed: F32, nearest: Nearest, p: InreachParameters) -> Match:
    """Match a press's patches (cells, width) with a realisation's, with exact distances."""
    there, back = nearest.there, np.full(len(asked), -1)
    both = np.flatnonzero(nearest.away <= nearest.back[there])[::-1]
    back[there[both]] = both
    return p.prefer(asked, seed, nearest, Match(squared_distances(asked, seed[there]), there, back))


def prune(rows: F32, channels: Channels, p: InreachParameters) -> Channels:
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
    is_kept = p.is_near(away, p.max_dispersion * deviation[number], stray)
    is_kept &= p.is_tight(np.sqrt(mean_square)[number], stray)
    return _longer(Channels(*(field[is_kept] for field in channels)), shortest)


def _longer(channels: Channels, shortest: int) -> Channels:
    """Channels with at least the given number of elements."""
    _, number, length = np.unique(channels.key, return_inverse=True, return_counts=True)
    is_kept = length[number] >= shortest
    return Channels(*(field[is_kept] for field in channels))
