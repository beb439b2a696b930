"""What an anomalib file holds, the same for a checkpoint and for an exported module: weights, options, preprocessing,
threshold."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from export.importers.heads import Framing
from plugins.reading.foreign import Content, Foreign, Record, attributes, check_array, describe

__all__ = ["AnomalibFile", "read_anomalib"]

BACKBONE = "model.feature_extractor.feature_extractor."
# method -> an entry of its state that no other method has.
MARKS = {
    "padim": "model.gaussian.inv_covariance",
    "patchcore": "model.memory_bank",
    "dfm": "model.pca_model.singular_vectors",
    "dfkde": "model.classifier.kde_model.dataset",
}
MOST_MODULES = 5000
# The steps before the model, by their place in the order.
STEPS = {"Resize": 1, "CenterCrop": 2, "ExportableCenterCrop": 2, "Normalize": 3}

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class AnomalibFile:
    """state: arrays by name. options: the model's arguments. transform: the steps before the model, in order."""

    path: Path
    method: str
    version: str
    state: Mapping[Any, Content]
    options: Mapping[Any, Content]
    transform: Sequence[tuple[str, Mapping[Any, Content]]] | None
    sensitivity: float

    def array(self, name: str, *shape: int | None) -> NDArray[Any]:
        """An array of the state. Errors: as `Foreign.array`."""
        return check_array(self.path, name, self.state.get(name), *shape)

    @property
    def layers(self) -> tuple[str, ...]:
        """The layers that the model compares. Errors: ConfigError."""
        names = self._stored_layers
        if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"{self.path}: 'layers' is {describe(names)}, names of layers were expected")
        if len(set(names)) != len(names):
            raise ConfigError(f"{self.path}: 'layers' names a layer twice: {', '.join(names)}")
        if self.method == "dfkde" and len(names) != 1:
            raise ConfigError(f"{self.path}: DFKDE of {len(names)} layers; one was expected")
        return tuple(names)

    @property
    def layer_words(self) -> str:
        """The layers for people, whatever the file holds there."""
        names = self._stored_layers
        return ", ".join(map(str, names)) if isinstance(names, list) else describe(names)

    @property
    def _stored_layers(self) -> Content:
        """The layers as the file has them, or anomalib's defaults."""
        if self.method == "dfm":
            return [self.options.get("layer", "layer3")]
        usual = {"padim": ["layer1", "layer2", "layer3"], "patchcore": ["layer2", "layer3"]}
        return self.options.get("layers", usual.get(self.method, ["layer4"]))

    @property
    def backbone_state(self) -> dict[str, NDArray[Any]]:
        """Weights of the backbone in torchvision's naming, which timm's ResNets share."""
        return {
            name.removeprefix(BACKBONE): value
            for name, value in self.state.items()
            if isinstance(name, str) and name.startswith(BACKBONE) and isinstance(value, np.ndarray)
        }

    def option_value(self, name: str, usual: str) -> str:
        """An option that may be a member of an enumeration."""
        value = self.options.get(name, usual)
        return str(value.args[0]) if isinstance(value, Record) and value.args else str(value)

    def option_count(self, name: str, usual: int, most: int) -> int:
        """An option that counts something. Errors: ConfigError for anything but a number of 1 to `most`."""
        value = self.options.get(name, usual)
        if type(value) is not int or not 1 <= value <= most:
            raise ConfigError(
                f"{self.path}: '{name}' is {describe(value)}, a number of 1 to {most} was expected"
            )
        return value

    def plain_options(self) -> dict[str, Any]:
        """The options as JSON can hold them."""
        kinds = str | int | float | bool
        return {
            str(name): value
            for name, value in self.options.items()
            if isinstance(value, kinds)
            or (isinstance(value, list) and all(isinstance(item, kinds) for item in value))
        }

    @property
    def normalisation(self) -> tuple[Colour, Colour]:
        """mean and std of RGB in 0..1. Errors: ConfigError."""
        for kind, fields in self._steps():
            if kind == "Normalize":
                return self._three(fields, "mean"), self._three(fields, "std")
        return (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

    def framing(self, frame: tuple[int, int]) -> Framing:
        """The steps from frames of (h, w) to the model's input. Errors: ConfigError."""
        resize: tuple[int, int] | None = None
        crop: tuple[int, int] | None = None
        is_antialiased = True
        for kind, fields in self._steps():
            if kind == "Resize":
                self._require_bilinear(fields)
                resize = self._size(fields, frame)
                is_antialiased = fields.get("antialias") is not False
            elif kind != "Normalize":
                crop = self._size(fields, None)
        return Framing(frame, resize, crop, is_antialiased)

    def preprocessing_words(self) -> str:
        """The steps in words."""
        words = [f"{kind}{fields.get('size', '')}" for kind, fields in self._steps()]
        return ", ".join(words) or "none"

    def _steps(self) -> Sequence[tuple[str, Mapping[Any, Content]]]:
        """The steps in the one order that the trunk computes. Errors: ConfigError for others."""
        if self.transform is None:
            raise ConfigError(
                f"{self.path}: the pre-processor is not stored, so the size and colours that the model saw are "
                f"not known; train with a pre-processor of Resize, CenterCrop and Normalize"
            )
        kinds = [kind for kind, _ in self.transform]
        places = [STEPS.get(kind, 0) for kind in kinds]
        if any(later <= earlier for earlier, later in zip([0, *places], places, strict=False)):
            raise ConfigError(
                f"{self.path}: the pre-processor's steps are {', '.join(kinds)}; Resize, CenterCrop and Normalize "
                "were expected, each at most once and in this order"
            )
        return self.transform

    def _size(self, found: Mapping[Any, Content], frame: tuple[int, int] | None) -> tuple[int, int]:
        size = found.get("size")
        size = [size] if isinstance(size, int) else size
        if (
            not isinstance(size, list)
            or len(size) not in (1, 2)
            or not all(type(n) is int and 0 < n <= 4096 for n in size)
        ):
            raise ConfigError(
                f"{self.path}: 'size' of the pre-processor is {describe(size)}, height and width were expected"
            )
        if len(size) == 2:
            return size[0], size[1]
        if frame is None:
            return size[0], size[0]
        short, long = min(frame), max(frame)
        other = int(size[0] * long / short)
        return (size[0], other) if frame[0] <= frame[1] else (other, size[0])

    def _require_bilinear(self, found: Mapping[Any, Content]) -> None:
        kind = found.get("interpolation", "bilinear")
        kind = kind.args[0] if isinstance(kind, Record) and kind.args else kind
        if not isinstance(kind, str) or kind != "bilinear" or found.get("max_size") is not None:
            words = kind if isinstance(kind, str) else describe(kind)
            raise ConfigError(f"{self.path}: the pre-processor resizes by '{words}', bilinear was expected")

    def _three(self, fields: Mapping[Any, Content], name: str) -> Colour:
        values = check_array(self.path, f"pre-processor {name}", fields.get(name), 3).astype(np.float64)
        if name == "std" and not (values > 0).all():
            raise ConfigError(
                f"{self.path}: 'std' of the pre-processor is {values.tolist()}, positive numbers were expected"
            )
        red, green, blue = values.tolist()
        return red, green, blue

    def _number(self, name: str) -> float:
        value = self.state.get(f"post_processor.{name}")
        return float(value.reshape(-1)[0]) if isinstance(value, np.ndarray) and value.size == 1 else math.nan

    def raw_threshold(self) -> float:
        """The raw score above which anomalib says anomalous, nan where the file has none.

        anomalib says so where (score - threshold) / (max - min) + 1/2 exceeds 1 - sensitivity.
        """
        threshold = self._number("_image_threshold")
        threshold = self._number("_pixel_threshold") if math.isnan(threshold) else threshold
        low, high = self._number("image_min"), self._number("image_max")
        if math.isnan(threshold) or self.sensitivity == 0.5:
            return threshold
        return threshold + (0.5 - self.sensitivity) * (high - low)

    def threshold(self) -> tuple[float | None, str]:
        """The raw threshold, and its sentence."""
        raw = self.raw_threshold()
        if math.isnan(raw):
            return None, "the file has no threshold"
        low, high = self._number("image_min"), self._number("image_max")
        return raw, (
            f"anomalib's threshold is {raw:.5g} on the raw scale (sensitivity {self.sensitivity:g}); it "
            f"normalised scores from {low:.5g} to {high:.5g}, which is left out: scores here are raw"
        )

    def probability_threshold(self) -> tuple[float | None, str]:
        """Give the threshold of a model whose raw score is a probability, as its logit."""
        raw = self.raw_threshold()
        if math.isnan(raw):
            return None, "without a threshold"
        inside = min(max(raw, 1e-9), 1 - 1e-9)
        return math.log(
            inside / (1 - inside)
        ), f"a threshold of {raw:.5g} is {math.log(inside / (1 - inside)):.5g}"


def read_anomalib(file: Foreign) -> AnomalibFile | None:
    """Read the file of one of the four methods, None for any other."""
    if "state_dict" in file.table():
        return _checkpoint(file)
    module = file.table().get("model")
    return (
        _module(file, module) if isinstance(module, Record) and module.kind.startswith("anomalib.") else None
    )


def _method(state: Mapping[Any, Content]) -> str | None:
    return next((method for method, mark in MARKS.items() if mark in state), None)


def _checkpoint(file: Foreign) -> AnomalibFile | None:
    table = file.table()
    state, options = table["state_dict"], table.get("hyper_parameters")
    method = _method(state) if isinstance(state, dict) else None
    if method is None:
        return None
    options = options if isinstance(options, dict) else {}
    config = table.get("anomalib_pre_processor_config")
    spec = (
        config.get("transform")
        if isinstance(config, dict)
        else attributes(options.get("pre_processor")).get("transform")
    )
    post = table.get("anomalib_post_processor_config")
    sensitivity = post.get("image_sensitivity", 0.5) if isinstance(post, dict) else 0.5
    version = f"checkpoint of Lightning {table.get('pytorch-lightning_version', 'of no stated version')}"
    return AnomalibFile(
        file.path, method, str(version)[:80], state, options, _transform(spec), _share(sensitivity)
    )


def _module(file: Foreign, module: Record) -> AnomalibFile | None:
    state: dict[Any, Content] = {}
    _collect(module, "", state, [MOST_MODULES])
    method = _method(state)
    if method is None:
        return None
    fields = attributes(module)
    options = _pairs(fields.get("_hparams"))
    modules = _table(fields.get("_modules"))
    before = attributes(modules.get("pre_processor"))
    before = {**before, **_table(before.get("_modules"))}
    after = attributes(modules.get("post_processor"))
    spec = before.get("export_transform", before.get("transform"))
    return AnomalibFile(
        file.path,
        method,
        "exported module",
        state,
        options,
        _transform(spec),
        _share(after.get("image_sensitivity", 0.5)),
    )


def _table(value: Content) -> Mapping[Any, Content]:
    return value if isinstance(value, dict) else {}


def _share(value: Content) -> float:
    return float(value) if isinstance(value, int | float) and 0 <= value <= 1 else 0.5


def _collect(module: Record, prefix: str, state: dict[Any, Content], left: list[int]) -> None:
    """The arrays of a pickled module and of those in it, by the names of its state_dict."""
    left[0] -= 1
    if left[0] < 0 or prefix.count(".") > 30:
        return
    fields = attributes(module)
    for kind in ("_parameters", "_buffers"):
        arrays = fields.get(kind)
        if isinstance(arrays, dict):
            state.update(
                {f"{prefix}{name}": value for name, value in arrays.items() if isinstance(value, np.ndarray)}
            )
    inner = fields.get("_modules")
    for name, child in inner.items() if isinstance(inner, dict) else ():
        if isinstance(child, Record):
            _collect(child, f"{prefix}{name}.", state, left)


def _pairs(value: Content) -> Mapping[Any, Content]:
    """A table that was pickled as a foreign class: its items."""
    items = value.state if isinstance(value, Record) else value
    if isinstance(items, dict):
        return items
    listed = items if isinstance(items, list) else []
    return {
        pair[0]: pair[1]
        for pair in listed
        if isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str)
    }


def _transform(spec: Content, depth: int = 0) -> list[tuple[str, Mapping[Any, Content]]] | None:
    """The steps of a transform, stored as plain data or as a pickled object; None where nothing is stored."""
    if depth > 8:
        return None
    if isinstance(spec, dict) and isinstance(spec.get("class_path"), str):
        kind, fields = spec["class_path"].rpartition(".")[2], spec.get("init_args")
    elif isinstance(spec, Record):
        kind, fields = spec.kind.rpartition(".")[2], attributes(spec)
    else:
        return None
    table = fields if isinstance(fields, dict) else {}
    if kind != "Compose":
        return [(kind, table)]
    steps: list[tuple[str, Mapping[Any, Content]]] = []
    listed = table.get("transforms")
    for step in listed if isinstance(listed, list) else [None]:
        steps += _transform(step, depth + 1) or [("step of an unknown kind", {})]
    return steps
