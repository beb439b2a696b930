"""`gelgate export`: weights from other tools in, graphs for other tools out."""

from pathlib import Path
from typing import Annotated, get_args

import typer

from calibration.dataset import open_dataset, resolution_of
from calibration.fitting.command import refuse_existing, resolve_sources
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.presses.sources import is_dataset
from calibration.progress import Stages
from edge import registry
from edge.cli.options import BundlePath, TrunkStore
from edge.core.arrays import U8
from edge.core.errors import BundleError, ConfigError
from edge.core.imaging.tiles import tiling
from edge.extras import needs
from edge.model.bundle import Bundle
from edge.model.bundle_writer import write_bundle, write_file
from export.backbone_command import backbone
from export.bundle_stages import compare_bundle
from export.importers.command import detect, import_
from export.merge import merge_bundle
from export.openvino_model import write_openvino
from export.precision import (
    Masked,
    Measured,
    Precision,
    Precisions,
    choose_precision,
    in_precision,
    measure_precisions,
)
from plugins.backbones.tiled import tile_trunk

__all__ = ["export", "precision"]


def precision(
    bundle: BundlePath,
    sources: Annotated[
        list[Path], typer.Argument(metavar="SOURCE...", help="Nominal presses of the part, as for `fit`.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The bundle to write.")],
    wanted: Annotated[
        str,
        typer.Option(
            "--precision", help="float32, float16 (storage), int8, or auto: the best on this machine."
        ),
    ] = "auto",
    limit: Annotated[
        float, typer.Option(help="Allowed relative difference of the score maps in int8.")
    ] = 0.05,
    threads: Annotated[int, typer.Option(min=1, max=64, help="Threads of the runtime.")] = 2,
    trunks: TrunkStore = None,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing bundle.")] = False,
) -> None:
    """Store a bundle's network in float16 or int8.

    Difference, time and size are measured on nominal presses, and AU-PRO where a source is a dataset with masks."""
    if wanted != "auto" and wanted not in get_args(Precision):
        raise ConfigError(f"--precision is auto, {', '.join(get_args(Precision))}; found '{wanted}'")
    if not 0 < limit < 1:
        raise ConfigError(f"--limit is a part of the maps between 0 and 1, found {limit:g}")
    refuse_existing(output, overwrite)
    opened = Bundle.load(bundle, trunks)
    frames, masked = _frames(opened, sources)
    with Stages() as report:
        precisions = measure_precisions(opened, frames, masked, limit=limit, threads=threads, report=report)
    choice = choose_precision(precisions) if wanted == "auto" else precisions.of(wanted)  # type: ignore[arg-type]  # checked above
    _print(precisions, choice)
    write_bundle(output, in_precision(opened, precisions, choice, frames, threads)[1], overwrite=overwrite)
    typer.echo(
        f"bundle {opened.manifest.part}/{opened.manifest.position} in {choice.precision} written to {output}"
    )


def _frames(opened: Bundle, sources: list[Path]) -> tuple[U8, Masked]:
    """Nominal frames of all sources, and damaged ones with masks of those that are datasets."""
    manifest, sensor, region = opened.manifest, opened.profile, opened.region
    given = any(map(is_dataset, sources))
    nominal = resolve_sources(sources, manifest.part, manifest.position if given else None, sensor)
    presses = read_presses(nominal.paths, sensor, region, specimens=nominal.specimens)
    damaged = [
        press
        for source in filter(is_dataset, sources)
        for press in open_dataset(source, resolution_of(sensor.size))
        .select(manifest.part, manifest.position)
        .defective
    ]
    if wrong := [press.path for press in damaged if press.size != sensor.size]:
        typer.echo(
            f"warning: {len(wrong)} of {len(damaged)} damaged pictures are not {sensor.size[0]}x{sensor.size[1]}, and "
            f"tell nothing of AU-PRO, such as {wrong[0]}",
            err=True,
        )
    damaged = [press for press in damaged if press.size == sensor.size]
    pictures = [region.crop(press.rgb()) for press in damaged]
    return presses.frames, (pictures, [region.crop(press.mask()) for press in damaged])


def _print(precisions: Precisions, choice: Measured) -> None:
    """A row per precision, and why one was chosen."""
    typer.echo("precision  maps differ  score differs  AU-PRO change     ms       MB  layers in float")
    for row in precisions.results:
        change = "         -" if row.aupro_change is None else f"{row.aupro_change:+10.4f}"
        typer.echo(
            f"{row.precision:<9}  {row.map_difference:11.2e}  {row.score_difference:13.2e}  {change:>13}  "
            f"{row.milliseconds:5.1f}  {row.bytes / 1e6:7.2f}  {len(row.in_float)}"
        )
    for fault in precisions.faults:
        typer.echo(f"no int8: {fault}")
    probe = (
        "computes int8 exactly" if precisions.is_int8_exact else "has no VNNI: int8 is slower here, or wrong"
    )
    typer.echo(f"this machine {probe}; chosen: {choice.precision}")
    if choice.precision == "int8" and not precisions.is_int8_exact:
        typer.echo("warning: int8 was asked for; use it only on a gateway with VNNI", err=True)


