"""`gelgate bundle teach`: damage that passed in, what would find it and its cost out, and a bundle that does."""

import datetime
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import typer

from calibration.fitting.command import refuse_existing, summarise
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.fit_again import configure_again, read_again
from calibration.fitting.learn import (
    Comparison,
    ConfirmedPresses,
    judge_presses,
    leave_out_places,
    read_confirmed,
    write_picture,
)
from calibration.fitting.learn_command import WAY_ON, warn_of_lost
from calibration.fitting.options import LeaveOut, NoContact, Overwrite, Threads
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.regions.drawing import draw_again
from calibration.fitting.teach import (
    BEARABLE,
    Lesson,
    Remedy,
    change_method,
    lower_limit,
    lower_place,
    why_not,
)
from calibration.fitting.trunks import open_trunk
from calibration.progress import Stages
from edge import registry
from edge.cli.arguments import add_argument, add_option, flatten
from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.core.arrays import Mask
from edge.core.errors import ConfigError, FitError
from edge.core.part_position import PartPosition
from edge.core.press import Press
from edge.core.printable import write_count
from edge.core.suggest import suggestion
from edge.model.bundle import Bundle
from edge.store.history import find_press
from edge.store.press_archive import ArchiveFolder

__all__ = ["teach"]

# Those that are tried where none is named: with the usual one the best on real touch (docs/detectors.md).
_METHODS: Final = ("padim", "patchcore")

_MOST_DAMAGED: Final = 5


@dataclass(frozen=True)
class TeachArguments:
    """What the command line says."""

    bundle: Path = add_argument(..., "The bundle in use.")
    sources: list[Path] = add_argument(..., "Its nominal presses, as for `fit`.", metavar="SOURCE...")
    damaged: list[str] = add_option(
        ..., "A damaged press: its id, or a picture; 1 to 5 of them.", metavar="PRESS"
    )
    output: Path | None = add_option(
        None, "The bundle to write: a folder, or a name ending in .zip.", "--output", "-o"
    )
    take: str | None = add_option(
        None, "Write this one: limit, place, or a method; by default all are shown and none is written."
    )
    methods: list[str] | None = add_option(
        None, "Another method to try; default: padim and patchcore.", "--method", show_default=False
    )
    config: ConfigOption = CONFIG
    database: DatabaseOption = None
    no_contact: NoContact = None
    leave_out: LeaveOut = None
    threads: Threads = 2
    overwrite: Overwrite = False


@flatten
def teach(given: TeachArguments) -> None:
    """Teach a bundle damage that it missed.

    Shows what would find each damaged press: a lower limit, a lower limit at its place, or another method; and what
    that costs, on nominal presses by banks without them and on the archived presses of the station. --take writes one.
    """
    if (given.take is None) != (given.output is None):
        raise ConfigError("--take says what is written, and --output where; give both, or none to look first")
    if len(given.damaged) > _MOST_DAMAGED:
        raise FitError(f"found {len(given.damaged)} damaged presses, expected 1 to {_MOST_DAMAGED}")
    if given.output is not None:
        refuse_existing(given.output, given.overwrite)
    old = Bundle.load(given.bundle)
    database = _find_database(given)
    confirmed = _read_operation(old, database)
    with tempfile.TemporaryDirectory() as folder:
        lesson = _prepare(given, old, Path(folder), database, confirmed)
    unjudged = lesson.damaged.unjudged
    for k, name in enumerate(lesson.damaged.names):
        passes = "passes" if k in lesson.missed else "is found already"
        where = ", without the places at which the station did not judge it"
        typer.echo(
            f"{name} {passes}: score {lesson.scores[k] / old.manifest.threshold.value:.2f} of the limit"
            f"{where if unjudged is not None and unjudged[k].any() else ''}"
        )
    if not lesson.missed:
        raise FitError("the bundle finds every one of these presses; there is nothing to teach")
    remedies = _try_remedies(given, lesson)
    if given.take is not None and given.take not in remedies:
        raise ConfigError(
            f"'{given.take}' is not among what can be taken; {suggestion(given.take, list(remedies))}"
        )
    before = _judge(old, confirmed, database, given.threads)
    _describe(lesson, remedies)
    if given.take is None:
        for remedy in remedies.values():
            _compare(remedy, before, confirmed, database, given.threads)
        return
    taken = remedies[given.take]
    if lost := [lesson.damaged.names[k] for k in lesson.missed if not taken.is_found[k]]:
        raise FitError(f"{given.take} does not find {', '.join(lost)}, and is not written")
    _compare(taken, before, confirmed, database, given.threads, is_taken=True)
    if given.take not in ("limit", "place"):
        warn_of_lost(old)
    assert given.output is not None
    taken.fitted.write(given.output, overwrite=given.overwrite)
    summarise(taken.fitted, given.output)
    typer.echo(WAY_ON)


def _find_database(given: TeachArguments) -> Path | None:
    """Find the station's database; None where only pictures are given and there is no station."""
    is_asked = given.database is not None or given.config.is_file()
    needs_it = not all(Path(one).is_file() for one in given.damaged)
    if is_asked or needs_it:
        return database_path(given.config, given.database)
    typer.echo("there is no station's configuration here, so presses of operation are not counted")
    return None


