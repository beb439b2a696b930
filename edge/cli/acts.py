"""`gelgate station acts`: requests to the station and their outcomes, newest first."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.clock import local_time
from edge.core.printable import printable
from edge.store.acts import Act, newest
from edge.store.database import open_read_only

__all__ = ["acts"]


def acts(
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    count: Annotated[int, typer.Option(help="The newest of this number.", min=1)] = 20,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
) -> None:
    """Show who asked the station for what.

    Every request with its outcome, and the gel before and after."""
    with open_read_only(database_path(config, database), "reading the acts") as connection:
        requests = newest(connection, count)
    for act in requests:
        typer.echo(json.dumps(asdict(act)) if as_json else _line(act))
    if not requests and not as_json:
        typer.echo("nothing was asked of this station yet")


def _line(act: Act) -> str:
    words = [
        local_time(act.time_ns),
        act.verb,
        act.outcome or "interrupted",
        f"for {act.who}",
        *(f"{key}={value!r}" for key, value in act.arguments.items() if value not in (None, "")),
    ]
    if act.before is not None and act.after is not None:
        changes = ((key, act.before.get(key), value) for key, value in act.after.items())
        words += [f"{key}: {before!r} -> {after!r}" for key, before, after in changes if before != after]
    elif act.after is not None:
        words += [f"{key}: {value!r}" for key, value in act.after.items()]
    return printable("  ".join([*words, *([act.sentence] if act.sentence else [])]))