export = typer.Typer(help="Import trained backbones, or write graphs.", no_args_is_help=True)


export.command()(backbone)
export.command()(precision)
export.command("detect")(detect)
export.command("import")(import_)


@export.command()
def parity(
    bundle: BundlePath,
    stages: Annotated[
        Path,
        typer.Argument(
            metavar="STAGES", help="An .npz of the research model: frames, and its stages by name."
        ),
    ],
    report: Annotated[Path | None, typer.Option(help="Folder for parity.html.")] = None,
    trunks: TrunkStore = None,
) -> None:
    """Compare a bundle with the model it came from.

    STAGES holds `frames` (n, h, w, 3) and any of `input`, the taps, values of the head, `map` and `score`, as the
    research model computed them. The first stage that differs is named. Exit code 5 when one does."""
    comparison = compare_bundle(Bundle.load(bundle, trunks), stages)
    for result in comparison.results:
        typer.echo(f"{'equal  ' if result.is_equal else 'DIFFERS'} {result.sentence()}")
    if report is not None:
        typer.echo(f"report {comparison.write(report)}")
    try:
        comparison.raise_if_different()
    except BundleError as error:
        typer.echo(f"gelgate: {error}", err=True)
        raise typer.Exit(5) from error


@export.command()
def openvino(
    bundle: BundlePath,
    output: Annotated[Path, typer.Option("--output", "-o", help="The .xml to write, with its .bin.")] = Path(
        "detector.xml"
    ),
    trunks: TrunkStore = None,
    overwrite: Annotated[bool, typer.Option(help="Replace existing files.")] = False,
) -> None:
    """Write a bundle's detector as an OpenVINO model.

    Its scores are compared with the bundle's first."""
    needs("openvino", "export openvino")
    for path in (output, output.with_suffix(".bin")):
        refuse_existing(path, overwrite, is_bundle=False)
    comparison = write_openvino(Bundle.load(bundle, trunks), output)
    worst = max(result.difference for result in comparison.results)
    typer.echo(
        f"{output} and {output.with_suffix('.bin').name} written; scores differ by at most {worst:.1e}"
    )
    typer.echo("compile it with INFERENCE_PRECISION_HINT f32: some processors compute in bfloat16 otherwise")


@export.command()
def tiles(
    trunk: Annotated[Path, typer.Argument(help="A trunk .onnx file, or an installed backbone's name.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The trunk to write.")] = Path("tiled.onnx"),
    frame: Annotated[str, typer.Option(help="Size of the inspected region, WIDTHxHEIGHT.")] = "1280x720",
    size: Annotated[int, typer.Option(min=32, help="Width and height of a tile in pixels.")] = 224,
    overlap: Annotated[int, typer.Option(min=0, help="Least overlap of neighbouring tiles in pixels.")] = 0,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Make a trunk for large frames, from tiles.

    Each tile is processed as a small frame."""
    refuse_existing(output, overwrite, is_bundle=False)
    try:
        width, height = (int(number) for number in frame.split("x"))
        layout = tiling((height, width), size, overlap)
    except ValueError as error:
        raise ConfigError(f"--frame {frame}: {error}") from error
    if not trunk.is_file() and str(trunk) not in registry.names("backbones"):
        known = ", ".join(registry.names("backbones"))
        raise ConfigError(f"{trunk} is neither a file nor an installed backbone ({known})")
    plain = trunk.read_bytes() if trunk.is_file() else registry.backbone(str(trunk)).trunk()
    write_file(output, tile_trunk(plain, layout))
    typer.echo(
        f"{output}: {len(layout)} tiles of {size} over {frame}, rows {layout.rows}, columns {layout.columns}"
    )


@export.command()
def merge(
    bundle: BundlePath,
    output: Annotated[Path, typer.Option("--output", "-o", help="What to write.")] = Path("detector.onnx"),
    trunks: TrunkStore = None,
    as_bundle: Annotated[
        bool, typer.Option("--as-bundle", help="Write a bundle with the single graph instead of the file.")
    ] = False,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file or bundle.")] = False,
) -> None:
    """Write one graph from frames to score map.

    It contains the bank. It is checked first: its scores must be those of the bundle."""
    refuse_existing(output, overwrite, is_bundle=as_bundle)
    difference = merge_bundle(Bundle.load(bundle, trunks), output, as_bundle=as_bundle)
    typer.echo(
        f"{output} written; it differs from the bundle by at most {difference:.1e} of the largest score"
    )
