"""`gelgate station replay`: make verdicts again from the archived camera bytes, with the same or another bundle."""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from edge.cli.history import moment_ns
from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.clock import SystemClock, local_time
from edge.config import Config, load_config
from edge.core.errors import ArchiveError, BundleError, ConfigError
from edge.core.printable import printable, write_count
from edge.features.black_box.replay import Bundles, Replayed, judge_again
from edge.gateway.recorder import press_drawing
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.store.database import open_read_only
from edge.store.history import KnownPress, find_press, presses_since
from edge.store.person_verdicts import read_spoken_of
from edge.store.press_archive import ArchivedPress, ArchiveFolder, list_presses

__all__ = ["DIFFERS", "replay"]

DIFFERS = 8

_FindInspector = Callable[[ArchivedPress], Inspector | None]


def replay(
    press_id: Annotated[
        str | None,
        typer.Argument(
            metavar="[PRESS_ID]", help="A press: its number, its press_id, or the id's beginning."
        ),
    ] = None,
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    archive: Annotated[
        Path | None, typer.Option(help="The folder of archived presses; next to the database by default.")
    ] = None,
    is_all: Annotated[bool, typer.Option("--all", help="Every archived press.")] = False,
    since: Annotated[
        str | None,
        typer.Option(help="Archived presses from this moment on: a date, a time, or an age as 8h."),
    ] = None,
    bundles: Annotated[
        list[Path] | None,
        typer.Option(help="Where the bundle that judged is searched as well: a bundle, or a folder of them."),
    ] = None,
    bundle: Annotated[
        Path | None,
        typer.Option(help="Judge with this one instead, and print the verdicts that change."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Write the picture as this .png or .jpg; for several presses, into this folder."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
) -> None:
    """Make verdicts again, bit for bit.

    From the archived camera bytes, by the bundle with the recorded hash and as many threads as then. Prints whether
    verdict, score and score map are equal, or where and by how much they differ, and what of the machine has changed.
    Exit code 8 when one differs, 1 when one cannot be made again."""
    path, places = _places(config, database, [*(bundles or []), *([bundle] if bundle else [])])
    wanted = _select_presses(path, press_id, is_all, since)
    folder, counts = ArchiveFolder(archive or path.with_suffix(".archive")), Counter[str]()
    find = Bundles(places, SystemClock()).inspector if bundle is None else _only_of_its_part(bundle)
    is_aged = (lambda press: False) if press_id is not None else _find_aged(path, folder)
    made_again = _make_again(wanted, folder, find, picture, counts, is_aged, is_many=press_id is None)
    if bundle is not None:
        _print_changes(made_again, as_json=as_json)
    else:
        _print_differences(made_again, counts, as_json=as_json, is_many=press_id is None)
    if counts["differ"]:
        raise typer.Exit(DIFFERS)
    if counts["impossible"]:
        raise typer.Exit(1)


def _make_again(
    wanted: Iterable[KnownPress],
    folder: ArchiveFolder,
    find_inspector: _FindInspector,
    picture: Path | None,
    counts: Counter[str],
    is_aged: Callable[[KnownPress], bool],
    *,
    is_many: bool,
) -> Iterator[tuple[KnownPress, Replayed]]:
    """Judge the presses again; counts those that were `never` archived, that are `aged`, and where it is
    `impossible`."""
    for press in wanted:
        if is_many and (press.evidence is None or is_aged(press)):
            counts["never" if press.evidence is None else "aged"] += 1
            continue
        try:
            then = folder.press(press.press_id, press.evidence)
            inspector = find_inspector(then)
            if inspector is None:
                continue
            made_again = judge_again(then, folder, inspector)
            if picture is not None:
                _write_picture(
                    made_again, inspector, picture / f"{then.press_id}.png" if is_many else picture
                )
        except (ArchiveError, BundleError) as error:
            if not is_many:
                raise
            counts["impossible"] += 1
            typer.echo(printable(f"{press.press_id}  not made again: {error}"), err=True)
            continue
        yield press, made_again


def _find_aged(database: Path, folder: ArchiveFolder) -> Callable[[KnownPress], bool]:
    """Say which presses are kept no longer: gone, and older than all that are kept for their age. Of an archive that is
    empty, or elsewhere, none is aged."""
    kept = set(list_presses(folder.folder))
    with open_read_only(database, "reading of which presses people spoke") as connection:
        _, spoken_of = read_spoken_of(connection, 0)
    newest = kept - spoken_of or kept
    first = min((press.number for press in presses_since(database) if press.press_id in newest), default=0)
    return lambda press: press.number < first and press.press_id not in kept


def _print_differences(
    made_again: Iterable[tuple[KnownPress, Replayed]], counts: Counter[str], *, as_json: bool, is_many: bool
) -> None:
    """Print each press, and count those that are `equal`, and that `differ`."""
    for press, comparison in made_again:
        counts["equal" if comparison.is_equal else "differ"] += 1
        typer.echo(_as_json(press, comparison) if as_json else printable(_line(comparison)))
        for sentence in (
            ()
            if as_json
            else (*comparison.differences, *(f"may be why: {why}" for why in comparison.machine))
        ):
            typer.echo(printable(f"    {sentence}"))
    if is_many and not as_json:
        total = counts["equal"] + counts["differ"] + counts["impossible"]
        aged = f", {counts['aged']} are kept no longer" if counts["aged"] else ""
        typer.echo(
            f"{write_count(total, 'press')}: {counts['equal']} equal, {counts['differ']} differ, "
            f"{counts['impossible']} not made again; {counts['never']} others were never archived{aged}"
        )


def _print_changes(made_again: Iterable[tuple[KnownPress, Replayed]], *, as_json: bool) -> None:
    """Print the verdicts that change, and a table: rows are the verdicts then, columns those now."""
    counts: Counter[tuple[str, str]] = Counter()
    for press, comparison in made_again:
        counts[comparison.then.verdict, comparison.now.word] += 1
        if as_json:
            typer.echo(_as_json(press, comparison))
        elif comparison.now.word != comparison.then.verdict:
            typer.echo(printable(f"{press.press_id}  {_compare(comparison)}"))
    if as_json:
        return
    words = sorted({word for pair in counts for word in pair})
    changed = sum(n for (then, now), n in counts.items() if then != now)
    typer.echo(f"{write_count(counts.total(), 'press')} of this part; verdicts that change: {changed}")
    if words:
        typer.echo("then \\ now".ljust(12) + "".join(word.rjust(10) for word in words))
    for then in words:
        typer.echo(then.ljust(12) + "".join(str(counts[then, now]).rjust(10) for now in words))


def _write_picture(made_again: Replayed, inspector: Inspector, path: Path) -> None:
    then = made_again.then
    press = replace(made_again.now, press_id=then.press_id, time_ns=then.time_ns)
    draw = press_drawing(
        press, inspector.bundle, then.station, "jpeg" if path.suffix.lower() in (".jpg", ".jpeg") else "png"
    )
    if draw is None:
        typer.echo(f"{then.press_id}  has no score, so no picture", err=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(draw().sheet)


def _places(config: Path, database: Path | None, bundles: list[Path]) -> tuple[Path, list[Path]]:
    """The database, and where bundles are; where both are named no configuration is needed. Errors: ConfigError."""
    if database is not None and bundles and not config.exists():
        places = bundles
    else:
        places = [*bundles, *_configured(load_config(config))]
    return database_path(config, database), places


def _configured(config: Config) -> Iterator[Path]:
    """The station's bundles that are there, also those that may take over."""
    table = config.inspection
    for path in (
        table.bundle,
        table.bundle_folder,
        *(bundle.path for bundle in table.bundles),
        *table.shadows,
    ):
        if path is not None and path.exists():
            yield path


def _select_presses(
    database: Path, press_id: str | None, is_all: bool, since: str | None
) -> Iterable[KnownPress]:
    """Select the presses that are judged again. Errors: ConfigError, ArchiveError."""
    if sum((press_id is not None, is_all, since is not None)) != 1:
        raise ConfigError(
            "give a press id, --all or --since; one of them selects the presses that are judged again"
        )
    if press_id is not None:
        return [find_press(database, press_id)]
    return presses_since(database, None if since is None else moment_ns(since, time.time_ns()))


def _only_of_its_part(path: Path) -> _FindInspector:
    """Judge presses of the part and position of this bundle with it, and no others. Errors: BundleError."""
    inspector = Inspector(Scorer(Bundle.load(path)), SystemClock())
    part = (inspector.bundle.manifest.part, inspector.bundle.manifest.position)
    return lambda press: inspector if (press.part, press.position) == part else None


def _line(found: Replayed) -> str:
    then = found.then
    score = "" if then.score is None else f"  {then.score:.6g} / {then.threshold or 0.0:.6g}"
    return (
        f"{then.press_id}  {local_time(then.time_ns)}  {then.part}/{then.position or '-'}  {then.verdict}{score}  "
        + ("equal, bit for bit" if found.is_equal else "DIFFERS")
    )


def _compare(found: Replayed) -> str:
    then, verdict = found.then, found.now.verdict
    now = (verdict.score, verdict.threshold) if verdict else (None, None)
    return f"{then.verdict:8} {_ratio(then.score, then.threshold)}  ->  {found.now.word:8} {_ratio(*now)}"


def _ratio(score: float | None, threshold: float | None) -> str:
    """Give the ratio of a score to its limit, by which bundles can be compared."""
    return "   -  " if score is None or not threshold else f"{score / threshold:6.3f}"


def _as_json(press: KnownPress, found: Replayed) -> str:
    verdict = found.now.verdict
    return json.dumps(
        {
            "press_id": press.press_id,
            "sequence": press.number,
            "is_equal": found.is_equal,
            "verdict_then": found.then.verdict,
            "verdict": found.now.word,
            "score_then": found.then.score,
            "score": verdict.score if verdict else None,
            "threshold_then": found.then.threshold,
            "threshold": verdict.threshold if verdict else None,
            "differences": found.differences,
            "machine": found.machine,
        }
    )
