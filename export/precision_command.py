"""`gelgate export precision`: a bundle with smaller numbers, chosen by measurement."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from edge.cli.options import BundlePath, TrunkStore

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edge.model.bundle import Bundle
    from export.precision import Masked, Measured, Precisions

__all__ = ["precision"]


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
    from calibration.fitting.command import refuse_existing
    from calibration.progress import Stages
    from edge.core.errors import ConfigError
    from edge.model.bundle import Bundle
    from edge.model.bundle_writer import write_bundle
    from export.precision import Precision, choose_precision, in_precision, measure_precisions

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


def _frames(opened: "Bundle", sources: list[Path]) -> "tuple[NDArray[np.uint8], Masked]":
    """Nominal frames of all sources, and damaged ones with masks of those that are datasets."""
    from calibration.dataset import open_dataset, resolution_of
    from calibration.fitting.command import resolve_sources
    from calibration.fitting.presses.nominal_presses import read_presses
    from calibration.fitting.presses.sources import is_dataset

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
    pictures = [region.crop(press.rgb()) for press in damaged if press.size == sensor.size]
    masks = [region.crop(press.mask()) for press in damaged if press.size == sensor.size]
    return presses.frames, (pictures, masks)


def _print(precisions: "Precisions", choice: "Measured") -> None:
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
