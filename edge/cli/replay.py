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
from edge.core.printable import printable
from edge.features.black_box.replay import Bundles, Replayed, replayed
from edge.gateway.recorder import heatmap_png
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.store.press_archive import ArchivedPress, ArchiveFolder, KnownPress, find_press, presses_since

__all__ = ["DIFFERS", "replay"]

DIFFERS = 8

_InspectorOf = Callable[[ArchivedPress], Inspector | None]


def replay(
    press_id: Annotated[
        str | None, typer.Argument(metavar="[PRESS_ID]", help="A press_id, or its beginning.")
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
        typer.Option(help="Write the picture as this .png; for several presses, into this folder."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
) -> None:
    """Make verdicts again, bit for bit.

    From the archived camera bytes, by the bundle with the recorded hash and as many threads as then. Prints whether
    verdict, score and score map are equal, or where and by how much they differ, and what of the machine has changed.
    Exit code 8 when one differs, 1 when one cannot be made again."""
    path, places = _places(config, database, [*(bundles or []), *([bundle] if bundle else [])])
    wanted = _select_presses(path, press_id, is_all, since)
    folder = ArchiveFolder(archive or path.with_suffix(".archive"))
    run = _Run(folder, picture, as_json, is_many=press_id is None)
    if bundle is None:
        run.again(wanted, places)
    else:
        run.otherwise(wanted, bundle)
    if run.differing and bundle is None:
        raise typer.Exit(DIFFERS)
    if run.impossible:
        raise typer.Exit(1)


class _Run:
    """One call: what is printed, and how it ends. differing, impossible: presses."""

    def __init__(self, folder: ArchiveFolder, picture: Path | None, as_json: bool, is_many: bool) -> None:
        self.differing = self.impossible = self.equal = self.never = 0
        self._folder, self._picture, self._as_json, self._is_many = folder, picture, as_json, is_many

    def again(self, wanted: Iterable[KnownPress], places: list[Path]) -> None:
        """Judge again with the bundles that judged."""
        bundles = Bundles(places, SystemClock())
        for press, replayed_press in self._each(wanted, bundles.inspector):
            self.equal += replayed_press.is_equal
            self.differing += not replayed_press.is_equal
            self._print(press, replayed_press)
        if self._is_many and not self._as_json:
            typer.echo(
                f"{self.equal + self.differing + self.impossible} presses: {self.equal} equal, {self.differing} "
                f"differ, {self.impossible} not made again; {self.never} others were never archived"
            )

    def otherwise(self, wanted: Iterable[KnownPress], path: Path) -> None:
        """Judge with another bundle: print the verdicts that change, and how many of each kind."""
        inspector = Inspector(Scorer(Bundle.load(path)), SystemClock())
        counts: Counter[tuple[str, str]] = Counter()
        for press, replayed_press in self._each(wanted, _same_part(inspector)):
            counts[replayed_press.then.verdict, replayed_press.now.word] += 1
            if self._as_json:
                self._print(press, replayed_press)
            elif replayed_press.now.word != replayed_press.then.verdict:
                self.differing += 1
                typer.echo(printable(f"{press.press_id}  {_side(replayed_press)}"))
        if not self._as_json:
            _print_table(counts)

    def _each(
        self, wanted: Iterable[KnownPress], inspector_of: _InspectorOf
    ) -> Iterator[tuple[KnownPress, Replayed]]:
        for press in wanted:
            if press.evidence is None and self._is_many:
                self.never += 1
                continue
            try:
                then = self._folder.press(press.press_id, press.evidence)
                inspector = inspector_of(then)
                if inspector is None:
                    continue
                replayed_press = replayed(then, self._folder, inspector)
                self._write_picture(replayed_press, inspector)
            except (ArchiveError, BundleError) as error:
                if not self._is_many:
                    raise
                self.impossible += 1
                typer.echo(printable(f"{press.press_id}  not made again: {error}"), err=True)
                continue
            yield press, replayed_press

    def _print(self, press: KnownPress, found: Replayed) -> None:
        if self._as_json:
            typer.echo(_as_json(press, found))
            return
        typer.echo(printable(_line(found)))
        for sentence in found.differences:
            typer.echo(printable(f"    {sentence}"))
        for sentence in found.machine:
            typer.echo(printable(f"    may be why: {sentence}"))

    def _write_picture(self, found: Replayed, inspector: Inspector) -> None:
        if self._picture is None:
            return

        then = found.then
        press = replace(found.now, press_id=then.press_id, time_ns=then.time_ns)
        png = heatmap_png(press, inspector.bundle, then.station)
        if png is None:
            typer.echo(f"{then.press_id}  has no score, so no picture", err=True)
            return
        if self._is_many:
            self._picture.mkdir(parents=True, exist_ok=True)
        path = self._picture / f"{then.press_id}.png" if self._is_many else self._picture
        path.write_bytes(png)


def _places(config: Path, database: Path | None, bundles: list[Path]) -> tuple[Path, list[Path]]:
    """The database, and where bundles are; where both are named no configuration is needed. Errors: ConfigError."""
    if database is not None and bundles and not config.exists():
        places = bundles
    else:
        places = [*bundles, *_configured(load_config(config))]
    return database_path(config, database), places


def _configured(config: Config) -> Iterator[Path]:
    """The station's bundles that are there."""
    table = config.inspection
    for path in (table.bundle, table.bundle_folder, *(bundle.path for bundle in table.bundles)):
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


def _same_part(inspector: Inspector) -> _InspectorOf:
    """The inspector for presses of its own part and position, none for others."""
    part = (inspector.bundle.manifest.part, inspector.bundle.manifest.position)
    return lambda press: inspector if (press.part, press.position) == part else None


def _line(found: Replayed) -> str:
    then = found.then
    score = "" if then.score is None else f"  {then.score:.6g} / {then.threshold or 0.0:.6g}"
    return (
        f"{then.press_id}  {local_time(then.time_ns)}  {then.part}/{then.position or '-'}  {then.verdict}{score}  "
        + ("equal, bit for bit" if found.is_equal else "DIFFERS")
    )


def _side(found: Replayed) -> str:
    then, verdict = found.then, found.now.verdict
    now = (verdict.score, verdict.threshold) if verdict else (None, None)
    return f"{then.verdict:8} {_ratio(then.score, then.threshold)}  ->  {found.now.word:8} {_ratio(*now)}"


def _ratio(score: float | None, threshold: float | None) -> str:
    """Give the ratio of a score to its limit, by which bundles can be compared."""
    return "   -  " if score is None or not threshold else f"{score / threshold:6.3f}"


def _print_table(counts: dict[tuple[str, str], int]) -> None:
    """Rows: the verdict then; columns: the verdict now."""
    words = sorted({word for pair in counts for word in pair})
    changed = sum(n for (then, now), n in counts.items() if then != now)
    typer.echo(f"{sum(counts.values())} presses of this part: {changed} verdicts change")
    if words:
        typer.echo("then \\ now".ljust(12) + "".join(word.rjust(10) for word in words))
    for then in words:
        typer.echo(then.ljust(12) + "".join(str(counts.get((then, now), 0)).rjust(10) for now in words))


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
