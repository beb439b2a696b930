"""`gelgate station reference`: ask a running station for a reference press, and show the control charts."""

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Final, TypeVar

import typer

from edge.cli.gel import user
from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.clock import SystemClock, local_time
from edge.config import Config, load_config
from edge.config.feature_tables import ReferenceTable
from edge.core.errors import ConfigError, GelgateError
from edge.core.ports import Clock
from edge.core.printable import printable, score_texts, write_count
from edge.core.reference_press.charts import MEASURES, Chart, ReferencePress, charts, judge
from edge.core.reference_press.outcome import Outcome
from edge.messaging.payload_base import iso_time
from edge.messaging.reference_message import describe_chart
from edge.pictures.control_chart import control_charts_svg
from edge.store import reference_presses as table
from edge.store.acts import Act
from edge.store.database import refuse_left_journal
from edge.store.press_store import Store
from edge.store.reference_presses import PieceKey, ReferenceRequest, read_pieces
from edge.store.ulid import new_ulid

__all__ = ["reference", "request_press"]

T = TypeVar("T")

reference = typer.Typer(help="Press a master piece, or show its control charts.", no_args_is_help=True)

# A gateway looks for requests twice a second; a busy machine may take longer.
TAKEN_WITHIN_S: Final = 30.0
LOOK_S: Final = 0.2


@reference.command()
def press(
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    piece: Annotated[str | None, typer.Option(help="The master piece, where there are several.")] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Begin its charts again: the fixture was changed on purpose.")
    ] = False,
    timeout: Annotated[float, typer.Option(min=1, help="Wait this long for the press, in seconds.")] = 120.0,
) -> None:
    """Make the next press of a running station a reference press.

    It is asked for through the station's database, so on the same machine. Exit code 1 where the press is out of
    limits, has no score, or does not come."""
    loaded = None if database is not None else load_config(config)
    if loaded is not None and not loaded.reference.pieces:
        raise ConfigError(f"{config} names no master piece; name one under [[reference.pieces]]")
    path = database_path(config, database)
    refuse_left_journal(path)
    clock = SystemClock()
    now_ns = clock.time_ns()
    wish = ReferenceRequest(new_ulid(now_ns), f"{user()}, command line", piece, restart, now_ns)
    with Store(path) as store:
        judgement = judge(request_press(store, clock, wish, typer.echo, timeout), _learn(loaded, None))
    typer.echo("\n".join([judgement.outcome.value.replace("_", " "), *judgement.sentences]))
    if judgement.outcome in (Outcome.OUT_OF_LIMITS, Outcome.NOT_MEASURED):
        raise typer.Exit(1)


@reference.command()
def chart(
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    part: Annotated[str | None, typer.Option(help="This part only.")] = None,
    piece: Annotated[str | None, typer.Option(help="This master piece only.")] = None,
    count: Annotated[int, typer.Option(help="Print the newest of this number.", min=1)] = 20,
    learn: Annotated[
        int | None,
        typer.Option(help="Presses of which the limits are made; the configured number by default.", min=2),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write this .csv or .svg file; .svg: of one master piece."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per master piece.")] = False,
) -> None:
    """Show the reference presses with their control charts.

    For each measure: limits, and the presses with what they said. The gateway may run meanwhile."""
    loaded = None if database is not None else load_config(config)
    known = read_pieces(database_path(config, database))
    chosen = {
        key: presses
        for key, presses in known.items()
        if part in (None, key.part) and piece in (None, key.piece)
    }
    if not chosen:
        typer.echo(_nothing_text(list(known)))
    elif output is not None:
        _write(output, chosen, _learn(loaded, learn))
    else:
        for key, presses in chosen.items():
            show = _json_line if as_json else partial(_piece_text, count=count)
            typer.echo(show(key, presses, _learn(loaded, learn)))


def request_press(
    store: Store,
    clock: Clock,
    wish: ReferenceRequest,
    say: Callable[[str], None],
    timeout_s: float,
) -> list[ReferencePress]:
    """Ask for a reference press and wait for it; returns the presses of its piece, of which it is the last.

    say: gets what the person does next. Errors: GelgateError for a request that is not taken or is refused, or a press
    that does not come; StoreError.
    """
    before = store.read("reading the reference presses", table.newest_number)
    store.write("asking for a reference press", partial(table.ask, wish=wish))
    say(f"asked; a gateway takes it within {TAKEN_WITHIN_S:g} s while the gel is free")

    def outcome() -> Act | None:
        return next((act for act in store.acts() if act.request == wish.request), None)

    act = _waited(clock, TAKEN_WITHIN_S, outcome)
    if act is None:
        store.write("withdrawing a request", partial(table.withdraw, request=wish.request))
        raise GelgateError(
            f"no gateway took the request within {TAKEN_WITHIN_S:g} s; one must run on database {store.path}, and the "
            "gel must be free; a gateway that was started before its configuration named the master piece must be "
            "restarted"
        )
    if act.outcome == "refused":
        raise GelgateError(str(act.sentence))
    say(f"press the master piece {wish.piece or ''}".rstrip())
    doing = "reading the reference presses"
    presses = _waited(clock, timeout_s, lambda: store.read(doing, partial(table.after, number=before)))
    if presses is None:
        raise GelgateError(f"no reference press came within {timeout_s:g} s; ask again")
    return presses


