"""What an importer is: it recognises a file of a trained detector, and makes of it the parts of a bundle.

An importer is an object behind an entry point of `gelgate.importers`. It gets the file's content as plain values
(`export.reading`) and never opens the file itself.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.trunks import Trunk
from edge.core.detector import Bank, Features, Grid, Packing
from edge.core.errors import ConfigError
from export.reading.foreign import Foreign

__all__ = ["Imported", "Importer", "Recognised", "Settings"]


@dataclass(frozen=True)
class Recognised:
    """What a file is. what: one phrase, such as `PaDiM of anomalib`. fields: further facts in words, for `detect`.
    needs: what must be given besides the file, such as `--backbone`. region: the part of the picture that such a model
    is usually trained on, `full` or `centre`."""

    what: str
    fields: Mapping[str, str] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    region: Literal["full", "centre"] = "centre"


@dataclass(frozen=True)
class Settings:
    """What the caller gives besides the file.

    frame: (h, w) of the inspected region in pixels. pixels_per_mm: of the sensor's profile. trunk: for files without
    the weights of their backbone. channels: a file with the selected channels, for PaDiM. rank: directions kept at each
    place at most; None keeps all. packing: how the bank is stored. values: further settings of one importer by name.
    """

    frame: tuple[int, int]
    pixels_per_mm: float
    trunk: Trunk | None = None
    rank: int | None = None
    packing: Packing = "float16"
    values: Mapping[str, Any] = field(default_factory=dict)

    def given_trunk(self, path: Path, why: str) -> Trunk:
        """The trunk. Errors: ConfigError where none was given."""
        if self.trunk is None:
            raise ConfigError(
                f"{path} holds no weights of its backbone ({why}); name the trunk that it was trained on: "
                f"--backbone trunk.onnx"
            )
        return self.trunk

    def value(self, name: str, kind: type[Any], usual: Any) -> Any:
        """A further setting by name, or the usual one. Errors: ConfigError for another type."""
        setting = self.values.get(name, usual)
        if kind is tuple and isinstance(setting, list) and all(isinstance(item, str) for item in setting):
            setting = tuple(setting)
        if kind is float and isinstance(setting, int) and not isinstance(setting, bool):
            return float(setting)
        if setting is not usual and type(setting) is not kind:
            raise ConfigError(f"--set {name}={setting} is not a {kind.__name__}")
        return setting


@dataclass(frozen=True)
class Imported:
    """The parts of a bundle, and what was learnt of the file.

    method: the name in results. source: the file's kind in words. trunk, head: graphs. threshold: the model's own, on
    this bundle's scale, None where the file has none. facts: for the manifest, plain JSON. says: sentences for the
    user. exact: squared or plain raw distances of some cells by the file's own full form (n, cells) and by the bank,
    from features; it measures what a reduction costs. None where nothing is reduced.
    """

    method: str
    source: str
    trunk: Trunk
    head: bytes
    bank: Bank
    grid: Grid
    parameters: Mapping[str, Any] = field(default_factory=dict)
    threshold: float | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    says: tuple[str, ...] = ()
    exact: Callable[[Features], tuple[NDArray[np.float64], NDArray[np.float64]]] | None = None


@runtime_checkable
class Importer(Protocol):
    """The object behind an entry point of `gelgate.importers`."""

    @property
    def name(self) -> str:
        """Its name, that of the entry point."""
        ...

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for a file of another kind."""
        ...

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Errors: ConfigError that names the file, the field, found and expected."""
        ...
