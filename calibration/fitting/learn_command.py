"""`gelgate bundle learn`: a bundle, its nominal presses and what people said at the station in, a new bundle out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.fitting.options import GelId, LeaveOut, NoContact, Output, Overwrite, Threads
from edge.cli.arguments import flatten
from edge.cli.options import CONFIG, ConfigOption, DatabaseOption

if TYPE_CHECKING:
    from calibration.fitting.fit_config import FitConfig
    from calibration.fitting.learn import ConfirmedPresses
    from calibration.fitting.presses.nominal_presses import NominalPresses
    from edge.core.part_position import PartPosition
    from edge.model.bundle import Bundle

__all__ = ["LearnArguments", "learn"]


@dataclass(frozen=True)
class LearnArguments:
    """What the command line says."""

    bundle: Annotated[Path, typer.Argument(help="The bundle in use.")]
    sources: Annotated[
        list[Path], typer.Argument(metavar="SOURCE...", help="Its nominal presses, as for `fit`.")
    ]
    output: Output
    config: ConfigOption = CONFIG
    database: DatabaseOption = None
    alpha: Annotated[
        float | None,
        typer.Option(
            help="False-alarm rate of the threshold; default: that of the bundle.", show_default=False
        ),
    ] = None
    no_contact: NoContact = None
    leave_out: LeaveOut = None
    gel: GelId = None
    threads: Threads = 2
    overwrite: Overwrite = False


@flatten
def learn(given: LearnArguments) -> None:
    """Learn from what people said at the station.

    Presses that people call good are learnt beside the nominal ones, with the detector and the backbone of the bundle.
    The new bundle is not written where it passes a press that people call damaged and that was found before, or fails
    more good ones. Copy it in the place of the old one, keep that, and reload.
    """
    import tempfile

    from calibration.fitting.command import count_presses, make, refuse_existing
    from calibration.fitting.fit import Fitted, fit_files
    from calibration.fitting.learn import compare, write_pictures
    from calibration.fitting.presses.nominal_presses import read_presses
    from calibration.fitting.presses.sources import check_present, find_sources
    from edge.cli.options import database_path
    from edge.core.part_position import PartPosition
    from edge.model.bundle import Bundle

    refuse_existing(given.output, given.overwrite)
    check_present(given.sources)
    old = Bundle.load(given.bundle)
    manifest, database = old.manifest, database_path(given.config, given.database)
    confirmed = _read_words(database, PartPosition(manifest.part, manifest.position))
    config = _configure_again(old, given)
    sources = find_sources(given.sources, manifest.part, manifest.position, old.profile.size)
    if left_out := _left_out_before(sources.paths, manifest.provenance.left_out):
        typer.echo(f"left out as before: {', '.join(left_out)}")
    with tempfile.TemporaryDirectory() as folder:
        pictures = Path(folder) / "confirmed"
        write_pictures(confirmed.good, pictures)
        presses = read_presses(
            [*sources.paths, pictures],
            old.profile,
            old.region,
            no_contact=given.no_contact,
            specimens=sources.specimens,
            leave_out=[*left_out, *(given.leave_out or ())],
        )
    _warn_without_gel(old, presses)
    learnt = sum(name.startswith(f"{pictures.name}/") for name in presses.names)
    typer.echo(f"{count_presses(len(presses))}, {learnt} of them from the station")

    def fit_and_check(**how: object) -> Fitted:
        fitted = fit_files(presses, config, **how)  # type: ignore[arg-type]
        comparison = compare(old, fitted.bundle(), confirmed, database, given.threads)
        typer.echo(f"{comparison.describe()}; {comparison.changes()}")
        comparison.check()
        return fitted

    make(fit_and_check, given.output, given.overwrite)


def _read_words(database: Path, part: "PartPosition") -> "ConfirmedPresses":
    """Read what people said of a part, and say what of it is left out. Errors: FitError where nothing can be learnt."""
    from calibration.fitting.learn import read_confirmed
    from edge.core.errors import FitError

    confirmed = read_confirmed(database, part)
    for sentence in confirmed.left_out:
        typer.echo(f"warning: left out: {sentence}", err=True)
    words = ", ".join(f"{number} {word}" for word, number in sorted(confirmed.words.items())) or "nothing"
    typer.echo(f"people said of {part}: {words}")
    if not confirmed.good:
        raise FitError(
            f"no press of {part} that people call good can be learnt; say what presses were, on the page or with "
            "`confirm_press`"
        )
    return confirmed


def _warn_without_gel(old: "Bundle", presses: "NominalPresses") -> None:
    """Warn where the old bundle knew the free gel, and the new one will not."""
    if old.free_view is not None and presses.free_view is None:
        typer.echo(
            "warning: the old bundle knew the free gel, and these sources do not show it: less damage may be found; "
            "give pictures of it with --no-contact",
            err=True,
        )


def _left_out_before(sources: Sequence[Path], names: Sequence[str]) -> list[str]:
    """Choose the presses that are still among the sources, of those that the old bundle left out."""
    from calibration.fitting.presses.nominal_presses import is_recording, list_pictures

    recordings = {source.name for source in sources if is_recording(source)}
    pictures = list_pictures([source for source in sources if not is_recording(source)])
    there = {f"{path.parent.name}/{path.name}" for path in pictures}
    return [name for name in names if name in there or name.rpartition("#")[0] in recordings]


def _configure_again(old: "Bundle", given: LearnArguments) -> "FitConfig":
    """Make the configuration of a fit like that of the old bundle. Errors: FitError for a bundle of another origin."""
    import json

    from calibration.fitting.fit_config import FitConfig
    from calibration.fitting.trunks import open_trunk
    from edge import registry
    from edge.core.errors import FitError

    manifest = old.manifest
    if manifest.backbone is None or manifest.mode is None:
        raise FitError(f"bundle {old.where} is no bundle of `gelgate fit`, so it cannot be fitted again")
    detector = registry.detector(manifest.method)
    usual = json.loads(json.dumps(dict(vars(detector.parameters(manifest.mode)))))
    overrides = {
        name: value for name, value in manifest.parameters.items() if value != usual.get(name, value)
    }
    return FitConfig(
        part=manifest.part,
        position=manifest.position,
        profile=old.profile,
        region=old.region,
        detector=detector,
        trunk=open_trunk(
            manifest.backbone.id, detector.taps(detector.parameters(manifest.mode, **overrides))
        ),
        mode=manifest.mode,
        overrides=overrides,
        alpha=manifest.threshold.alpha if given.alpha is None else given.alpha,
        threads=given.threads,
        register="auto",
        augment="auto",
        revision=(manifest.revision or 0) + 1,
        gel_id=given.gel,
    )