def _waited(clock: Clock, timeout_s: float, found: Callable[[], T | None]) -> T | None:
    """The first thing that is found, or None when the time is over."""
    end_ns = clock.monotonic_ns() + round(timeout_s * 1e9)
    while (finding := found()) is None and clock.monotonic_ns() <= end_ns:
        clock.sleep(LOOK_S)
    return finding


def _learn(loaded: Config | None, learn: int | None) -> int:
    return learn or (loaded.reference if loaded is not None else ReferenceTable()).learn


def _write(output: Path, chosen: Mapping[PieceKey, list[ReferencePress]], learn: int) -> None:
    """Write the charts. Errors: ConfigError for an unknown ending, and for an .svg of several master pieces."""
    if output.suffix == ".csv":
        text = _csv_text(chosen, learn)
    elif output.suffix != ".svg":
        raise ConfigError(f"the ending of {output} names no format; known are .csv, .svg")
    elif len(chosen) > 1:
        names = "; ".join(map(str, chosen))
        raise ConfigError(f"an .svg shows one master piece, found {names}; choose with --piece and --part")
    else:
        ((key, presses),) = chosen.items()
        text = control_charts_svg(charts(presses, learn), str(key))
    output.write_text(text, encoding="utf-8")
    typer.echo(f"{write_count(sum(map(len, chosen.values())), 'reference press')} in {output}")


def _nothing_text(known: Sequence[PieceKey]) -> str:
    """Say that no press was chosen, and which pieces there are."""
    if not known:
        return "no reference press was made yet; ask for one with `gelgate station reference press`"
    return printable(f"no such master piece was pressed; there are {'; '.join(map(str, known))}")


def _piece_text(key: PieceKey, presses: Sequence[ReferencePress], learn: int, count: int) -> str:
    """The limits of each measure, then the newest presses, oldest first."""
    lines = [f"master piece {key}: {write_count(len(presses), 'press')}", ""]
    lines += [_chart_line(chart) for chart in charts(presses, learn)]
    shown = range(max(0, len(presses) - count), len(presses))
    lines += ["", *(_press_line(presses[: number + 1], learn) for number in shown)]
    return "\n".join(map(printable, lines))


def _json_line(key: PieceKey, presses: Sequence[ReferencePress], learn: int) -> str:
    """Write one object: the piece, its charts, what the newest press says, and the presses."""
    judgement = judge(presses, learn)
    return json.dumps(
        {
            **key._asdict(),
            "outcome": judgement.outcome,
            "sentences": judgement.sentences,
            "charts": [describe_chart(chart).model_dump(mode="json") for chart in judgement.charts],
            "presses": [asdict(press) for press in presses],
        }
    )


def _csv_text(chosen: Mapping[PieceKey, Sequence[ReferencePress]], learn: int) -> str:
    """Write one row for each press, with what it said when it was made. An empty cell is a missing value."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [measure.name for measure in MEASURES]
    origin = ["press_id", "gel_id", "bundle_id", "expected", "verdict"]
    writer.writerow(["time", *PieceKey._fields, *origin, "outcome", "threshold", *names, "sentences"])
    for key, presses in chosen.items():
        for number, press in enumerate(presses, start=1):
            judgement = judge(presses[:number], learn)
            values = [*(getattr(press, name) for name in origin), judgement.outcome.value, press.threshold]
            values += [press.value(measure) for measure in MEASURES]
            writer.writerow([iso_time(press.time_ns), *key, *values, "; ".join(judgement.sentences)])
    return out.getvalue()


def _chart_line(chart: Chart) -> str:
    name = f"{chart.measure.title} ({chart.measure.unit})" if chart.measure.unit else chart.measure.title
    limits = chart.limits
    if limits is None:
        return f"  {name:18} {chart.values[-1]:10.4g}  limits are learnt: {chart.learnt} of {chart.learn}"
    signals_text = "  ".join(signal.value.replace("_", " ") for signal in chart.signals)
    return (
        f"  {name:18} {chart.values[-1]:10.4g}  limits {limits.low:.4g} to {limits.high:.4g}, centre "
        f"{limits.centre:.4g}  {signals_text}"
    ).rstrip()


def _press_line(presses: Sequence[ReferencePress], learn: int) -> str:
    newest, judgement = presses[-1], judge(presses, learn)
    score = (
        ""
        if newest.score is None or newest.threshold is None
        else "  " + " / ".join(score_texts(newest.score, newest.threshold))
    )
    words = [f"{local_time(newest.time_ns)}  {newest.verdict}{score}  gel {newest.gel_id}"]
    words += [judgement.outcome.value.replace("_", " "), *judgement.sentences]
    return "  ".join(words)
