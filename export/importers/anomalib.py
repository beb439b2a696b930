"""anomalib 2.x: checkpoints (`.ckpt`) and exported modules (`.pt`) of PaDiM, PatchCore, DFM and DFKDE.

Ref: open-edge-platform/anomalib v2.7.0, `models/image/*/torch_model.py` and `anomaly_map.py`, `post_processing`,
`pre_processing`; read and compared, not copied.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.features import trunk_grid
from calibration.fitting.trunks import Trunk
from edge.core.detector import Bank, Grid
from edge.core.errors import ConfigError
from edge.model.session import open_session
from export.importers.anomalib_file import AnomalibFile, read_anomalib
from export.importers.contract import Imported, Recognised, Settings, require
from export.importers.heads import Framing, MapSteps, dfkde_head, dfm_head, patchcore_head
from export.importers.padim_parts import Gaussians, padim_parts
from plugins.backbones.input_steps import InputSteps
from plugins.backbones.resnet import build_trunk
from plugins.backbones.topology import TOPOLOGIES, check_state
from plugins.detectors.common.descriptor import Descriptor
from plugins.reading.foreign import Foreign, float32

__all__ = ["anomalib"]

# anomalib's maps: a Gaussian of four pixels, with torch's `reflect` border.
SIGMA_PX = 4.0
MOST_NEIGHBOURS = 1000
NAMES = {"padim": "PaDiM", "patchcore": "PatchCore", "dfm": "DFM", "dfkde": "DFKDE"}


class Anomalib:
    """The importer under `gelgate.importers`."""

    name = "anomalib"

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for other files."""
        model = read_anomalib(file)
        if model is None:
            return None
        fields = {
            "backbone": str(model.options.get("backbone", "not stated")),
            "layers": model.layer_words,
            "trained with": model.version,
        }
        return Recognised(f"{NAMES[model.method]} of anomalib ({file.form})", fields, region="full")

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Errors: as `Importer`."""
        stored = require(read_anomalib(file), file, "PaDiM, PatchCore, DFM or DFKDE of anomalib")
        return _METHODS[stored.method](_Model(stored, settings))


anomalib = Anomalib()


@dataclass(frozen=True)
class _Model:
    """A recognised file with its trunk, grid and map steps."""

    found: AnomalibFile
    settings: Settings

    @cached_property
    def framing(self) -> Framing:
        return self.found.framing(self.settings.frame)

    @cached_property
    def trunk(self) -> Trunk:
        path, name, layers = self.path, self.backbone, self.found.layers
        if name not in TOPOLOGIES:
            raise ConfigError(
                f"{path}: 'backbone' is {name or 'missing'}, one of {', '.join(TOPOLOGIES)} was expected"
            )
        state, framing = self.found.backbone_state, self.framing
        check_state(state, TOPOLOGIES[name], f"{path}: the backbone's weights", layers)
        mean, std = self.found.normalisation
        steps = InputSteps(mean, std, framing.resize, framing.crop, is_antialiased=framing.is_antialiased)
        facts = {"weights": path.name}
        graph = build_trunk(state, name, layers, steps=steps, frame=framing.frame, facts=facts)
        return Trunk(f"{name}_{path.stem}", graph, facts)

    @cached_property
    def grid(self) -> Grid:
        session = open_session(self.trunk.graph, 2, f"the trunk of {self.path}")
        return trunk_grid(session, self.found.layers, self.settings.frame, self.settings.pixels_per_mm)

    @property
    def path(self) -> Path:
        return self.found.path

    @property
    def backbone(self) -> str:
        """timm names a training recipe after a point."""
        return str(self.found.options.get("backbone", "")).partition(".")[0]

    def steps(self, sigma_px: float = SIGMA_PX, **kinds: Any) -> MapSteps:
        return MapSteps(self.framing, sigma_px, border="reflect", **kinds)

    def array(self, name: str, *shape: int | None) -> NDArray[Any]:
        return self.found.array(name, *shape)

    def finish(self, head: bytes, bank: Bank, facts: Mapping[str, Any], **rest: Any) -> Imported:
        """The parts with what all methods state."""
        threshold, words = self.found.threshold()
        says = (words, *self._warn_of_crop(), *rest.pop("says", ()))
        return Imported(
            method=self.found.method,
            source=f"{NAMES[self.found.method]} of anomalib, {self.found.version}",
            trunk=self.trunk,
            head=head,
            bank=bank,
            grid=self.grid,
            parameters={
                "layers": list(self.found.layers),
                "sigma_px": SIGMA_PX,
                **self.found.plain_options(),
            },
            threshold=rest.pop("threshold", threshold),
            facts={"preprocessing": self.found.preprocessing_words(), **facts},
            says=says,
            **rest,
        )

    def _warn_of_crop(self) -> tuple[str, ...]:
        if self.framing.seen >= 0.999:
            return ()
        return (
            f"the model crops its pictures: it sees the middle {self.framing.seen:.0%} of the region, damage "
            f"beyond is not found; give a larger --region",
        )


def _padim(model: _Model) -> Imported:
    inverse = model.array("model.gaussian.inv_covariance", None, None, None)
    cells, d = inverse.shape[:2]
    given = Gaussians(
        path=model.path,
        name="model.gaussian.inv_covariance",
        layers=model.found.layers,
        channels=model.array("model.idx", d).astype(np.int64),
        mean=model.array("model.gaussian.mean", d, cells).T,
        dense=lambda part: inverse[part],
        is_inverse=True,
    )
    parts = padim_parts(given, model.grid, model.steps(), model.settings)
    facts = {**parts.facts, "channels": int(d)}
    return model.finish(parts.head, parts.bank, facts, says=(parts.reduction.words(),), exact=parts.exact)


def _patchcore(model: _Model) -> Imported:
    descriptor = Descriptor(model.found.layers, model.found.layers[0], "means", False)
    rows = float32(model.array("model.memory_bank", None, descriptor.width(model.grid)))
    neighbours = model.found.option_count("num_neighbors", 9, MOST_NEIGHBOURS)
    head = patchcore_head(
        descriptor, model.grid, len(rows), neighbours, False, model.steps(upsampling="nearest")
    )
    facts = {"rows": len(rows), "neighbours": neighbours}
    return model.finish(head, model.settings.centred_bank(rows), facts)


def _dfm(model: _Model) -> Imported:
    (tap,) = model.found.layers
    c, h, w = model.grid.taps[tap]
    pool = model.found.option_count("pooling_kernel_size", 4, min(h, w))
    kind = str(model.found.options.get("score_type", "fre"))
    if kind not in ("fre", "nll"):
        raise ConfigError(f"{model.path}: 'score_type' is {kind}, fre or nll was expected")
    width = c * (h // pool) * (w // pool)
    vectors = model.array("model.pca_model.singular_vectors", width, None)
    arrays = {"mean": model.array("model.pca_model.mean", width), "vectors": vectors.T}
    if kind == "nll":
        sigma = model.array("model.gaussian_model.sigma_mat", None)
        u = model.array("model.gaussian_model.u_mat", vectors.shape[1], len(sigma))
        if not (sigma > 0).all():
            raise ConfigError(
                f"{model.path}: 'model.gaussian_model.sigma_mat' goes down to {sigma.min():.3g}, positive values were "
                "expected; train with fewer components (pca_level)"
            )
        arrays["centre"] = model.array("model.gaussian_model.mean_vec", vectors.shape[1])
        arrays["whitening"] = u / sigma
        arrays["offset"] = np.array([2 * np.log(sigma.astype(np.float64)).sum()])
    head = dfm_head(tap, model.grid, pool, vectors.shape[1], kind, model.steps(0.0))  # type: ignore[arg-type]  # fre or nll
    facts = {"components": vectors.shape[1], "score_type": kind}
    left = (
        f"the model pools {h}x{w} features by {pool}: the last {h % pool} rows and {w % pool} columns are not seen, "
        "and damage at the lower and right border is hardly found",
    )
    says = left if h % pool or w % pool else ()
    return model.finish(head, _bank(arrays, "vectors", model), facts, says=says)


def _dfkde(model: _Model) -> Imported:
    stored = model.found
    (tap,) = stored.layers
    dataset = model.array("model.classifier.kde_model.dataset", None, None)
    vectors = model.array(
        "model.classifier.pca_model.singular_vectors", model.grid.taps[tap][0], dataset.shape[1]
    )
    is_unit = stored.option_value("feature_scaling_method", "scale") == "norm"
    bandwidth = model.array(
        "model.classifier.kde_model.bw_transform", dataset.shape[1], dataset.shape[1]
    ).astype(np.float64)
    if not is_unit:
        bandwidth = bandwidth / float(model.array("model.classifier.max_length").reshape(-1)[0])
    norm = float(model.array("model.classifier.kde_model.norm").reshape(-1)[0])
    arrays = {
        "mean": model.array("model.classifier.pca_model.mean", model.grid.taps[tap][0]),
        "vectors": vectors.T,
        "bandwidth": bandwidth,
        "dataset": dataset,
        "log_norm": np.array([np.log(max(norm, 1e-300)) - np.log(len(dataset))]),
    }
    head = dfkde_head(stored.layers, model.grid, (dataset.shape[1], len(dataset)), is_unit, model.framing)
    threshold, words = stored.probability_threshold()
    says = (f"the score is the logit of anomalib's probability; the map is the score everywhere ({words})",)
    return model.finish(
        head, _bank(arrays, "vectors", model), {"rows": len(dataset)}, threshold=threshold, says=says
    )


def _bank(arrays: Mapping[str, NDArray[Any]], packed: str, model: _Model) -> Bank:
    return model.settings.bank({name: float32(array) for name, array in arrays.items()}, packed)


_METHODS: Mapping[str, Callable[[_Model], Imported]] = {
    "padim": _padim, "patchcore": _patchcore, "dfm": _dfm, "dfkde": _dfkde
}  # fmt: skip
