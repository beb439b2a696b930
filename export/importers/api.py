"""A trained detector of a research program becomes a bundle: the functions for notebooks and scripts.

from export import import_padim

import_padim("padim.ckpt", "presses/", "bracket.zip", part="bracket", licence="Apache-2.0")
"""

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calibration.fitting.command import refuse_existing
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.fitting.trunks import open_trunk
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.detector import Packing
from edge.core.errors import ConfigError
from edge.core.imaging.known_profiles import profile as known_profile
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle_writer import write_bundle
from edge.model.manifest_facts import LICENCE
from export.finish import WrapConfig
from export.importers.contract import Imported, Importer, Recognised, Settings, importer_of, importers
from export.importers.packing_loss import Losses, import_files
from export.known_weights import stated_licence
from plugins.reading.foreign import Foreign
from plugins.reading.isolated import read_foreign

__all__ = [
    "ImportOptions",
    "ImportedBundle",
    "import_detector",
    "import_fapm",
    "import_inreach",
    "import_padim",
    "import_patchcore",
    "import_spade",
]


ReadPresses = Callable[[SensorProfile, Region], NominalPresses]
"""Gives nominal presses for a profile and a region."""


@dataclass(frozen=True)
class ImportOptions:
    """What is said besides file and presses."""

    part: str
    """The part that the bundle inspects."""
    licence: str | None
    """The licence of the model and its weights, as stated by who trained it; required."""
    position: str = "default"
    """The position on the part."""
    backbone: str | None = None
    """The trunk for files without backbone weights: an installed backbone or an `.onnx` file."""
    profile: str = "mini_lr"
    """The sensor, as for a fit."""
    region: str | None = None
    """The region, as for a fit; None takes what such a model is usually trained on."""
    rank: int | None = None
    """Directions of PaDiM at most; None for all, exact."""
    packing: Packing = "float16"
    """How the bank is stored."""
    threshold: float | Literal["presses", "model"] = "presses"
    """`presses`, `model`, or a raw score."""
    alpha: float = 0.05
    channels: Path | None = None
    """A `.npy`, `.pt` or `.pkl` file of PaDiM's channels."""
    values: Mapping[str, Any] | None = None
    """Further settings of the importer."""
    importer: str | None = None
    """Its name, where several know the file."""
    threads: int = 2

    def __post_init__(self) -> None:
        if self.rank is not None and self.rank < 1:
            raise ConfigError(f"rank is at least 1, found {self.rank}; leave it out to keep all directions")
        if self.packing not in ("none", "float16", "int8"):
            raise ConfigError(f"packing is none, float16 or int8, found '{self.packing}'")


@dataclass(frozen=True)
class ImportedBundle:
    """A bundle that was written."""

    path: Path
    """The path of the bundle."""
    what: Recognised
    """What the file was."""
    model: Imported
    """Its parts."""
    losses: Losses
    """The losses of the smaller bank."""
    isolation: str
    """How the file was read."""
    warnings: tuple[str, ...]
    """The warnings about the presses."""


@one_blas_thread()
def import_detector(
    file: str | Path,
    presses: str | Path | Sequence[str | Path] | NominalPresses | ReadPresses,
    output: str | Path,
    options: ImportOptions,
    *,
    overwrite: bool = False,
    method: str | None = None,
    report: Report = lambda stage, fraction: None,
) -> ImportedBundle:
    """Import a trained detector and write its bundle, completely or not at all.

    presses: nominal ones that the model was not trained on: pictures, folders or recordings, or a function that reads
    them for a profile and region. method: refuse a file
    of another method. Errors: ConfigError that names file, field, found and expected; FitError for too few presses;
    BundleCorrupt where the packed bank does not score as the full one; FileExistsError, OSError.
    """
    source, target = Path(file), Path(output)
    refuse_existing(target, overwrite)
    licence = stated_licence(options.licence, f"{source} and of its weights")
    sensor = known_profile(options.profile)
    with read_foreign(source) as foreign:
        importer, what = _importer(foreign, options.importer)
        region = Region.parse(options.region or what.region, sensor.size)
        model = importer.imported(foreign, _settings(options, region, sensor))
        if method is not None and model.method != method:
            raise ConfigError(f"{source} is {what.what}, {method} was expected; use import_{model.method}")
        given = _collect_presses(presses, sensor, region)
        config = WrapConfig(
            options.part,
            options.position,
            sensor,
            region,
            model.method,
            options.alpha,
            _threshold(options.threshold, model, source),
            options.threads,
            {LICENCE: licence},
        )
        created = datetime.date.today().isoformat()
        fitted, losses = import_files(model, given, config, source, created=created, report=report)
        write_bundle(target, fitted.files, overwrite=overwrite)
        return ImportedBundle(
            target, what, model, losses, foreign.isolation, fitted.manifest.provenance.warnings
        )


