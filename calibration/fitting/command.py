"""`gelgate fit`: nominal presses in, a bundle out."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import typer

from calibration.fitting.candidates import DEFAULT_METHOD, Candidates
from calibration.fitting.options import (
    Alpha,
    AugmentOption,
    ChosenBackbone,
    ChosenMethod,
    GelId,
    HiddenPattern,
    HiddenProfile,
    HiddenRegion,
    HiddenRevision,
    HiddenSeed,
    HiddenThreads,
    HiddenThreshold,
    Holdout,
    LeaveOut,
    Limit,
    NoContact,
    Output,
    Overwrite,
    Part,
    Position,
    RegisterOption,
    Resize,
    Scattered,
    Settings,
)
from calibration.fitting.trunks import AUTO

if TYPE_CHECKING:
    from calibration.fitting.fit import Fitted
    from calibration.fitting.fit_config import FitConfig
    from calibration.fitting.presses.nominal_presses import NominalPresses
    from calibration.fitting.presses.sources import Sources
    from calibration.progress import Report
    from edge.core.imaging.region import Region
    from edge.core.imaging.sensor_profile import SensorProfile

__all__ = [
    "chosen_profile",
    "counted",
    "fit",
    "found_sources",
    "make",
    "next_revision",
    "nominal_presses",
    "refuse_existing",
]


def fit(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SOURCE...", help="Recordings, datasets, folders of pictures, or pictures."),
    ],
    output: Output,
    part: Part = None,
    position: Position = None,
    method: ChosenMethod = DEFAULT_METHOD,
    mode: Annotated[str, typer.Option(hidden=True, help="'corrected', or as in the 'paper'")] = "corrected",
    backbone: ChosenBackbone = AUTO,
    profile: HiddenProfile = "",
    region: HiddenRegion = "centre",
    alpha: Alpha = 0.05,
    threshold: HiddenThreshold = None,
    no_contact: NoContact = None,
    resize: Resize = False,
    pattern: HiddenPattern = None,
    holdout: Holdout = 0.0,
    settings: Settings = None,
    seed: HiddenSeed = 0,
    folds: Annotated[int, typer.Option(hidden=True, min=2, help="Banks that find the threshold.")] = 5,
    threads: HiddenThreads = 2,
    scattered: Scattered = False,
    limit: Limit = "chosen",
    register: RegisterOption = "auto",
    augment: AugmentOption = "auto",
    leave_out: LeaveOut = None,
    trunk: Annotated[bool, typer.Option(hidden=True, help="Put the trunk into the bundle.")] = True,
    overwrite: Overwrite = False,
    revision: HiddenRevision = None,
    gel: GelId = None,
) -> None:
    """Learn a bundle from nominal presses.

    The bundle holds bank, threshold and golden frames. Of a dataset (the paper's layout, MVTec's, CVAT's) the good
    presses of one part and position are learnt.
    """
    from calibration.fitting.fit_config import FitConfig

    refuse_existing(output, overwrite)
    candidates = Candidates.of(method, backbone)
    sensor = chosen_profile(profile, sources)
    found = found_sources(sources, part, position, sensor, holdout, seed)
    config = FitConfig(
        part=found.part,
        position=found.position,
        profile=sensor,
        region=_region(region, sensor),
        **_detection(candidates, mode, settings or [], threshold),
        alpha=alpha,
        threshold=threshold,
        seed=seed,
        threads=threads,
        folds=folds,
        with_trunk=trunk,
        is_scattered=scattered,
        **_choices(limit, register, augment),
        revision=revision or next_revision(output),
        gel_id=gel,
    )
    presses = nominal_presses(found, sensor, config.region, no_contact, resize, leave_out, pattern)
    _announce(presses, config, candidates)
    make(partial(_fit_best, candidates, presses, config), output, overwrite)


def _region(text: str, sensor: "SensorProfile") -> "Region":
    from edge.core.imaging.region import Region

    return Region.parse(text, sensor.size)


def _announce(presses: "NominalPresses", config: "FitConfig", candidates: Candidates) -> None:
    """What is fitted, or may be."""
    on = " or ".join([config.trunk.id, *candidates.trunks[1:]])
    how = f"{' or '.join(candidates.methods)} ({config.mode}) on {on}"
    typer.echo(f"{counted(len(presses))}, {how}, region {config.region}")


def _fit_best(
    candidates: Candidates, presses: "NominalPresses", config: "FitConfig", *, created: str, report: "Report"
) -> "Fitted":
    """Fit, of several methods or trunks with those that show most of small damage. Errors: as both steps."""
    from calibration.fitting.detection_choice import choose_detection
    from calibration.fitting.fit import fit_files

    if candidates.are_several:
        config = choose_detection(presses, config, candidates, report)
    return fit_files(presses, config, created=created, report=report)


def _choices(limit: str, register: str, augment: str) -> dict[str, Any]:
    """What a fit chooses itself unless it is decided by hand. Errors: ConfigError."""
    from edge.core.errors import ConfigError

    for option, word in {"--set register": register, "--set augment": augment}.items():
        if word not in ("auto", "never", "always"):
            raise ConfigError(f"{option} is auto, never or always, found '{word}'")
    return {"limit": _limit(limit), "register": register, "augment": augment}


def _limit(word: str) -> Literal["chosen", "plain"]:
    from edge.core.errors import ConfigError

    if word not in ("chosen", "plain"):
        raise ConfigError(f"no limit is named '{word}'; write --set limit=chosen or --set limit=plain")
    return "plain" if word == "plain" else "chosen"


def _detection(
    candidates: Candidates, mode: str, settings: list[str], threshold: float | None
) -> dict[str, Any]:
    """The usual detector, its parameters and its trunk, as `FitConfig` takes them. Errors: ConfigError, FitError."""
    from calibration.fitting.trunks import open_trunk
    from edge import registry
    from edge.cli.arguments import named_values
    from edge.core.detector import Mode
    from edge.core.errors import ConfigError
    from edge.core.suggest import suggestion

    if mode not in ("corrected", "paper"):
        raise ConfigError(f"no mode is named '{mode}'; known: corrected, paper")
    candidates.check(mode, settings, threshold)
    chosen: Mode = "paper" if mode == "paper" else "corrected"
    detector = registry.detector(candidates.methods[0])
    overrides = named_values("--set", settings)
    fields = {**_fields(detector.parameters("paper")), **_fields(detector.parameters("corrected"))}
    for name in overrides:
        if fields and name not in fields:
            raise ConfigError(
                f"--set {name}: the fit and {candidates.methods[0]} have no such parameter; "
                f"{suggestion(name, [*_names_under_set(), *fields])}"
            )
    trunk = open_trunk(candidates.trunks[0], detector.taps(detector.parameters(chosen, **overrides)))
    return {"detector": detector, "mode": chosen, "overrides": overrides, "trunk": trunk}


def _fields(parameters: object) -> dict[str, object]:
    """Give the parameters by name; none where their class keeps them otherwise."""
    return getattr(parameters, "__dict__", {})


def _names_under_set() -> list[str]:
    """Name the parameters of the fit that its help does not show."""
    hints = get_type_hints(fit, include_extras=True)
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return [name for name, found in marks.items() if any(getattr(one, "hidden", False) for one in found)]


def found_sources(
    sources: Sequence[Path],
    part: str | None,
    position: str | None,
    sensor: "SensorProfile",
    holdout: float = 0.0,
    seed: int = 0,
) -> "Sources":
    """The sources with datasets resolved; prints the held-out specimens. Errors: as `find_sources`; BadParameter."""
    from calibration.fitting.presses.sources import check_present, find_sources, is_dataset

    check_present(sources)
    if part is None and not any(map(is_dataset, sources)):
        raise typer.BadParameter("Missing option '--part': only a dataset knows what is pressed.")
    found = find_sources(sources, part, position, sensor.size, holdout=holdout, seed=seed)
    if found.held_out:
        typer.echo(f"held out for evaluation: {', '.join(found.held_out)}")
    return found


def nominal_presses(
    found: "Sources",
    sensor: "SensorProfile",
    region: "Region",
    no_contact: Sequence[Path] | None,
    resize: bool,
    leave_out: Sequence[str] | None = None,
    pattern: str | None = None,
) -> "NominalPresses":
    """The presses of all sources. Errors: as `read_presses`."""
    from calibration.fitting.presses.nominal_presses import read_presses

    return read_presses(
        found.paths,
        sensor,
        region,
        no_contact=no_contact or (),
        resize=resize,
        specimens=found.specimens,
        leave_out=leave_out or (),
        pattern=pattern,
    )


def make(work: "Callable[..., Fitted]", output: Path, overwrite: bool) -> None:
    """Do the work under progress bars, write the bundle and print a summary. work: takes created and report."""
    import datetime

    from calibration.progress import Stages

    with Stages() as report:
        fitted = work(created=datetime.date.today().isoformat(), report=report)
    write(fitted, output, overwrite)
    summary(fitted, output)


def refuse_existing(output: Path, overwrite: bool) -> None:
    """Before any work: nothing is overwritten, and there is a folder to write in. Errors: ConfigError."""
    from edge.core.errors import ConfigError

    if os.path.exists(output) and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or add --overwrite")
    above = next(folder for folder in output.absolute().parents if os.path.exists(folder))
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise ConfigError(
            f"{output} cannot be written: {above} is no folder to write in; choose another place"
        )


def next_revision(output: Path) -> int:
    """One more than that of the bundle that is replaced; 1 where there is none, or none that can be read."""
    from edge.core.errors import BundleError
    from edge.model.archive import MANIFEST, open_archive
    from edge.model.bundle import MAX_MANIFEST_BYTES, parse_manifest

    try:
        manifest = parse_manifest(open_archive(output).read(MANIFEST, MAX_MANIFEST_BYTES), str(output))
    except BundleError:
        return 1
    return (manifest.revision or 0) + 1


def counted(n: int) -> str:
    return f"{n} nominal press{'' if n == 1 else 'es'}"


def write(fitted: "Fitted", output: Path, overwrite: bool) -> None:
    """Errors: StoreError with what to do."""
    from edge.core.errors import StoreError
    from edge.model.bundle_writer import write_bundle

    try:
        write_bundle(output, fitted.files, overwrite=overwrite)
    except OSError as error:
        raise StoreError(
            f"{output} cannot be written: {error.strerror or error}; free some space or choose another folder"
        ) from error


def chosen_profile(name: str, sources: list[Path]) -> "SensorProfile":
    """The requested profile, or the one that all recordings among the sources name."""
    from calibration.fitting.presses.nominal_presses import is_recording
    from edge.core.errors import ConfigError
    from edge.core.imaging.known_profiles import profile
    from edge.recording.format import Recording

    if name:
        return profile(name)
    named = {Recording.open(s).header.profile for s in sources if is_recording(s)} - {""}
    if len(named) > 1:
        raise ConfigError(
            f"the recordings name different profiles: {', '.join(sorted(named))}; choose with --profile"
        )
    return profile(named.pop() if named else "mini_lr")


def summary(fitted: "Fitted", output: Path) -> None:
    """The summary of the bundle, in a few lines."""
    from edge.model.limit_facts import (
        AUGMENTATION,
        BACKBONE_CHOICE,
        LIMIT,
        METHOD_CHOICE,
        MISSING,
        UNPROVEN,
        choice_sentence,
    )
    from edge.model.promise import promise

    manifest = fitted.manifest
    limit, cost = manifest.threshold, manifest.cost
    for warning in manifest.provenance.warnings:
        typer.echo(f"warning: {warning}", err=True)
    if sentence := choice_sentence(manifest.facts, METHOD_CHOICE):
        typer.echo(f"method: {sentence}")
    if sentence := choice_sentence(manifest.facts, BACKBONE_CHOICE):
        typer.echo(f"backbone: {sentence}")
    if why := manifest.facts.get("registration"):
        typer.echo(f"registration: {why}")
    if sentence := choice_sentence(manifest.facts, AUGMENTATION):
        typer.echo(f"augmentation: {sentence}")
    typer.echo(f"threshold {limit.value:.5g}: {limit.method}")
    if sentence := choice_sentence(manifest.facts, LIMIT):
        typer.echo(f"limit: {sentence}")
    if sentence := choice_sentence(manifest.facts, MISSING):
        typer.echo(f"missing relief: {sentence}")
    typer.echo(f"false alarms: {promise(limit)}")
    if cost:
        typer.echo(
            f"a frame takes {cost.trunk_ms:.1f} + {cost.head_ms:.1f} ms (trunk + head, {cost.threads} threads); "
            f"the bank {cost.bank_bytes_stored / 1e6:.2f} MB stored, {cost.bank_bytes_unpacked / 1e6:.2f} MB in use"
        )
    is_unproven = any(said.startswith(UNPROVEN) for said in manifest.provenance.warnings)
    doubt = "; it is not proven: see the first warning" if is_unproven else ""
    typer.echo(f"bundle {manifest.part}/{manifest.position} written to {output}{doubt}")
