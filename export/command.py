"""`gelgate export`: weights from other tools in, graphs for other tools out."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["export"]

export = typer.Typer(help="Import trained backbones, or write graphs.", no_args_is_help=True)


@export.callback()
def _group() -> None:
    """Import trained backbones, or write graphs."""


@export.command()
def backbone(
    checkpoint: Annotated[Path, typer.Argument(help="A .pth file of weights in torchvision's naming.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The trunk to write.")] = Path("trunk.onnx"),
    topology: Annotated[str, typer.Option(help="resnet18, resnet50 or wide_resnet50_2.")] = "wide_resnet50_2",
    taps: Annotated[
        str, typer.Option(help="Feature maps to output, by torchvision's names.")
    ] = "layer1,layer2,layer3",
    mean: Annotated[str, typer.Option(help="Subtracted from RGB in 0..1.")] = "0.485,0.456,0.406",
    std: Annotated[str, typer.Option(help="Then RGB is divided by this.")] = "0.229,0.224,0.225",
    half: Annotated[bool, typer.Option(help="Store the weights as float16: half the file.")] = False,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Convert a PyTorch checkpoint to an ONNX trunk.

    It needs PyTorch, but not torchvision."""
    from edge.core.errors import ConfigError
    from edge.extras import needs
    from export.backbone import export_backbone

    needs("train", "export backbone")
    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or pass --overwrite")
    facts = export_backbone(
        checkpoint,
        output,
        topology,
        tuple(tap.strip() for tap in taps.split(",") if tap.strip()),
        mean=_three("--mean", mean),
        std=_three("--std", std),
        weights="float16" if half else "float32",
    )
    typer.echo(f"{output}: {topology}, {taps}, {int(facts['bytes']) / 1e6:.1f} MB")
    typer.echo(f"weights sha256 {facts['weights_sha256']}")
    typer.echo(f"trunk   sha256 {facts['trunk_sha256']}")


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
    from edge.extras import needs
    from plugins.backbones.tiled import tile_trunk

    needs("export", "export tiles")
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
    from edge.extras import needs
    from edge.model.bundle import Bundle
    from export.merge import merge_bundle

    needs("export", "export merge")
    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or pass --overwrite")
    difference = merge_bundle(Bundle.load(bundle, trunks), output, as_bundle=as_bundle)
    typer.echo(
        f"{output} written; it differs from the bundle by at most {difference:.1e} of the largest score"
    )


def _three(option: str, text: str) -> tuple[float, float, float]:
    """Three numbers, red, green, blue. Errors: ConfigError."""
    import math

    from edge.core.errors import ConfigError

    try:
        red, green, blue = (float(number) for number in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option} is three numbers such as 0.485,0.456,0.406, found '{text}'") from error
    if not all(math.isfinite(value) for value in (red, green, blue)) or (
        option == "--std" and min(red, green, blue) <= 0
    ):
        raise ConfigError(f"{option} holds numbers that cannot scale a picture: '{text}'")
    return red, green, blue
