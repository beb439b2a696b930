"""`gelgate export`: what comes from, or goes to, other people's tools."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["export"]

export = typer.Typer(help="Bring in trained backbones; hand out graphs.", no_args_is_help=True)


@export.callback()
def _group() -> None:
    """Bring in trained backbones; hand out graphs."""


@export.command()
def merge(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="A bundle: folder or .zip.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="What to write.")] = Path("detector.onnx"),
    trunks: Annotated[
        Path | None, typer.Option(help="Folder of <sha256>.onnx, for bundles without their trunk.")
    ] = None,
    as_bundle: Annotated[
        bool, typer.Option("--as-bundle", help="Write a bundle around the single graph instead of the file.")
    ] = False,
    overwrite: Annotated[bool, typer.Option(help="Replace what is there.")] = False,
) -> None:
    """Write one graph from frames to score map, the bank inside, after checking that it scores the same."""
    from edge.bundle import Bundle
    from edge.core.errors import ConfigError
    from export.merge import merge_bundle

    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or pass --overwrite")
    difference = merge_bundle(Bundle.load(bundle, trunks), output, as_bundle=as_bundle)
    typer.echo(f"{output} written; at most {difference:.1e} of the largest score apart from the bundle")