def _read_operation(old: Bundle, database: Path | None) -> ConfirmedPresses:
    """Read what people said, and the newest archived presses of the part."""
    if database is None:
        return ConfirmedPresses()
    return read_confirmed(database, PartPosition(old.manifest.part, old.manifest.position), old.digest)


def _prepare(
    given: TeachArguments, old: Bundle, folder: Path, database: Path | None, confirmed: ConfirmedPresses
) -> Lesson:
    """Read the nominal and the damaged presses. Errors: FitError for a press that people call good, or of another
    part."""
    good = {one.press.press_id: one.describe() for one in confirmed.good}
    if called := [good[one] for one in given.damaged if one in good]:
        raise FitError(
            f"people call {'; '.join(called)} good; say with `confirm_press` that it is damaged first"
        )
    pictures = [_write_picture(one, folder, database, old) for one in given.damaged]
    files = [path for path, _ in pictures]
    nominal = read_again(
        old,
        given.sources,
        no_contact=given.no_contact,
        leave_out=given.leave_out or (),
    )
    damaged = read_presses(files, old.profile, old.region, no_contact=given.no_contact)
    archived = {path.name: path.stem for path in files if path.parent == folder}
    damaged = replace(damaged, names=tuple(archived.get(Path(one).name, one) for one in damaged.names))
    damaged = leave_out_places(damaged, {path.stem: unjudged for path, unjudged in pictures})
    typer.echo(f"{len(damaged)} damaged and {write_count(len(nominal), 'nominal press')}")
    config = configure_again(old, None, given.threads, None)
    return Lesson(old, damaged, nominal, config, datetime.date.today().isoformat())


def _write_picture(press: str, folder: Path, database: Path | None, old: Bundle) -> tuple[Path, Mask | None]:
    """Give a picture's path; that of an archived press after it is written there, with the places at which the station
    did not judge it. Errors: ArchiveError, StoreError; FitError for a press of another part."""
    if database is None or Path(press).is_file():
        return Path(press), None
    known, archive = find_press(database, press), ArchiveFolder(database.with_suffix(".archive"))
    then = archive.press(known.press_id, known.evidence)
    part = PartPosition(old.manifest.part, old.manifest.position)
    if (then.part, then.position) != part:
        raise FitError(
            f"press {then.press_id} is of {then.part}/{then.position}, and the bundle is of {part}; teach the bundle "
            "of its part"
        )
    frame = archive.read(then.frame, f"the judged frame of press {known.press_id}")
    return write_picture(then, frame, folder), None if then.masked is None else archive.read_masked(then)


def _try_remedies(given: TeachArguments, lesson: Lesson) -> dict[str, Remedy]:
    """Make what can be taken, and say what cannot."""
    methods = given.methods if given.methods is not None else list(_METHODS)
    wanted = {"limit": lambda: lower_limit(lesson), "place": lambda: lower_place(lesson)} | {
        name: lambda name=name: change_method(lesson, name, lambda: _fit_method(lesson, name))
        for name in methods
        if name != lesson.config.detector.name
    }
    made = [make() for name, make in wanted.items() if given.take in (None, name)]
    for remedy in made:
        if isinstance(remedy, str):
            typer.echo(remedy)
    return {one.name: one for one in made if not isinstance(one, str)}


def _fit_method(lesson: Lesson, name: str) -> Fitted:
    """Fit another method, with the drawn regions of the bundle."""
    detector, config = registry.detector(name), lesson.config
    trunk = open_trunk(config.trunk.id, detector.taps(detector.parameters(config.mode)))
    config = replace(config, detector=detector, trunk=trunk, overrides={})
    with Stages() as report:
        fitted = fit_files(lesson.nominal, config, created=lesson.created, report=report)
    return draw_again(lesson.old, fitted, lesson.nominal, config, lesson.created)


def _describe(lesson: Lesson, remedies: Mapping[str, Remedy]) -> None:
    """Print what each finds and costs; where none is bearable, the sound press that is the reason."""
    now = Remedy("now", "the bundle as it is", Fitted(lesson.old.manifest, {}), lesson.scores)
    for remedy in (now, *remedies.values()):
        typer.echo(remedy.describe())
    bearable = [one for one in remedies.values() if one.rate <= BEARABLE]
    lost = [not any(one.is_found[k] for one in bearable) for k in lesson.missed]
    for is_lost, reason in zip(lost, why_not(lesson) if any(lost) else (), strict=False):
        if is_lost:
            typer.echo(
                f"nothing of this finds it at a bearable cost ({BEARABLE:.0%} of sound presses): {reason}"
            )


def _judge(
    bundle: Bundle, confirmed: ConfirmedPresses, database: Path | None, threads: int
) -> dict[str, Press]:
    if database is None:
        return {}
    with Stages() as report:
        return judge_presses(bundle, confirmed, database, threads, report)


def _compare(
    remedy: Remedy,
    before: Mapping[str, Press],
    confirmed: ConfirmedPresses,
    database: Path | None,
    threads: int,
    *,
    is_taken: bool = False,
) -> None:
    """Print what the station's presses say of it. Errors: FitError for one that is taken and is worse than before."""
    if database is None:
        return
    after = _judge(remedy.fitted.bundle(), confirmed, database, threads)
    comparison = Comparison(confirmed, before, after)
    typer.echo(f"{remedy.name} in operation: {comparison.describe()}; {comparison.changes()}")
    if is_taken:
        comparison.check()
