"""`gelgate bundle regions`: a bundle and what a person draws on its part in, a new revision of the bundle out."""

import datetime
from dataclasses import dataclass
from pathlib import Path

import typer

from calibration.fitting.command import refuse_existing
from calibration.fitting.fit_again import configure_again, read_again
from calibration.fitting.limits.map_limit import WINDOW_MM
from calibration.fitting.options import LeaveOut, NoContact, Overwrite, Threads
from calibration.fitting.regions.drawing import (
    draw_regions,
    find_promise,
    is_stricter,
    parse_region,
    read_regions,
    write_regions,
)
from edge.cli.arguments import add_argument, add_option, flatten
from edge.core.drawn_regions import DrawnRegion
from edge.core.errors import ConfigError
from edge.core.printable import write_count
from edge.core.suggest import suggestion
from edge.model.bundle import Bundle
from edge.model.manifest import ThresholdEntry
from edge.model.manifest_facts import promise

__all__ = ["regions"]


@dataclass(frozen=True)
class RegionsArguments:
    """What the command line says."""

    bundle: Path = add_argument(..., "The bundle in use.")
    sources: list[Path] | None = add_argument(
        None, "Its nominal presses, as for `fit`; a stricter region needs them.", metavar="[SOURCE...]"
    )
    output: Path | None = add_option(
        None, "The bundle to write: a folder, or a name ending in .zip.", "--output", "-o"
    )
    add: list[str] | None = add_option(
        None,
        "'ignore NAME x,y x,y x,y', 'judge NAME ...' or 'stricter NAME FACTOR ...': corners in mm from the "
        "top left corner of the inspected region.",
        metavar="TEXT",
    )
    file: Path | None = add_option(None, "Add the regions of a TOML file, as this command prints them.")
    remove: list[str] | None = add_option(None, "Remove a region.", metavar="NAME")
    no_contact: NoContact = None
    leave_out: LeaveOut = None
    threads: Threads = 2
    overwrite: Overwrite = False


@flatten
def regions(given: RegionsArguments) -> None:
    """Draw where a bundle judges, ignores, or is stricter.

    Without --add, --file and --remove the regions are printed. Else a new revision is written beside the bundle: the
    score map is weighed by the regions before the verdict, and with registration they follow the part. The new bundle
    is not signed.
    """
    old = Bundle.load(given.bundle)
    if not (given.add or given.file or given.remove):
        drawn = old.manifest.regions
        typer.echo(write_regions(drawn.regions if drawn else ()) or "no region is drawn")
        return
    if given.output is None or given.output.absolute() == given.bundle.absolute():
        raise ConfigError(
            "the new revision is written beside the bundle, never in its place; give another place with --output"
        )
    refuse_existing(given.output, given.overwrite)
    wanted = _change(given, old)
    fitted = draw_regions(given.bundle, wanted, _find_promise(given, old, wanted), given.threads)
    fitted.write(given.output, overwrite=given.overwrite)
    manifest = fitted.manifest
    sentence = manifest.regions.describe() if manifest.regions else ""
    typer.echo(sentence or "no region is drawn any more")
    new = fitted.bundle()
    if new.blind is not None and "limit_window_up_rows" in new.bank:
        typer.echo(
            f"a change in an ignored place hides faint damage within {3 * WINDOW_MM:g} mm of it, for a press is "
            "compared with its surroundings (docs/limits.md)"
        )
    if sentence and new.registration is not None and not new.registration.open().is_unique:
        typer.echo(
            "the part looks nearly the same at another place or turn: a press half a pitch off has its regions a pitch "
            "further on (docs/limits.md)"
        )
    typer.echo(f"false alarms: {promise(manifest.threshold)}")
    typer.echo(f"revision {manifest.revision} written to {given.output}")


def _change(given: RegionsArguments, old: Bundle) -> list[DrawnRegion]:
    """Return the regions that the bundle is to have. Errors: ConfigError."""
    kept = {region.name: region for region in (old.manifest.regions.regions if old.manifest.regions else ())}
    for name in given.remove or ():
        if name not in kept:
            known = suggestion(name, list(kept)) if kept else "it has none"
            raise ConfigError(f"--remove: the bundle has no region '{name}'; {known}")
        del kept[name]
    added = [] if given.file is None else read_regions(given.file)
    return [*kept.values(), *added, *map(parse_region, given.add or ())]


def _find_promise(given: RegionsArguments, old: Bundle, wanted: list[DrawnRegion]) -> ThresholdEntry | None:
    """Find what the limit promises where a place is judged more strictly; None where its promise holds. Errors:
    FitError, ConfigError without the nominal presses."""
    if not is_stricter(old, wanted):
        return None
    if not given.sources:
        raise ConfigError(
            f"a stricter region fails more sound presses, and bundle {given.bundle} keeps no maps of its nominal "
            "presses to count them by; give the presses of its fit as SOURCE"
        )
    nominal = read_again(old, given.sources, no_contact=given.no_contact, leave_out=given.leave_out or ())
    typer.echo(write_count(len(nominal), "nominal press"))
    config = configure_again(old, None, given.threads, None)
    return find_promise(old, wanted, nominal, config, datetime.date.today().isoformat())
