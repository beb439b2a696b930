"""`gelgate station overview`: one still of the overview camera, and what it shows."""

from pathlib import Path
from typing import Annotated, Final

import typer

from edge import registry
from edge.cli.options import CONFIG, ConfigOption
from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import ConfigError
from edge.features.overview import read_rules, still_of

__all__ = ["overview"]

# An OAK starts in some seconds.
PATIENCE_S: Final = 20.0


def overview(
    config: ConfigOption = CONFIG,
    save: Annotated[
        Path | None, typer.Option(help="Save the still, such as the `empty` of [overview].")
    ] = None,
) -> None:
    """Print what one still of the overview camera shows.

    For setting up [overview]: the codes that are read, and how much differs from the empty station."""
    table, clock = load_config(config).overview, SystemClock()
    if table is None:
        raise ConfigError(f"configuration {config} has no [overview]; docs/operations.md shows one")
    if table.empty is not None and not table.empty.exists():  # this may be the still that becomes it
        table = table.model_copy(update={"empty": None})
    rules, camera = read_rules(table), table.opener(registry.overview(table.plugin), clock)()
    try:
        frame = camera.read(clock.monotonic_ns() + round(PATIENCE_S * 1e9))
    finally:
        camera.close()
    jpeg, grey = still_of(frame, table.max_side_px)
    view = rules.look(jpeg, grey)
    if save is not None:
        save.write_bytes(jpeg)
        typer.echo(f"saved {save}")
    changed = "no picture of it" if view.changed is None else f"{view.changed:.1%} differs"
    typer.echo(f"{grey.shape[1]}x{grey.shape[0]}; empty station: {changed}")
    for code in view.codes:
        typer.echo(
            f"{code.kind} '{code.text}': part {rules.part_in(code) or 'none, it fits no part_pattern'}"
        )
    if table.codes and not view.codes:
        typer.echo(f"no {' or '.join(table.codes)} code is read")
