"""`gelgate export parity` and `export openvino`: a bundle is compared with its original, or written for OpenVINO."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["openvino", "parity"]

BundlePath = Annotated[Path, typer.Argument(metavar="BUNDLE", help="A bundle: folder or .zip.")]
Trunks = Annotated[
    Path | None, typer.Option(help="Folder of <sha256>.onnx files, for bundles without their trunk.")
]


def parity(
    bundle: BundlePath,
    stages: Annotated[
        Path,
        typer.Argument(
            metavar="STAGES", help="An .npz of the research model: frames, and its stages by name."
        ),
    ],
    report: Annotated[Path | None, typer.Option(help="Folder for parity.html.")] = None,
    trunks: Trunks = None,
) -> None:
    """Compare a bundle with the model it came from.

    STAGES holds `frames` (n, h, w, 3) and any of `input`, the taps, values of the head, `map` and `score`, as the
    research model computed them. The first stage that differs is named. Exit code 5 when one does."""
    from edge.core.errors import BundleError
    from edge.model.bundle import Bundle
    from export.bundle_stages import compare_bundle

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


def openvino(
    bundle: BundlePath,
    output: Annotated[Path, typer.Option("--output", "-o", help="The .xml to write, with its .bin.")] = Path(
        "detector.xml"
    ),
    trunks: Trunks = None,
    overwrite: Annotated[bool, typer.Option(help="Replace existing files.")] = False,
) -> None:
    """Write a bundle's detector as an OpenVINO model.

    Its scores are compared with the bundle's first."""
    from edge.core.errors import ConfigError
    from edge.extras import needs
    from edge.model.bundle import Bundle
    from export.openvino_model import write_openvino

    needs("openvino", "export openvino")
    existing = [path for path in (output, output.with_suffix(".bin")) if path.exists()]
    if existing and not overwrite:
        raise ConfigError(f"{existing[0]} exists already; choose another name or pass --overwrite")
    comparison = write_openvino(Bundle.load(bundle, trunks), output)
    worst = max(result.difference for result in comparison.results)
    typer.echo(
        f"{output} and {output.with_suffix('.bin').name} written; scores differ by at most {worst:.1e}"
    )
    typer.echo("compile it with INFERENCE_PRECISION_HINT f32: some processors compute in bfloat16 otherwise")