def import_padim(file: str | Path, presses: Any, output: str | Path, **options: Any) -> ImportedBundle:
    """PaDiM of anomalib, or mean and covariance of a script.

    options: of `ImportOptions`. Errors: as `import_detector`.
    """
    return import_detector(file, presses, output, ImportOptions(**options), method="padim")


def import_patchcore(file: str | Path, presses: Any, output: str | Path, **options: Any) -> ImportedBundle:
    """PatchCore of anomalib or of amazon-science (`patchcore_params.pkl`). Otherwise as `import_padim`."""
    return import_detector(file, presses, output, ImportOptions(**options), method="patchcore")


def import_spade(file: str | Path, presses: Any, output: str | Path, **options: Any) -> ImportedBundle:
    """SPADE's features by layer. Otherwise as `import_padim`."""
    return import_detector(file, presses, output, ImportOptions(**options), method="spade")


def import_fapm(file: str | Path, presses: Any, output: str | Path, **options: Any) -> ImportedBundle:
    """FAPM's prototypes. Otherwise as `import_padim`."""
    return import_detector(file, presses, output, ImportOptions(**options), method="fapm")


def import_inreach(file: str | Path, presses: Any, output: str | Path, **options: Any) -> ImportedBundle:
    """InReaCh's nominal points. Otherwise as `import_padim`."""
    return import_detector(file, presses, output, ImportOptions(**options), method="inreach")


def _threshold(wanted: float | str, model: Imported, source: Path) -> float | None:
    """Return the stated threshold, None for that of the presses. Errors: ConfigError where the model has none."""
    if not isinstance(wanted, str):
        return wanted
    if wanted == "model" and model.threshold is None:
        raise ConfigError(
            f"{source} has no threshold of its own; leave --threshold out to find one from the presses"
        )
    return model.threshold if wanted == "model" else None


def _importer(file: Foreign, name: str | None) -> tuple[Importer, Recognised]:
    if name is None:
        return importer_of(file)
    for candidate in importers():
        what = candidate.recognised(file) if candidate.name == name else None
        if what is not None:
            return candidate, what
    raise ConfigError(
        f"the importer '{name}' does not know {file.path}; see `gelgate export detect {file.path}`"
    )


def _settings(options: ImportOptions, region: Region, sensor: SensorProfile) -> Settings:
    values = dict(options.values or {})
    if options.channels is not None:
        values["channels"] = _channels(options.channels)
    trunk = None if options.backbone is None else open_trunk(options.backbone)
    return Settings(
        (region.height, region.width), sensor.pixels_per_mm, trunk, options.rank, options.packing, values
    )


def _channels(path: Path) -> Any:
    """The numbers of a file of channels. Errors: ConfigError."""
    with read_foreign(path) as foreign:
        content = foreign.content
        if isinstance(content, dict) and len(content) == 1:
            content = next(iter(content.values()))
        return np.array(content) if isinstance(content, np.ndarray) else content


def _collect_presses(presses: Any, sensor: SensorProfile, region: Region) -> NominalPresses:
    if isinstance(presses, NominalPresses):
        return presses
    if callable(presses):
        read: NominalPresses = presses(sensor, region)
        return read
    paths = [presses] if isinstance(presses, str | Path) else list(presses)
    return read_presses([Path(path) for path in paths], sensor, region)
