"""InReaCh: patches that match each other repeatedly across nominal presses are normal; the others are left out.

Definition (McIntosh and Branzan Albu, "Inter-realization channels: unsupervised anomaly detection beyond one-class
classification", ICCV 2023), written from the paper and from an account of DeclanMcIntosh/InReaCh @a0d54ba, which has no
licence and was not copied. The first ten presses are realisations: each of their patches opens a channel, and a
patch of a later press joins the channel of its mutual nearest neighbour. Channels that stay too short are dropped, and
members that lie too far from their channel's mean. What remains is the bank; a press scores by the distance to its
nearest row. Because strays are left out, a few bad presses among the nominal ones do little harm.

`max_dispersion` is the 5.0 of the paper's "internal dispersion below 5.0". In the published code, and here, it is not a
length: it multiplies the standard deviation of the members' distances to their mean.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, Mask
from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Progress, ScoreMaps
from edge.core.errors import FitError
from plugins.detectors.common.coreset import k_centre
from plugins.detectors.common.parameters import Rng, choose, list_repairs
from plugins.detectors.common.smoothing import emit_scores
from plugins.detectors.common.tile_layout import layout
from plugins.detectors.common.validation import require_fittable, require_scorable
from plugins.detectors.inreach.channels import Channels, associate, prune
from plugins.detectors.inreach.paper import PAPER, REPAIRS
from plugins.detectors.inreach.parameters import InreachParameters
from plugins.onnx_builder import Graph

__all__ = ["InreachParameters", "inreach"]


class Inreach:
    """InReaCh under the entry points `gelgate.detectors`."""

    name = "inreach"
    compares_places = False
    is_baseline = False

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> InreachParameters:
        return choose(self.name, PAPER if mode == "paper" else InreachParameters(), PAPER, overrides)

    def taps(self, parameters: InreachParameters) -> tuple[str, ...]:
        return parameters.taps

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: InreachParameters, rng: Rng, progress: Progress
    ) -> Bank:
        """Find the channels and keep their members: `bank` (rows, width), and `mean`, `basis` and `scales`.
        Errors: FitError, also for an empty bank where there is no fallback.
        """
        p = parameters
        require_fittable(self.name, nominal, grid, p.taps)
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
            "repairs": list_repairs(p, PAPER, REPAIRS),
            "warnings": [],
        }
        if not len(members):
            members = self._fallback(rows, facts, p)
        pressed, members = len(members), np.concatenate([members, free])
        chosen = np.arange(len(members))
        most = nominal.limit(p.most_rows)
        if most is not None and len(members) > most:
            start = int(rng.integers(len(members)))
            coreset = k_centre(members, most, start)
            chosen, facts["start"], facts["radius"] = coreset.rows, start, coreset.radius
        arrays["bank"] = np.ascontiguousarray(members[chosen])
        facts |= {"rows": len(chosen), "rows_of_free_gel": int((chosen >= pressed).sum())}
        progress(1.0)
        return Bank(arrays, {"bank": p.packing}, facts)

    def _fallback(self, rows: F32, facts: dict[str, Any], p: InreachParameters) -> F32:
        """Every patch of every press, and a warning. Errors: FitError where this is switched off."""
        if not p.has_fallback:
            raise FitError(
                f"inreach: none of {facts['channels_found']} channels of {len(rows)} presses has "
                f"{p.shortest(len(rows))} elements within the dispersion; press more good parts"
            )
        facts["warnings"].append(
            f"no channel of {len(rows)} presses remains; the bank is every patch, strays included"
        )
        return rows.reshape(-1, rows.shape[2])

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: InreachParameters
    ) -> ScoreMaps:
        p = parameters
        require_scorable(self.name, features, p.taps)
        return p.smoothing(grid).score_maps(p.rows.distances(features, grid, bank.arrays, p.is_squared))

    def head(self, grid: Grid, bank: Bank, parameters: InreachParameters) -> bytes:
        """The graph; the number of rows in the bank is free."""
        p, graph = parameters, Graph(self.name)
        emit_scores(graph, p.rows.emit(graph, grid, bank, p.is_squared), p.smoothing(grid))
        return graph.serialise()


inreach = Inreach()


def _taking_part(
    touched: Mask, tiles: int, presses: int, p: InreachParameters, rng: Rng
) -> tuple[NDArray[np.int64], list[slice]]:
    """The cells of each press that take part, int64 (presses, m), and the indices of each tile's cells among them.

    Where only some do, each press has its own draw, because the bank needs patches of every place.
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


def _associate_tiles(rows: F32, tiles: list[slice], p: InreachParameters, progress: Progress) -> Channels:
    """Channels tile by tile: a patch is searched for in its own tile alone, as if each tile were a separate model."""
    of_tiles = []
    for number, tile in enumerate(tiles):
        channels = associate(rows[:, tile], p, _part_of(progress, number, len(tiles)))
        of_tiles.append(
            Channels(channels.key + tile.start * len(rows), channels.press, channels.patch + tile.start)
        )
    return Channels(*(np.concatenate(fields) for fields in zip(*of_tiles, strict=True)))


def _part_of(progress: Progress, number: int, count: int) -> Progress:
    return lambda done: progress((number + done) / count)
