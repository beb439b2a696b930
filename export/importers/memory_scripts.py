"""SPADE, FAPM and InReaCh of public scripts: pickles of features, prototypes and nominal points.

Ref: byungjae89/SPADE-pytorch @077c67b (a table of features per layer and `avgpool`), eastbrother87/FAPM_official
@5d2d2f2 (near and far prototypes per cell with a selector; the seed paper's scripts store them per place), and an
account of DeclanMcIntosh/InReaCh @a0d54ba, which has no licence and was not copied (nominal points, 1024 wide, or 1026
with places).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from edge.core.detector import Grid, Nominal
from edge.core.errors import ConfigError, FitError
from export.importers.contract import Imported, Recognised, Settings, require
from plugins.detectors.common.descriptor import BINS
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.spade import spade
from plugins.reading.foreign import Foreign, check_array, float32

__all__ = ["fapm_pickle", "inreach_points", "spade_features"]

FAPM_KEYS = (
    "final_near_core_f", "final_far_core_f", "fn_selector_f", "final_near_core_c", "final_far_core_c", "fn_selector_c",
)  # fmt: skip
CELLS = 7
# Of a descriptor of unit length, how far lengths may be from 1.
UNIT = 1e-2
POINTS = ("nominal_points", "points", "rows", "patches")
PLACE_WEIGHT = 5.0


class SpadeFeatures:
    """The importer of SPADE's feature lists under `gelgate.importers`."""

    name = "spade_features"

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for other files."""
        layers = _layers(file.table())
        if not layers:
            return None
        fields = {name: str(np.shape(file.table()[name])) for name in layers}
        return Recognised(
            f"features of SPADE ({file.form})", fields, ("--backbone", "--set is_normalised=true or false")
        )

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Settings: `is_normalised`, `neighbours`. Errors: as `Importer`."""
        layers = require(_layers(file.table()) or None, file, "features by layer")
        taps = (*layers, "avgpool") if "avgpool" in file.table() else layers
        trunk, grid = settings.cut_trunk(file.path, taps, "features of presses alone")
        features = {tap: _features(file.path, tap, file.table()[tap], grid) for tap in taps}
        counts = {tap: len(maps) for tap, maps in features.items()}
        if len(set(counts.values())) != 1:
            raise ConfigError(
                f"{file.path}: the layers have different numbers of presses: {counts}; one number was expected"
            )
        is_normalised = _is_unit_length(file.path, settings, features[layers[0]])
        k = settings.value("neighbours", int, 5)
        parameters = spade.parameters(
            "paper",
            layers=layers,
            descriptor="avgpool" if "avgpool" in taps else "means",
            is_normalised=is_normalised,
            image_neighbours=k,
            pixel_neighbours=k,
            packing=settings.packing,
        )
        rng = np.random.default_rng(0)
        try:
            bank = spade.fit(Nominal(features), grid, parameters, rng, lambda fraction: None)
        except FitError as error:
            raise ConfigError(f"{file.path}: {error}") from error
        how = "divided by their length" if is_normalised else "as they are"
        sentence = f"{counts[taps[0]]} presses, features {how}"
        head = spade.head(grid, bank, parameters)
        values = vars(parameters)
        return Imported("spade", "features of SPADE", trunk, head, bank, grid, values, says=(sentence,))


class FapmPickle:
    """The importer of FAPM's prototypes under `gelgate.importers`."""

    name = "fapm_pickle"

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for other files."""
        if not all(key in file.table() for key in FAPM_KEYS):
            return None
        fields = {key: str(np.shape(file.table()[key])) for key in FAPM_KEYS}
        return Recognised(f"prototypes of FAPM ({file.form})", fields, ("--backbone",))

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Settings: `layers`, `neighbours`. Errors: as `Importer`."""
        fine, coarse = settings.value("layers", tuple, ("layer2", "layer3"))
        trunk, grid = settings.cut_trunk(file.path, (fine, coarse), "prototypes alone")
        arrays: dict[str, NDArray[Any]] = {}
        kinds = set()
        for tap, end, side in ((fine, "f", 4), (coarse, "c", 2)):
            kinds.add(_prototypes(file, tap, end, side, grid, arrays))
        if len(kinds) != 1:
            raise ConfigError(
                f"{file.path}: one layer has prototypes per place, the other per cell; one kind was expected"
            )
        parameters = fapm.parameters(
            "paper", layers=(fine, coarse), banks=kinds.pop(), neighbours=settings.value("neighbours", int, 4)
        )
        names = [name for name in arrays if name.endswith(("_near", "_far"))]
        bank = settings.bank(arrays, *names)
        sentence = "coarse distances are added in the release's order of rows (fusion=rows)"
        head, values = fapm.head(grid, bank, parameters), vars(parameters)
        return Imported("fapm", "prototypes of FAPM", trunk, head, bank, grid, values, says=(sentence,))


class InreachPoints:
    """The importer of InReaCh's nominal points under `gelgate.importers`."""

    name = "inreach_points"

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for other files."""
        points = _points(file)
        if points is None:
            return None
        return Recognised(
            f"nominal points of InReaCh ({file.form})", {"points": str(points.shape)}, ("--backbone",)
        )

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Settings: `position_weight`. Errors: as `Importer`."""
        points = require(_points(file), file, f"points of {BINS} or {BINS + 2} numbers")
        points = float32(check_array(file.path, "nominal points", points, None, points.shape[1]))
        weight = settings.value("position_weight", float, PLACE_WEIGHT if points.shape[1] > BINS else 0.0)
        if (weight > 0) != (points.shape[1] > BINS):
            raise ConfigError(
                f"{file.path}: points of {points.shape[1]} numbers and position_weight={weight} do not fit together"
            )
        parameters = inreach.parameters("paper", position_weight=weight, packing=settings.packing)
        trunk, grid = settings.cut_trunk(file.path, parameters.taps, "nominal points alone")
        bank = settings.centred_bank(points, BINS)
        head = inreach.head(grid, bank, parameters)
        source, values, sentence = "nominal points of InReaCh", vars(parameters), f"{len(points)} points"
        return Imported("inreach", source, trunk, head, bank, grid, values, says=(sentence,))


