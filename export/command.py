"""`gelgate export`: weights from other tools in, graphs for other tools out."""

from pathlib import Path
from typing import Annotated

import typer

from export.backbone_command import backbone
from export.importers.command import detect, import_
from export.parity_command import openvino, parity
from export.precision_command import precision

__all__ = ["export"]

export = typer.Typer(help="Import trained backbones, or write graphs.", no_args_is_help=True)


@export.callback()
def _group() -> None:
    """Import trained backbones, or write graphs."""


export.command()(backbone)
export.command()(precision)
export.command("detect")(detect)
export.command("import")(import_)
export.command()(parity)
export.command()(openvino)


@export.command()
def tiles(
    trunk: Annotated[Path, typer.Argument(help="A trunk .onnx file, or an installed backbone's name.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The trunk to write.")] = Path("tiled.onnx"),
    frame: Annotated[str, typer.Option(help="Size of the inspected region, WIDTHxHEIGHT.")] = "1280x720",
    size: Annotated[int, typer.Option(min=32, help="Width and height of a tile in pixels.")] = 224,
    overlap: Annotated[int, typer.Option(min=0, help="Least overlap of neighbouring tiles in pixels.")] = 56,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Make a trunk for large frames from overlapping tiles.

    Each tile is processed as a small frame."""
    from edge import registry
    from edge.core.errors import ConfigError
    from edge.core.imaging.tiles import tiling
    from plugins.backbones.tiled import tile_trunk

    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or pass --overwrite")
    try:
        width, height = (int(number) for number in frame.split("x"))
        layout = tiling((height, width), size, overlap)
    except ValueError as error:
        raise ConfigError(f"--frame {frame}: {error}") from error
    if not trunk.is_file() and str(trunk) not in registry.names("backbones"):
        known = ", ".join(registry.names("backbones"))
        raise ConfigError(f"{trunk} is neither a file nor an installed backbone ({known})")
    plain = trunk.read_bytes() if trunk.is_file() else registry.backbone(str(trunk)).trunk()
    output.write_bytes(tile_trunk(plain, layout))
    typer.echo(
        f"{output}: {len(layout)} tiles of {size} over {frame}, rows {layout.rows}, columns {layout.columns}"
    )


@export.command()
def merge(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="A bundle: folder or .zip.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="What to write.")] = Path("detector.onnx"),
    trunks: Annotated[
        Path | None, typer.Option(help="Folder of <sha256>.onnx files, for bundles without their trunk.")
    ] = None,
    as_bundle: Annotated[
        bool, typer.Option("--as-bundle", help="Write a bundle with the single graph instead of the file.")
    ] = False,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file or bundle.")] = False,
) -> None:
    """Write one graph from frames to score map.

    It contains the bank. It is checked first: its scores must be those of the bundle."""
    from edge.core.errors import ConfigError
    from edge.model.bundle import Bundle
    from export.merge import merge_bundle

    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or pass --overwrite")
    difference = merge_bundle(Bundle.load(bundle, trunks), output, as_bundle=as_bundle)
    typer.echo(
        f"{output} written; it differs from the bundle by at most {difference:.1e} of the largest score"
    )
