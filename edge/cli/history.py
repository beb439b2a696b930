"""`gelgate history`: which presses were made, by time, part, gel and verdict; as lines, JSON, CSV or Parquet."""

import datetime
import json
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer

from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.clock import local_time
from edge.config import load_config
from edge.core.errors import ConfigError
from edge.core.person_verdict import Agreement
from edge.core.press import ShadowVerdict
from edge.core.printable import printable, score_texts, write_count
from edge.core.reference_press.charts import newest_begin
from edge.core.shadow import JudgedTwice, Weighing
from edge.core.suggest import suggestion
from edge.core.verdict import Cause
from edge.extras import needs
from edge.messaging.deviation_payload import DeviationPlace
from edge.store.history import (
    MEASURED,
    HistoryQuery,
    HistoryRow,
    count_verdicts,
    list_parts,
    read_history,
    write_history,
)
from edge.store.press_store import VERDICTS

__all__ = ["history", "moment_ns"]

# Without --count and --output, this number of presses is printed.
PRINTED: Final = 20

_MOMENT: Final = "a date, a time as 2026-01-31T06:00 (local unless it names a zone), or an age as 8h, 7d"


def history(
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    since: Annotated[str | None, typer.Option(help=f"From this moment on: {_MOMENT}.")] = None,
    until: Annotated[str | None, typer.Option(help="Before this moment, given in the same way.")] = None,
    part: Annotated[str | None, typer.Option(help="This part only.")] = None,
    position: Annotated[str | None, typer.Option(help="This position only.")] = None,
    serial: Annotated[str | None, typer.Option(help="This sensor only.")] = None,
    gel: Annotated[str | None, typer.Option(help="This gel only: its id, or its own serial.")] = None,
    verdict: Annotated[
        list[str] | None,
        typer.Option(
            help="These verdicts only: pass, fail, unsure, rejected; error for a press without one."
        ),
    ] = None,
    count: Annotated[
        int | None, typer.Option(help="The newest of this number; 20 without --output.", min=1)
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write this .csv or .parquet file; all that fit.")
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(
            help="Print yield, false alarms and escapes for each: day, shift, part or gel; all that fit. shadow: of "
            "each shadow, and of the bundle beside it, with the presses that differ."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
) -> None:
    """Show which presses were made.

    Oldest first, with the totals of all that fit. The gateway may run meanwhile. Each press is one row: number, time,
    part, position, verdict, cause: part or gel, score, threshold, gel, and what a person said of it. With --json and
    --output it has its id and sensor too."""
    _check_groups(by, is_for_people=not as_json and output is None)
    if output is not None and output.suffix.lower() == ".parquet":
        needs("parquet", f"writing {output}")
    query = HistoryQuery(
        *_period(since, until),
        part,
        position,
        serial,
        gel,
        _verdicts(verdict or []),
        count if output or count or by else PRINTED,
    )
    rows = read_history(path := database_path(config, database), query)
    if by == "shadow":
        _print_shadows(rows)
    elif by is not None:
        _print_agreement(rows, _GROUPS[by], _shifts(config) if by == "shift" else ())
    elif output is not None:
        typer.echo(f"{write_count(write_history(output, rows), 'press')} in {output}")
    elif as_json:
        _print_json(rows, count_verdicts(path, query) if count is None else {})
    else:
        _print(rows, count_verdicts(path, query) if count is None else None, path)


def _period(since: str | None, until: str | None) -> tuple[int | None, int | None]:
    """Read both ends, in nanoseconds since 1970; None for one that is open. Errors: ConfigError."""
    now_ns = time.time_ns()
    since_ns, until_ns = (None if text is None else moment_ns(text, now_ns) for text in (since, until))
    if since_ns is not None and until_ns is not None and since_ns >= until_ns:
        raise ConfigError(f"--since {since} is not before --until {until}: no press can fit")
    return since_ns, until_ns


def _check_groups(by: str | None, *, is_for_people: bool) -> None:
    """Check what is printed for each. Errors: ConfigError."""
    if by is None:
        return
    if by not in (*_GROUPS, "shadow"):
        raise ConfigError(f"presses have no '{by}'; {suggestion(by, (*_GROUPS, 'shadow'))}")
    if not is_for_people:
        raise ConfigError("--by prints lines for people; leave out --json and --output, or --by")


def moment_ns(text: str, now_ns: int) -> int:
    """The wall-clock nanoseconds that a person means, within 64 bits. Errors: ConfigError."""
    if age := re.fullmatch(r"(\d{1,6})([smhd])", text):
        return now_ns - int(age[1]) * {"s": 1, "m": 60, "h": 3600, "d": 86400}[age[2]] * 10**9
    try:
        meant_ns = round(datetime.datetime.fromisoformat(text).timestamp() * 1e6) * 1000
    except (ValueError, OverflowError):
        raise ConfigError(f"'{text}' is no moment; give {_MOMENT}") from None
    return max(-(2**63), min(meant_ns, 2**63 - 1))


def _verdicts(given: list[str]) -> tuple[str, ...]:
    """Check the verdicts. Errors: ConfigError with the nearest one."""
    for word in given:
        if word not in VERDICTS:
            raise ConfigError(f"no press has the verdict '{word}'; {suggestion(word, VERDICTS)}")
    return tuple(given)


def _shifts(config: Path) -> Sequence[datetime.time]:
    """Read when shifts begin. Errors: ConfigError without any."""
    shifts = load_config(config).reference.shifts
    if not shifts:
        raise ConfigError(
            f'{config} has no shifts; give their local times under [reference], as shifts = ["06:00"]'
        )
    return shifts


def _shift_of(row: HistoryRow, shifts: Sequence[datetime.time]) -> str:
    """Name the shift by its day and begin."""
    moment = datetime.datetime.fromtimestamp(row.time_ns / 1e9).astimezone()
    return f"{newest_begin(moment, shifts, None):%Y-%m-%d %H:%M}"


_GROUPS: Final[Mapping[str, Callable[[HistoryRow, Sequence[datetime.time]], str]]] = {
    "day": lambda row, shifts: f"{datetime.datetime.fromtimestamp(row.time_ns / 1e9):%Y-%m-%d}",
    "shift": _shift_of,
    "part": lambda row, shifts: f"{row.part}/{row.position or '-'}",
    "gel": lambda row, shifts: f"gel {row.gel_id}",
}


def _print_agreement(
    rows: Iterable[HistoryRow],
    name: Callable[[HistoryRow, Sequence[datetime.time]], str],
    shifts: Sequence[datetime.time],
) -> None:
    groups: dict[str, Agreement] = defaultdict(Agreement)
    for row in rows:
        groups[name(row, shifts)].add(row.verdict, row.person_verdict)
    for group, agreement in groups.items():
        typer.echo(printable(f"{group}: {agreement.describe()}"))
    if not groups:
        typer.echo("no press fits")


def _print_shadows(rows: Iterable[HistoryRow]) -> None:
    pairs: dict[tuple[str, str], list[JudgedTwice]] = defaultdict(list)
    for row in rows:
        if row.shadow is not None:
            shadow_verdict = ShadowVerdict.decode(row.shadow)
            saying = row.person_verdict
            press = JudgedTwice(
                row.press_id, row.verdict, shadow_verdict.verdict, saying, saying == "damaged"
            )
            pairs[shadow_verdict.bundle_id, shadow_verdict.beside].append(press)
    for (shadow, beside), presses in pairs.items():
        weighing = Weighing(presses)
        typer.echo(f"shadow {shadow[:12]} beside {beside[:12]}: {weighing.describe()}")
        for press in weighing.differing[-PRINTED:]:
            said_of_it = f"  ({press.saying})" if press.saying else ""
            typer.echo(f"  {press.press_id}  {press.verdict}, shadow {press.other}{said_of_it}")
    if not pairs:
        typer.echo("no press that fits was judged by a shadow")


def _print_json(rows: Iterable[HistoryRow], totals: Mapping[str, int]) -> None:
    """Print a line for each press. totals: of all that fit; empty where a number of them was asked for."""
    printed = 0
    for row in rows:
        typer.echo(json.dumps(asdict(row)))
        printed += 1
    if printed < (fitting := sum(totals.values())):
        typer.echo(f"gelgate: hint: the newest {printed} of {fitting} presses; --count gives more", err=True)


def _print(rows: Iterable[HistoryRow], totals: Mapping[str, int] | None, database: Path) -> None:
    """Print a line for each press, and one of totals. totals: of all that fit; None counts the printed ones."""
    printed: Counter[str] = Counter()
    for row in rows:
        typer.echo(_line(row))
        printed[row.verdict] += 1
    counted = Counter(printed if totals is None else totals)
    words = ", ".join(f"{n} {verdict}" for verdict, n in sorted(counted.items()))
    more = f"; the newest {printed.total()} are listed" if counted.total() > printed.total() else ""
    if counted:
        typer.echo(f"{write_count(counted.total(), 'press')}: {words}{more}")
    else:
        known = ", ".join(list_parts(database)) or "nothing yet"
        typer.echo(printable(f"no press fits; there are presses of {known}"))


def _line(row: HistoryRow) -> str:
    score = ""
    if row.score is not None and row.threshold is not None:
        score = "  " + " / ".join(score_texts(row.score, row.threshold))
    cause = f" ({'part or gel' if row.cause == Cause.UNSURE else row.cause})" if row.cause else ""
    words = " ".join(filter(None, (row.person_verdict, row.damage_kind)))
    piece = f"  piece {row.piece_id}" if row.piece_id else ""
    shadow = f"  shadow {ShadowVerdict.decode(row.shadow).verdict}" if row.shadow else ""
    measured = str(DeviationPlace(**{name: getattr(row, name) for name in MEASURED}))
    return printable(
        f"{row.number}  {local_time(row.time_ns)}  {row.part}/{row.position or '-'}  {row.verdict}{cause}{score}"
        f"  gel {row.gel_id}{f'  {row.person}: {words}' if words else ''}{shadow}{piece}"
        f"{f'  {measured}' if measured else ''}"
    )
