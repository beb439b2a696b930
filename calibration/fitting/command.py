"""`gelgate fit`: nominal presses in, a bundle out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.fitting.trunks import DEFAULT_BACKBONE

if TYPE_CHECKING:
    from calibration.fitting.fit import Fitted
    from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["chosen_profile", "counted", "fit", "refuse_existing", "summary", "write"]


def fit(
    sources: Annotated[
        list[Path], typer.Argument(metavar="SOURCE...", help="Recordings, folders of pictures, or pictures.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The bundle: a folder, or a name ending in .zip.")
    ],
    part: Annotated[str, typer.Option(help="Which part is pressed.")],
    position: Annotated[str, typer.Option(help="Where on the part.")] = "default",
    method: Annotated[str, typer.Option(help="The detector.")] = "padim",
    mode: Annotated[str, typer.Option(help="'corrected', or 'paper': its published settings.")] = "corrected",
    backbone: Annotated[
        str, typer.Option(help="An installed backbone, or a trunk .onnx file.")
    ] = DEFAULT_BACKBONE,
    profile: Annotated[
        str, typer.Option(help="Sensor profile; default: what the recording names, else mini_lr.")
    ] = "",
    region: Annotated[str, typer.Option(help="'centre', 'full', or x,y,WIDTHxHEIGHT.")] = "centre",
    alpha: Annotated[float, typer.Option(help="False-alarm rate that the threshold is set for.")] = 0.05,
    threshold: Annotated[
        float | None, typer.Option(help="Use this threshold instead of finding one.")
    ] = None,
    no_contact: Annotated[
        list[Path] | None, typer.Option(help="Pictures of the free gel, or a folder of them.")
    ] = None,
    resize: Annotated[bool, typer.Option(help="Scale pictures of any size to the profile's.")] = False,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A parameter of the detector.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Fixes every random choice.")] = 0,
    folds: Annotated[int, typer.Option(min=2, help="Banks fitted to find the threshold.")] = 5,
    threads: Annotated[int, typer.Option(min=1, max=64, help="Threads of the runtime.")] = 2,
    scattered: Annotated[
        bool, typer.Option("--scattered", help="Fit padim, spade or fapm also to parts that lie anywhere.")
    ] = False,
    trunk: Annotated[bool, typer.Option(help="Put the trunk into the bundle.")] = True,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing bundle.")] = False,
) -> None:
    """Learn a bundle from nominal presses: features, bank, threshold, golden frames."""
    import datetime

    from calibration.fitting.fit import Recipe, fit_files
    from calibration.fitting.nominal_presses import read_presses
    from calibration.fitting.trunks import open_trunk
    from calibration.progress import Stages
    from edge import registry
    from edge.cli.named_values import named_values
    from edge.core.detector import Mode
    from edge.core.errors import ConfigError
    from edge.core.imaging.region import Region

    refuse_existing(output, overwrite)
    if mode not in ("corrected", "paper"):
        raise ConfigError(f"no mode is named '{mode}'; known: corrected, paper")
    sensor = chosen_profile(profile, sources)
    chosen: Mode = "paper" if mode == "paper" else "corrected"
    detector = registry.detector(method)
    overrides = named_values("--set", settings or ())
    parameters = detector.parameters(chosen, **overrides)
    recipe = Recipe(
        part=part,
        position=position,
        profile=sensor,
        region=Region.parse(region, sensor.size),
        detector=detector,
        trunk=open_trunk(backbone, detector.taps(parameters)),
        mode=chosen,
        overrides=overrides,
        alpha=alpha,
        threshold=threshold,
        seed=seed,
        threads=threads,
        folds=folds,
        with_trunk=trunk,
        is_scattered=scattered,
    )
    presses = read_presses(sources, sensor, recipe.region, no_contact=no_contact or (), resize=resize)
    typer.echo(f"{counted(len(presses))}, {method} ({mode}) on {recipe.trunk.id}, region {recipe.region}")
    with Stages() as report:
        fitted = fit_files(presses, recipe, created=datetime.date.today().isoformat(), report=report)
    write(fitted, output, overwrite)
    summary(fitted, output)


def refuse_existing(output: Path, overwrite: bool) -> None:
    """Before any work. Errors: ConfigError."""
    from edge.core.errors import ConfigError

    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or add --overwrite")


def counted(n: int) -> str:
    return f"{n} nominal press{'' if n == 1 else 'es'}"


def write(fitted: "Fitted", output: Path, overwrite: bool) -> None:
    """Errors: StoreError with what to do."""
    from edge.core.errors import StoreError
    from edge.model.bundle import write_bundle

    try:
        write_bundle(output, fitted.files, overwrite=overwrite)
    except OSError as error:
        raise StoreError(
            f"{output} cannot be written: {error.strerror or error}; free some space or choose another folder"
        ) from error


def chosen_profile(name: str, sources: list[Path]) -> "SensorProfile":
    """The profile asked for, or the one that all recordings among the sources name."""
    from calibration.fitting.nominal_presses import is_recording
    from edge.core.errors import ConfigError
    from edge.core.imaging.known_profiles import profile
    from edge.recording.format import Recording

    if name:
        return profile(name)
    named = {Recording.open(s).header.profile for s in sources if is_recording(s)} - {""}
    if len(named) > 1:
        raise ConfigError(
            f"the recordings name different profiles: {', '.join(sorted(named))}; choose with --profile"
        )
    return profile(named.pop() if named else "mini_lr")


def summary(fitted: "Fitted", output: Path) -> None:
    """What was made, in four lines."""
    manifest = fitted.manifest
    limit, cost = manifest.threshold, manifest.cost
    for warning in manifest.provenance.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"threshold {limit.value:.5g}: {limit.method}")
    if limit.n:
        typer.echo(
            f"false alarms: {limit.alpha:g} asked for, 1/{limit.n + 1} = {limit.alpha_floor:.3g} is the floor"
        )
    if cost:
        typer.echo(
            f"a frame takes {cost.trunk_ms:.1f} + {cost.head_ms:.1f} ms (trunk + head, {cost.threads} threads); "
            f"the bank {cost.bank_bytes_stored / 1e6:.2f} MB stored, {cost.bank_bytes_unpacked / 1e6:.2f} MB in use"
        )
    typer.echo(f"bundle {manifest.part}/{manifest.position} written to {output}")
