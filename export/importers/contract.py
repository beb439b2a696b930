"""What an importer is: it recognises a file of a trained detector, and makes of it the parts of a bundle.

An importer is an object behind an entry point of `gelgate.importers`. It gets the file's content as plain values
(`plugins.reading`) and never opens the file itself.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.features import trunk_grid
from calibration.fitting.trunks import Trunk
from edge import registry
from edge.core.arrays import F32, F64
from edge.core.detector import Bank, Features, Grid, Packing
from edge.core.errors import ConfigError, FitError
from edge.model.graph_cut import cut_trunk
from edge.model.onnx_validation import GraphRefused
from edge.model.session import open_session
from plugins.reading.foreign import Foreign, describe

__all__ = ["Imported", "Importer", "Recognised", "Settings", "importer_of", "importers", "require"]

PartsT = TypeVar("PartsT")


@dataclass(frozen=True)
class Recognised:
    """What a file is."""

    what: str
    """One phrase, such as `PaDiM of anomalib`."""
    fields: Mapping[str, str] = field(default_factory=dict)
    """Further facts in words, for `detect`."""
    needs: tuple[str, ...] = ()
    """What must be given besides the file, such as `--backbone`."""
    region: Literal["full", "centre"] = "centre"
    """The part of the picture that such a model is usually trained on, `full` or `centre`."""


@dataclass(frozen=True)
class Settings:
    """What the caller gives besides the file."""

    frame: tuple[int, int]
    """(h, w) of the inspected region in pixels."""
    pixels_per_mm: float
    """The scale of the sensor's profile."""
    trunk: Trunk | None = None
    """The trunk, for files without the weights of their backbone."""
    rank: int | None = None
    """Directions kept at each place at most; None keeps all."""
    packing: Packing = "float16"
    """How the bank is stored."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Further settings of one importer by name."""

    def cut_trunk(self, path: Path, taps: Sequence[str], why: str) -> tuple[Trunk, Grid]:
        """Cut the caller's trunk after these taps; with its grid on the inspected region.

        path, why: which file has no weights, and what it has. Errors: ConfigError where no trunk was given or it lacks
        a tap.
        """
        trunk = self.trunk
        if trunk is None:
            raise ConfigError(
                f"{path} holds no weights of its backbone ({why}); name the trunk that it was trained on: "
                f"--backbone trunk.onnx"
            )
        try:
            graph = cut_trunk(trunk.graph, tuple(taps))
            session = open_session(graph, 2, f"the trunk '{trunk.id}'")
            grid = trunk_grid(session, taps, self.frame, self.pixels_per_mm)
        except GraphRefused as error:
            raise ConfigError(f"the trunk '{trunk.id}' cannot be used: {error}") from error
        except FitError as error:
            raise ConfigError(f"{path}: {error}") from error
        return Trunk(trunk.id, graph, trunk.facts), grid

    def bank(self, arrays: Mapping[str, NDArray[Any]], *packed: str) -> Bank:
        """Make a bank, of which these arrays are stored as the caller wants."""
        return Bank(arrays, {} if self.packing == "none" else dict.fromkeys(packed, self.packing))

    def centred_bank(self, rows: F32, width: int | None = None) -> Bank:
        """Make a bank of rows minus their mean, and the mean. width: the first columns alone, None for all."""
        mean = rows[:, :width].mean(axis=0, dtype=np.float64).astype(np.float32)
        centred = rows.copy()
        centred[:, :width] -= mean
        return self.bank({"bank": centred, "mean": mean}, "bank")

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
    """The parts of a bundle, and what was learnt of the file."""

    method: str
    """The name in results."""
    source: str
    """The file's kind in words."""
    trunk: Trunk
    """The network, with the head's taps as outputs."""
    head: bytes
    """The ONNX graph from taps to score map and score."""
    bank: Bank
    """The arrays that the head reads."""
    grid: Grid
    """The sizes of frame and taps."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """The method's parameters, for the manifest."""
    threshold: float | None = None
    """The model's own threshold on this bundle's scale, None where the file has none."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Facts for the manifest, plain JSON."""
    says: tuple[str, ...] = ()
    """Sentences for the user."""
    exact: Callable[[Features], tuple[F64, F64]] | None = None
    """Distances of some cells from features, by the file's own full form (n, cells) and by the bank.

    They are squared or plain, and measure what a reduction costs. None where nothing is reduced.
    """


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


def require(parts: PartsT | None, file: Foreign, what: str) -> PartsT:
    """Give what an importer has recognised. Errors: ConfigError where the file holds nothing of it."""
    if parts is None:
        raise ConfigError(f"{file.path} holds no {what}; see `gelgate export detect`")
    return parts


def importers() -> list[Importer]:
    """List the installed importers by name. Errors: ConfigError for an object that is not an importer."""
    return [_load(name) for name in registry.names("importers")]


def importer_of(file: Foreign) -> tuple[Importer, Recognised]:
    """The importer that recognises the file, and what it is.

    Errors: ConfigError with what the file holds where none does, or where several do.
    """
    known = importers()
    fitting = [(each, what) for each in known if (what := each.recognised(file)) is not None]
    if not fitting:
        raise ConfigError(
            f"{file.path} is a {file.form} that holds {describe(file.content)}; no importer knows it. Known are "
            f"{', '.join(each.name for each in known)}; weights of a backbone come in by `gelgate export backbone`, "
            "and any other network as ONNX by `gelgate bundle wrap`"
        )
    if len(fitting) > 1:
        names = ", ".join(importer.name for importer, _ in fitting)
        raise ConfigError(
            f"{file.path} is recognised by several importers ({names}); name one with --importer"
        )
    return fitting[0]


def _load(name: str) -> Importer:
    importer = registry.importer(name)
    if not isinstance(importer, Importer):
        raise ConfigError(
            f"the importer '{name}' is a {type(importer).__name__} without recognised and imported; correct its package"
        )
    return importer
