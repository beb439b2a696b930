"""PatchCore of amazon-science: `patchcore_params.pkl` and the faiss index next to it.

Ref: amazon-science/patchcore-inspection @fcaa92f, src/patchcore/{patchcore,common}.py; read and compared, not copied.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge.core.errors import ConfigError
from export.importers.contract import Imported, Recognised, Settings
from export.importers.heads import Framing, MapSteps, patchcore_head
from plugins.detectors.common.descriptor import BINS, Descriptor
from plugins.reading.foreign import Foreign, check_array, describe, float32
from plugins.reading.isolated import read_foreign

__all__ = ["amazon_patchcore"]

INDEX = "nnscorer_search_index.faiss"
PARAMETERS = "patchcore_params.pkl"
SIGMA_PX = 4.0
# field -> the value that the graphs here compute.
EXPECTED = {
    "pretrain_embed_dimension": BINS, "target_embed_dimension": BINS, "patchsize": 3, "patchstride": 1,
    "anomaly_scorer_num_nn": 1,
}  # fmt: skip


class AmazonPatchcore:
    """The importer under `gelgate.importers`."""

    name = "amazon_patchcore"

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for other files."""
        table = file.table()
        if not {"backbone.name", "layers_to_extract_from"} <= set(table):
            return None
        layers = table["layers_to_extract_from"]
        fields = {
            "backbone": str(table["backbone.name"])[:60],
            "layers": ", ".join(map(str, layers)) if isinstance(layers, list) else describe(layers),
            "index": _index(file.path).name,
        }
        return Recognised("PatchCore of amazon-science/patchcore-inspection", fields, ("--backbone",))

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Errors: as `Importer`."""
        table = file.table()
        layers = _read_layers(file.path, table)
        trunk, grid = settings.cut_trunk(
            file.path, layers, f"its index and the name {table.get('backbone.name')} alone"
        )
        descriptor = Descriptor(layers, layers[0], "binned", False)
        with read_foreign(_index(file.path)) as index:
            rows = float32(check_array(index.path, "rows", index.table().get("rows"), None, BINS))
        steps = MapSteps(Framing(settings.frame), SIGMA_PX)
        head = patchcore_head(descriptor, grid, len(rows), 1, True, steps)
        return Imported(
            method="patchcore",
            source="PatchCore of amazon-science/patchcore-inspection",
            trunk=trunk,
            head=head,
            bank=settings.centred_bank(rows),
            grid=grid,
            parameters={"layers": list(layers), "sigma_px": SIGMA_PX},
            facts={"rows": len(rows), "backbone": str(table.get("backbone.name"))[:60]},
            says=(f"{len(rows)} rows; distances are squared, as published",),
        )


amazon_patchcore = AmazonPatchcore()


def _index(path: Path) -> Path:
    """The index next to the parameters, whose name may have a prefix."""
    return path.with_name(path.name.replace(PARAMETERS, INDEX) if path.name.endswith(PARAMETERS) else INDEX)


def _read_layers(path: Path, table: Mapping[Any, Any]) -> tuple[str, ...]:
    """Read the layers. Errors: ConfigError for a setting that is computed in another way here."""
    for name, expected in EXPECTED.items():
        value = table.get(name, expected)
        if type(value) is not int or value != expected:
            raise ConfigError(f"{path}: '{name}' is {describe(value)}, {expected} was expected")
    layers = table.get("layers_to_extract_from")
    if not isinstance(layers, list) or not layers or not all(isinstance(layer, str) for layer in layers):
        raise ConfigError(
            f"{path}: 'layers_to_extract_from' is {describe(layers)}, names of layers were expected"
        )
    if len(set(layers)) != len(layers):
        raise ConfigError(f"{path}: 'layers_to_extract_from' names a layer twice")
    return tuple(layers)
