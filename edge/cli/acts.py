"""`gelgate acts`: requests to the station and their outcomes, newest first."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from edge.store.acts import Act

__all__ = ["acts"]


def acts(
    config: Annotated[Path, typer.Option("--config", "-c", help="The station's TOML file.")] = Path(
        "gelgate.toml"
    ),
    database: Annotated[
        Path | None, typer.Option(help="A database file instead of the one that the configuration names.")
    ] = None,
    count: Annotated[int, typer.Option(help="The newest of this number.", min=1)] = 20,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
) -> None:
    """Show who asked the station for what.

    Every request with its outcome, and the gel before and after."""
    import json
    from dataclasses import asdict

    from edge.config import load_config
    from edge.core.errors import ConfigError
    from edge.store.press_store import Store

    path = database or load_config(config).store.path
    if not path.is_file():
        raise ConfigError(f"database {path} does not exist; the gateway makes it at its first run")
    with Store(path) as store:
        found = store.acts(count)
    for act in found:
        typer.echo(json.dumps(asdict(act)) if as_json else _line(act))
    if not found and not as_json:
        typer.echo("nothing was asked of this station yet")


def _line(act: "Act") -> str:
    from edge.core.printable import printable
    from edge.messaging.payload_base import iso_time

    words = [
        iso_time(act.time_ns)[:19],
        act.verb,
        act.outcome or "interrupted",
        f"for {act.who}",
        *(f"{key}={value!r}" for key, value in act.arguments.items() if value not in (None, "")),
    ]
    if act.before is not None and act.after is not None:
        words += [f"{key}: {act.before.get(key)!r} -> {act.after[key]!r}" for key in _changed(act)]
    return printable("  ".join([*words, *([act.sentence] if act.sentence else [])]))


def _changed(act: "Act") -> list[str]:
    before, after = act.before or {}, act.after or {}
    return [key for key in after if after[key] != before.get(key)]