spade_features, fapm_pickle, inreach_points = SpadeFeatures(), FapmPickle(), InreachPoints()


def _layers(table: Mapping[Any, Any]) -> tuple[str, ...]:
    """The names of feature maps, in order; empty where the table holds no features."""
    names = [name for name in table if isinstance(name, str) and name.startswith("layer")]
    maps = [name for name in names if isinstance(table[name], np.ndarray | list)]
    return tuple(maps) if maps and len(maps) == len(names) and set(table) <= {*maps, "avgpool"} else ()


def _features(path: Path, tap: str, value: Any, grid: Grid) -> F32:
    """A layer's features (n, c, h, w), from one array or a list of arrays. Errors: ConfigError."""
    c, h, w = grid.taps[tap]
    if isinstance(value, list):
        if not value or not all(isinstance(part, np.ndarray) for part in value):
            raise ConfigError(
                f"{path}: '{tap}' is a list without arrays, one array of features per press was expected"
            )
        parts = [part[None] if part.ndim == 3 else part for part in value]
        if len({part.shape[1:] for part in parts}) != 1:
            raise ConfigError(f"{path}: '{tap}' has presses of different shapes; one shape was expected")
        value = np.concatenate(parts)
    if tap == "avgpool" and value.ndim == 2:
        value = value[:, :, None, None]
    return float32(check_array(path, tap, value, None, c, h, w))


def _is_unit_length(path: Path, settings: Settings, features: F32) -> bool:
    """Tell whether descriptors are divided by their length. Errors: ConfigError where nothing says so."""
    lengths = np.sqrt(np.einsum("nchw,nchw->nhw", features, features))
    if "is_normalised" in settings.values:
        return bool(settings.value("is_normalised", bool, False))
    if float(np.abs(lengths - 1).max()) < UNIT:
        return True
    raise ConfigError(
        f"{path}: the features are not of unit length (up to {lengths.max():.3g}), and the file does not say whether "
        "the scores divide by the length; state it: --set is_normalised=false for SPADE-pytorch, true for the seed "
        "paper's scripts"
    )


def _prototypes(
    file: Foreign, tap: str, end: str, side: int, grid: Grid, arrays: dict[str, NDArray[Any]]
) -> str:
    """Add the arrays of one layer; `cell` or `location`. Errors: ConfigError."""
    c, h, w = grid.taps[tap]
    if (h, w) != (CELLS * side, CELLS * side):
        raise ConfigError(
            f"{file.path}: '{tap}' is {h} x {w}, FAPM's cells need {CELLS * side} x {CELLS * side}; use a "
            f"region of 224x224"
        )
    selector = file.array(f"fn_selector_{end}").reshape(-1) != 0
    if len(selector) != CELLS * CELLS:
        raise ConfigError(
            f"{file.path}: 'fn_selector_{end}' has {len(selector)} entries, {CELLS * CELLS} were expected"
        )
    kind, places = "", []
    for name, members in (("near", ~selector), ("far", selector)):
        field = f"final_{name}_core_{end}"
        core = file.array(field)
        if (
            core.ndim not in (3, 4)
            or core.shape[0] != CELLS * CELLS
            or core.shape[-1] != c
            or (core.ndim == 4 and core.shape[1] != side * side)
        ):
            raise ConfigError(
                f"{file.path}: '{field}' is {core.shape}, ({CELLS * CELLS}, any, {c}) or "
                f"({CELLS * CELLS}, {side * side}, any, {c}) was expected"
            )
        kind = "cell" if core.ndim == 3 else "location"
        if not members.any():
            continue
        rows = float32(core[members]).reshape(-1, *core.shape[-2:])
        mean = rows.mean(axis=1, dtype=np.float64).astype(np.float32)
        where = _places(side, w)[members].reshape(len(rows), -1)
        arrays[f"{tap}_{name}"], arrays[f"{tap}_{name}_mean"] = rows - mean[:, None], mean
        arrays[f"{tap}_{name}_places"] = where
        places.append(where.ravel())
    arrays[f"{tap}_order"] = np.unique(np.concatenate(places), return_index=True)[1].astype(np.int64)
    return kind


def _places(side: int, width: int) -> NDArray[np.int64]:
    """The places of every cell, both row by row: (cells, side * side)."""
    cell, inside = np.arange(CELLS), np.arange(side)
    rows = cell[:, None, None, None] * side + inside[None, None, :, None]
    columns = cell[None, :, None, None] * side + inside[None, None, None, :]
    places: NDArray[np.int64] = (rows * width + columns).reshape(CELLS * CELLS, side * side).astype(np.int64)
    return places


def _points(file: Foreign) -> NDArray[Any] | None:
    content = file.content
    points = (
        content
        if isinstance(content, np.ndarray)
        else next((file.table()[n] for n in POINTS if n in file.table()), None)
    )
    if (
        isinstance(points, list)
        and points
        and all(isinstance(point, np.ndarray) and point.ndim == 1 for point in points)
    ):
        points = np.stack(points) if len({point.shape for point in points}) == 1 else None
    is_bank = isinstance(points, np.ndarray) and points.ndim == 2 and points.shape[1] in (BINS, BINS + 2)
    return np.asarray(points) if is_bank else None
