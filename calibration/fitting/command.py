"""`gelgate fit`: nominal presses in, a bundle out."""

import datetime
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from calibration.fitting.options import (
    DEFAULT_METHOD,
    Alpha,
    Backbone,
    GelId,
    LeaveOut,
    NoContact,
    Output,
    Overwrite,
    Part,
    Pattern,
    Position,
    Profile,
    RegionText,
    Resize,
    Revision,
    Seed,
    Settings,
    Threads,
    Threshold,
    under_set,
)
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from calibration.folders import read_stamp
from calibration.progress import Stages
from edge import registry
from edge.cli.arguments import add_argument, add_option, flatten, parse_values
from edge.core.errors import BundleError, ConfigError, FitError
from edge.core.imaging.known_profiles import PROFILES, profile
from edge.core.printable import write_count
from edge.core.suggest import suggestion
from edge.model.archive import MANIFEST, ZipArchive, open_archive

if TYPE_CHECKING:
    from calibration.fitting.fit import Fitted
    from calibration.fitting.fit_config import FitConfig
    from calibration.fitting.presses.nominal_presses import NominalPresses
    from calibration.fitting.presses.sources import Sources
    from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["choose_profile", "fit", "make", "refuse_existing", "resolve_sources", "summarise"]


@dataclass(frozen=True)
class FitArguments:
    """What the command line says. What its help does not show is written under `--set`."""

    output: Output
    sources: list[Path] = add_argument(
        ..., "Recordings, datasets, folders of pictures, or pictures.", metavar="SOURCE..."
    )
    part: Part = None
    position: Position = None
    method: str = add_option(DEFAULT_METHOD, "The detector.")
    mode: str = add_option("corrected", "'corrected', or as in the 'paper'", hidden=True)
    backbone: Backbone = DEFAULT_BACKBONE
    profile: Annotated[str, under_set(Profile)] = ""
    region: Annotated[str, under_set(RegionText)] = "centre"
    alpha: Alpha = 0.05
    threshold: Annotated[float | None, under_set(Threshold)] = None
    no_contact: NoContact = None
    resize: Resize = False
    pattern: Annotated[str | None, under_set(Pattern)] = None
    holdout: float = add_option(
        0.0,
        "Share of a dataset's specimens that is kept for `gelgate evaluate`.",
        hidden=True,
        min=0,
        max=0.9,
    )
    settings: Settings = None
    seed: Annotated[int, under_set(Seed)] = 0
    folds: int = add_option(5, "Banks that find the threshold.", hidden=True, min=2)
    threads: Annotated[int, under_set(Threads)] = 2
    scattered: bool = add_option(
        False, "Fit any method to parts that lie anywhere.", "--scattered", hidden=True
    )
    limit: str = add_option(
        "chosen",
        "'chosen': the limit that finds most of the damage rendered into the presses; 'plain': one for all "
        "places.",
        hidden=True,
    )
    register: str = add_option(
        "auto",
        "Bring presses to one pose: 'auto' where parts are held or it finds more damage, 'never', 'always'.",
        hidden=True,
    )
    augment: str = add_option(
        "auto",
        "Learn rendered copies of the presses too: 'auto' with at most 8 presses and a picture of the free "
        "gel, 'never', 'always'.",
        hidden=True,
    )
    leave_out: LeaveOut = None
    trunk: bool = add_option(True, "Put the trunk into the bundle.", hidden=True)
    overwrite: Overwrite = False
    revision: Annotated[int | None, under_set(Revision)] = None
    gel: GelId = None


@flatten
def fit(given: FitArguments) -> None:
    """Learn a bundle from nominal presses.

    The bundle holds bank, threshold and golden frames. Of a dataset (the paper's layout, MVTec's, CVAT's) the good
    presses of one part and position are learnt.
    """
    from calibration.fitting.fit import fit_files

    refuse_existing(given.output, given.overwrite)
    presses, config = plan_fit(given)
    how = f"{config.detector.name} ({config.mode}) on {config.trunk.id}"
    typer.echo(f"{write_count(len(presses), 'nominal press')}, {how}, region {config.region}")
    try:
        make(partial(fit_files, presses, config), given.output, given.overwrite)
    except FitError:
        for fault in presses.faults:  # often the reason
            typer.echo(f"warning: {fault}", err=True)
        raise


