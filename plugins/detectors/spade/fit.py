"""SPADE: the press is compared with its most similar nominal presses, place by place and at several scales.

Definition (Cohen and Hoshen, "Sub-image anomaly detection with deep pyramid correspondences", 2020). The K nominal
presses with the nearest global descriptors are the gallery. A cell's score at one layer is its distance to the nearest
gallery cell of that layer. Layers are averaged in pixels and blurred once. Read against byungjae89/SPADE-pytorch
@077c67b and the seed paper's scripts.

`paper` is this definition as the seed paper's scripts run it: every gallery position allowed, descriptors of unit
length. `corrected` uses the finest layer without averaging, searches only near the same place and scores a press by its
map. It keeps leading principal directions and as many presses as the bank's size allows, without untouched cells.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, Mask
from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from plugins.detectors.common.coreset import k_centre
from plugins.detectors.common.distances import nearest
from plugins.detectors.common.parameters import Rng, choose, list_repairs
from plugins.detectors.common.tile_layout import join
from plugins.detectors.common.untouched_places import gel_weight
from plugins.detectors.common.validation import bank_bytes, require_fittable, require_scorable
from plugins.detectors.spade.head import spade_head
from plugins.detectors.spade.layer import Layer
from plugins.detectors.spade.paper import PAPER, REPAIRS
from plugins.detectors.spade.parameters import SpadeParameters

__all__ = ["SpadeParameters", "spade"]


class Spade:
    """SPADE under the entry points `gelgate.detectors`."""

    name = "spade"
    compares_places = True
    is_baseline = False

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> SpadeParameters:
        return choose(self.name, PAPER if mode == "paper" else SpadeParameters(), PAPER, overrides)

    def taps(self, parameters: SpadeParameters) -> tuple[str, ...]:
        """The layers, and `avgpool` where it is requested by name."""
        return (*parameters.layers, "avgpool") if parameters.descriptor == "avgpool" else parameters.layers

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: SpadeParameters, rng: Rng, progress: Progress
    ) -> Bank:
        """Store the presses. Arrays per layer: `<tap>_bank` (presses, cells, width), `<tap>_mean`, `<tap>_basis`,
        `<tap>_weight`, `<tap>_floor`; for the complete press: `press_descriptors` (presses, d), `press_mean`. Where no
        press touches some cells: int64 `<tap>_cells` and `<tap>_gel_cells`, those with rows and the others,
        `<tap>_gel` (cells, width), `<tap>_gel_weight` (1,), and the search's tables `<tap>_queries`, `<tap>_reached`
        and `<tap>_order` (h * w,). Errors: FitError.
        """
        p = parameters
        taps = tuple(dict.fromkeys((*p.layers, *p.descriptor_taps(grid))))
        require_fittable(self.name, nominal, grid, taps)
        described = _describe(nominal.features, grid, p)
        start = int(rng.integers(len(described)))
        layers = [Layer(p, grid, tap) for tap in p.layers]
        stored = [layer.find_stored(nominal) for layer in layers]
        kept = _affordable(described, nominal.room, layers, stored, p, start)
        press_mean = described[kept].mean(axis=0).astype(np.float32)
        arrays: dict[str, NDArray[Any]] = {
            "press_descriptors": (described[kept] - press_mean).astype(np.float32),
            "press_mean": press_mean,
        }
        facts = _facts(kept, len(described), start, p)
        packing: dict[str, Packing] = {}
        for number, (layer, cells) in enumerate(zip(layers, stored, strict=True)):
            tap, maps = layer.tap, layer.average(nominal.features[layer.tap][kept])
            own = layer.fit(maps, cells, p.dims[number] if p.dims else None, rng)
            packing[f"{tap}_bank"] = p.packing
            usual = layer.nominal_distance(own, arrays["press_descriptors"])
            if "gel_cells" in own:
                own["gel"], scatter = layer.learn_gel(own, maps, nominal)
                own["gel_weight"] = np.array([gel_weight(scatter, usual)], np.float32)
                # At least float16: their errors do not average out.
                packing[f"{tap}_gel"] = "none" if p.packing == "none" else "float16"
            own["weight"] = np.array([1 / len(p.layers)], np.float32)
            if p.is_balanced:
                scale = usual if usual > 0 else 1.0
                own["weight"] /= np.float32(scale)
                facts[f"{tap}_nominal_distance"] = scale
            facts[f"{tap}_gel_cells"] = len(own.get("gel_cells", ()))
            arrays |= {f"{tap}_{name}": array for name, array in own.items()}
            progress((number + 1) / len(p.layers))
        return Bank(arrays, packing, facts)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: SpadeParameters
    ) -> ScoreMaps:
        p = parameters
        require_scorable(self.name, features, (*p.layers, *p.descriptor_taps(grid)))
        described = _describe(features, grid, p) - bank.arrays["press_mean"]
        count = min(max(p.image_neighbours, p.pixel_neighbours), len(bank.arrays["press_descriptors"]))
        near = nearest(described, bank.arrays["press_descriptors"], count)
        score_map = np.zeros((len(described), *grid.frame))
        for layer in (Layer(p, grid, tap) for tap in p.layers):
            own = layer.of(bank.arrays)
            raw = layer.distances(features[layer.tap], near.indices[:, : p.pixel_neighbours], own)
            score_map += layer.smoothing(join(raw, grid) * own["weight"].astype(np.float64))
        if p.image_score == "map":
            return ScoreMaps(score_map, score_map.max(axis=(1, 2)))
        distances = near.distances[:, : p.image_neighbours]
        return ScoreMaps(score_map, (distances**2 if p.is_squared else distances).mean(axis=1))

    def head(self, grid: Grid, bank: Bank, parameters: SpadeParameters) -> bytes:
        """The graph; the number of presses in the bank is free."""
        return spade_head(self.name, grid, bank, parameters)


def _facts(kept: NDArray[np.intp], presses: int, start: int, p: SpadeParameters) -> dict[str, Any]:
    """The facts of the complete bank, to which those of its layers are added."""
    left_out = f"{len(kept)} of {presses} presses fit into bank_mb; the others are left out (k-centre)"
    return {
        "presses": kept.tolist(),
        "start": start,
        "repairs": list_repairs(p, PAPER, REPAIRS),
        "warnings": [left_out] if len(kept) < presses else [],
    }


def _describe(features: Features, grid: Grid, p: SpadeParameters) -> F64:
    """Global descriptors (n, d), float64."""
    parts = []
    for tap in p.descriptor_taps(grid):
        down, across = p.regions_of(grid, tap)
        # Press by press: all of them in float64 would be twice the features.
        parts.append(np.stack([(down @ x.astype(np.float64) @ across.T).ravel() for x in features[tap]]))
    return np.concatenate(parts, axis=1)


def _affordable(
    described: F64,
    room: float,
    layers: Sequence[Layer],
    stored: Sequence[Mask],
    p: SpadeParameters,
    start: int,
) -> NDArray[np.int64]:
    """The presses that fit into the bank's size, times `room`, rising; the most different ones where not all do."""
    if p.bank_mb is None:
        return np.arange(len(described))
    per_number, per_row = {"none": (4, 0), "float16": (2, 0), "int8": (1, 4)}[p.packing]
    press, fixed = 4 * described.shape[1], 4 * described.shape[1]
    for number, (layer, cells) in enumerate(zip(layers, stored, strict=True)):
        channels, rows = layer.grid.taps[layer.tap][0], int(cells.sum())
        width = min(p.dims[number] + 1, channels) if p.dims else channels
        # In addition to the rows: mean, basis, floor, weights.
        fixed += 4 * (channels * width + channels + 3)
        press += rows * (width * per_number + per_row)
        if not cells.all():
            # At most four bytes per number for the free gel, and the tables.
            tables = sum(table.nbytes for table in layer.tables(cells).values())
            fixed += 4 * width * (len(cells) - rows) + tables
    count = max(1, round(room * ((bank_bytes(p.bank_mb, layers[0].grid) - fixed) // press)))
    if count >= len(described):
        return np.arange(len(described))
    return np.sort(k_centre(described, count, start).rows)


spade = Spade()
