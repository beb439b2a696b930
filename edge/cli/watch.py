"""`gelgate watch`: a subscriber that prints one line per verdict and saves the heatmaps."""

import json
import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from edge.core.printable import printable, write_count
from edge.extras import needs
from edge.messaging.mqtt_broker import Broker
from edge.messaging.subscriber import broker_at, describe, receive, station_filter
from edge.messaging.subscriber import watch as listen

__all__ = ["watch"]

# A picture comes some milliseconds after its result, and may come after the next one; so many do not wait for that.
_SOON: Final = 8


def watch(
    host: Annotated[str, typer.Option(help="The broker's name or address.")] = "localhost",
    port: Annotated[int, typer.Option(help="Its port.", min=1, max=65535)] = 1883,
    prefix: Annotated[str, typer.Option(help="First level of the topics.")] = "gelgate",
    site: Annotated[str, typer.Option(help="This site only; + for all.")] = "+",
    line: Annotated[str, typer.Option(help="This line only; + for all.")] = "+",
    station: Annotated[str, typer.Option(help="This station only; + for all.")] = "+",
    save: Annotated[Path | None, typer.Option(help="Save heatmaps in this folder.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print each result as received, one JSON object per line.")
    ] = False,
    count: Annotated[
        int | None, typer.Option(help="End after this number of verdicts or checked messages.", min=1)
    ] = None,
    timeout: Annotated[float | None, typer.Option(help="End after this number of seconds.", min=0)] = None,
    validate: Annotated[
        bool, typer.Option("--validate", help="Instead check every message against its station's `asyncapi`.")
    ] = False,
    username: Annotated[str | None, typer.Option(help="User name for the broker.")] = None,
    password_file: Annotated[Path | None, typer.Option(help="File that holds the password.")] = None,
    ca: Annotated[
        Path | None, typer.Option(help="Use TLS and trust this certificate authority (PEM).")
    ] = None,
) -> None:
    """Print verdicts as they arrive, each press once.

    It ends with exit code 1 if --count is not reached in --timeout seconds, and with --validate if a message is not as
    its station describes it, or could not be checked."""
    if validate:
        needs("validate", "--validate")
    broker = broker_at(host, port, "watch", username, password_file, ca)
    topics = station_filter(prefix, site, line, station)
    if validate:
        _validate(broker, topics, count, timeout)
    else:
        _watch(broker, topics, save, count, timeout, as_json=as_json)


def _watch(
    broker: Broker,
    topics: str,
    save: Path | None,
    count: int | None,
    timeout: float | None,
    *,
    as_json: bool,
) -> None:
    results = heatmaps = missing = 0
    for seen in listen(broker, topics, save, count, timeout, _tell):
        if seen.kind == "result":
            results += 1
            line = json.dumps(seen.content) if as_json else printable(describe(seen.content, seen.station))
            print(line, flush=True)
            missing += save is not None and bool(seen.content.get("heatmap_topic"))
            if missing == _SOON:
                _tell_missing(missing)
        elif seen.kind == "heatmap":
            heatmaps += seen.content["path"] is not None
            missing = max(0, missing - 1)
        elif seen.kind == "state":
            _tell(
                f"{seen.station} is {seen.content.get('state', '?')} {seen.content.get('reason') or ''}".rstrip()
            )
        else:
            _tell(f"{seen.station} alarm {seen.content.get('alarm', '?')}: {seen.content.get('text', '')}")
    if heatmaps:
        _tell(f"{heatmaps} heatmap(s) saved in {save}")
    if missing:
        _tell_missing(missing)
    if count is not None and results < count:
        _tell(f"{results} verdict(s) arrived in {timeout:g} s, expected {count}; check that the gateway runs")
        raise typer.Exit(1)


def _tell_missing(number: int) -> None:
    """Say that pictures did not come after their results: a broker that denies a topic says nothing."""
    _tell(
        f"{write_count(number, 'heatmap')} did not come; the broker's rules must let this user read heatmap/+"
    )


def _validate(broker: Broker, topics: str, count: int | None, timeout: float | None) -> None:
    """Print every fault. count: of messages that end it."""
    from edge.messaging.validation import StationsCheck

    check, faults = StationsCheck(), 0
    try:
        for message in receive(broker, topics, timeout, _tell):
            for fault in check.see(message):
                faults += 1
                print(printable(fault), flush=True)
            if count is not None and check.checked >= count:
                break
    finally:
        print(f"{write_count(check.checked, 'message')} checked, {faults} not as described", flush=True)
        for root, number in check.undescribed.items():
            print(
                f"{printable(root)}: {write_count(number, 'message')} not checked, its topic asyncapi is empty",
                flush=True,
            )
        for root, number in check.left_out.items():
            print(
                f"{printable(root)}: {write_count(number, 'message')} not checked, too many came before its asyncapi",
                flush=True,
            )
    if faults or check.undescribed or check.left_out or (count is not None and check.checked < count):
        raise typer.Exit(1)


def _tell(sentence: str) -> None:
    print(f"gelgate: {printable(sentence)}", file=sys.stderr)