def plan_fit(given: FitArguments) -> "tuple[NominalPresses, FitConfig]":
    """Read the presses, and return the settings of their fit. Errors: ConfigError, DatasetError, FitError."""
    from calibration.fitting.fit_config import FitConfig
    from calibration.fitting.presses.nominal_presses import read_presses
    from edge.core.imaging.region import Region

    sensor = choose_profile(given.profile, given.sources)
    press_sources = resolve_sources(
        given.sources, given.part, given.position, sensor, given.holdout, given.seed
    )
    config = FitConfig(
        part=press_sources.part,
        position=press_sources.position,
        profile=sensor,
        region=Region.parse(given.region, sensor.size),
        **_detection(given),
        alpha=given.alpha,
        threshold=given.threshold,
        seed=given.seed,
        threads=given.threads,
        folds=given.folds,
        with_trunk=given.trunk,
        is_scattered=given.scattered,
        limit=_check_word("limit", given.limit, ("chosen", "plain")),
        register=_check_word("register", given.register, ("auto", "never", "always")),
        augment=_check_word("augment", given.augment, ("auto", "never", "always")),
        revision=given.revision or next_revision(given.output),
        gel_id=given.gel,
        settings=_asked_for(given),
    )
    presses = read_presses(
        press_sources.paths,
        sensor,
        config.region,
        no_contact=given.no_contact,
        resize=given.resize,
        specimens=press_sources.specimens,
        leave_out=given.leave_out,
        pattern=given.pattern,
    )
    return presses, config


# They change what a later fit of the same presses gives; the others are in fields of the manifest, or of one machine.
_KEPT_SETTINGS = (
    "resize",
    "pattern",
    "holdout",
    "seed",
    "folds",
    "scattered",
    "limit",
    "register",
    "augment",
)


def _asked_for(given: FitArguments) -> dict[str, object]:
    """Return the settings that differ from the usual ones."""
    usual = {field.name: field.default for field in fields(FitArguments)}
    asked = {name: getattr(given, name) for name in _KEPT_SETTINGS}
    return {name: value for name, value in asked.items() if value != usual[name]}


def _check_word(option: str, word: str, known: Sequence[str]) -> Any:
    """Return the word of an option. Errors: ConfigError for an unknown one."""
    if word not in known:
        raise ConfigError(f"--set {option} is {', '.join(known[:-1])} or {known[-1]}, found '{word}'")
    return word


def _detection(given: FitArguments) -> dict[str, Any]:
    """Open the detector, with its parameters and its trunk, for `FitConfig`. Errors: ConfigError, FitError."""
    mode, settings = _check_word("mode", given.mode, ("corrected", "paper")), given.settings or []
    detector, overrides = registry.detector(given.method), parse_values("--set", settings)
    fields: dict[str, object] = {}  # none where a detector's parameters keep them otherwise
    for published in ("paper", "corrected"):
        fields |= getattr(detector.parameters(published), "__dict__", {})
    for name in overrides:
        if fields and name not in fields:
            hints = get_type_hints(fit, include_extras=True).items()
            ours = [one for one, hint in hints if getattr(hint.__metadata__[0], "hidden", False)]
            raise ConfigError(
                f"--set {name}: the fit and {given.method} have no such parameter; "
                f"{suggestion(name, [*ours, *fields])}"
            )
    trunk = open_trunk(given.backbone, detector.taps(detector.parameters(mode, **overrides)))
    return {"detector": detector, "mode": mode, "overrides": overrides, "trunk": trunk}


def resolve_sources(
    sources: Sequence[Path],
    part: str | None,
    position: str | None,
    sensor: "SensorProfile",
    holdout: float = 0.0,
    seed: int = 0,
) -> "Sources":
    """Find the presses of datasets among the sources; prints the held-out specimens. Errors: as `find_sources`;
    BadParameter."""
    from calibration.fitting.presses.sources import check_present, find_sources, is_dataset

    check_present(sources)
    if part is None and not any(map(is_dataset, sources)):
        raise typer.BadParameter("Missing option '--part': only a dataset knows what is pressed.")
    press_sources = find_sources(sources, part, position, sensor.size, holdout=holdout, seed=seed)
    if press_sources.held_out:
        typer.echo(f"held out for evaluation: {', '.join(press_sources.held_out)}")
    return press_sources


def make(work: "Callable[..., Fitted]", output: Path, overwrite: bool) -> None:
    """Do the work under progress bars, write the bundle and print a summary. work: takes created and report."""

    with Stages() as report:
        fitted = work(created=datetime.date.today().isoformat(), report=report)
    fitted.write(output, overwrite=overwrite)
    summarise(fitted, output)


def refuse_existing(output: Path, overwrite: bool, *, is_bundle: bool = True) -> None:
    """Check before any work that nothing is overwritten but a bundle, and there is a folder to write in. is_bundle:
    what is written is one, and no other file. Errors: ConfigError."""
    if not is_bundle and os.path.isdir(output):
        raise ConfigError(f"{output} is a folder, and a file is written; choose another name")
    if os.path.isdir(output) and os.listdir(output) and not os.path.isfile(output / MANIFEST):
        raise ConfigError(
            f"{output} is a folder that holds no bundle, and is not replaced; choose another name"
        )
    if is_bundle and os.path.isfile(output) and output.suffix != ".zip":
        raise ConfigError(f"{output} is a file, not a bundle, and is not replaced; choose another name")
    if os.path.exists(output) and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or add --overwrite")
    if is_bundle and (os.path.isfile(output) or (os.path.isdir(output) and os.listdir(output))):
        _refuse_foreign(output)
    above = next(folder for folder in output.absolute().parents if os.path.exists(folder))
    try:
        tempfile.TemporaryDirectory(dir=above).cleanup()
    except OSError as error:
        raise ConfigError(
            f"{output} cannot be written: {above} is no folder to write in; choose another place"
        ) from error


def _refuse_foreign(output: Path) -> None:
    """Errors: ConfigError for a folder or zip to be replaced that is no bundle, or holds what is none of its files."""
    from edge.model.bundle import MAX_MANIFEST_BYTES, parse_manifest
    from edge.model.signature import SIGNATURE

    try:
        archive = open_archive(output)
        manifest = parse_manifest(archive.read(MANIFEST, MAX_MANIFEST_BYTES), str(output))
    except BundleError as error:
        raise ConfigError(
            f"{output} is no bundle, and is not replaced; choose another name ({error})"
        ) from error
    if isinstance(archive, ZipArchive):
        names = archive.names()
    else:
        inside = (path for path in output.rglob("*") if path.is_symlink() or not path.is_dir())
        names = [str(path.relative_to(output)) for path in inside]
    if foreign := sorted({*names} - {MANIFEST, SIGNATURE, *(entry.file for entry in manifest.files)}):
        raise ConfigError(
            f"{output} holds {foreign[0]}, which is no file of its bundle, and is not replaced; move it away or "
            "choose another name"
        )


def next_revision(output: Path) -> int:
    """Return one more than the revision of the bundle that is replaced; 1 where none can be read."""
    from edge.model.bundle import MAX_MANIFEST_BYTES, parse_manifest

    try:
        manifest = parse_manifest(open_archive(output).read(MANIFEST, MAX_MANIFEST_BYTES), str(output))
    except BundleError:
        return 1
    return (manifest.revision or 0) + 1


def choose_profile(name: str, sources: list[Path]) -> "SensorProfile":
    """Return the requested profile, or the one that all recordings and acquisitions among the sources name, or the one
    for frames of a recording's size."""
    from calibration.fitting.presses.nominal_presses import is_recording
    from calibration.fitting.presses.sources import ACQUISITION
    from edge.recording.format import Recording

    if name:
        return profile(name)
    headers = [Recording.open(source).header for source in sources if is_recording(source)]
    stamps = [read_stamp(source / ACQUISITION) or {} for source in sources]
    named = {header.profile for header in headers} | {str(stamp.get("profile", "")) for stamp in stamps}
    if len(named := named - {""}) > 1:
        raise ConfigError(
            f"the recordings name different profiles: {', '.join(sorted(named))}; choose with --profile"
        )
    sizes = {header.mode for header in headers}
    fitting = next((known.name for known in PROFILES.values() if known.native in sizes), "mini_lr")
    return profile(named.pop() if named else fitting)


def summarise(fitted: "Fitted", output: Path) -> None:
    """Print what the bundle is, in a few lines."""
    from edge.model.manifest_facts import (
        AUGMENTATION,
        LIMIT,
        MISSING,
        UNPROVEN,
        choice_sentence,
        promise,
    )

    manifest = fitted.manifest
    threshold, cost = manifest.threshold, manifest.cost
    for warning in manifest.provenance.warnings:
        typer.echo(f"warning: {warning}", err=True)
    facts = manifest.facts
    sentences = {
        "free gel": facts.get("free_gel"),
        "marker dots": facts.get("dots"),
        "registration": facts.get("registration"),
        "augmentation": choice_sentence(facts, AUGMENTATION),
        f"threshold {threshold.value:.5g}": threshold.method,
        "limit": choice_sentence(facts, LIMIT),
        "missing relief": choice_sentence(facts, MISSING),
    }
    for what, sentence in sentences.items():
        if sentence:
            typer.echo(f"{what}: {sentence}")
    typer.echo(f"false alarms: {promise(threshold)}")
    if cost:
        typer.echo(
            f"a frame takes {cost.trunk_ms:.1f} + {cost.head_ms:.1f} ms (trunk + head, {cost.threads} threads); "
            f"the bank {cost.bank_bytes_stored / 1e6:.2f} MB stored, {cost.bank_bytes_unpacked / 1e6:.2f} MB in use"
        )
        typer.echo(
            f"the fit took {cost.features_s + cost.fit_s + cost.threshold_s:.1f} s of processor time: features and "
            f"registration {cost.features_s:.1f}, bank {cost.fit_s:.1f}, threshold and limits {cost.threshold_s:.1f}"
        )
    is_unproven = any(said.startswith(UNPROVEN) for said in manifest.provenance.warnings)
    doubt = "; it is not proven: see the first warning" if is_unproven else ""
    typer.echo(f"bundle {manifest.part}/{manifest.position} written to {output}{doubt}")
