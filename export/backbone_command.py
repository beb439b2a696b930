"""`gelgate export backbone`: weights or a network from other tools become a trunk."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from export.backbone_arguments import (
    Background,
    Checkpoint,
    Encoder,
    Half,
    Heads,
    High,
    Licence,
    Mean,
    Output,
    Overwrite,
    Prefix,
    PrefixTokens,
    Profile,
    RegionText,
    Report,
    Second,
    Size,
    Std,
    Taps,
    Topology,
    Version,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edge.core.imaging.region import Region
    from edge.core.imaging.sensor_profile import SensorProfile
    from export.backbone import BackboneOptions
    from plugins.backbones.input_steps import InputSteps

__all__ = ["backbone", "three_numbers"]


def backbone(
    checkpoint: Checkpoint,
    output: Output = Path("trunk.onnx"),
    licence: Licence = None,
    topology: Topology = None,
    taps: Taps = "",
    encoder: Encoder = "",
    mean: Mean = "",
    std: Std = "",
    size: Size = "",
    background: Background = None,
    profile: Profile = "mini_lr",
    region: RegionText = "centre",
    version: Version = None,
    second: Second = None,
    prefix: Prefix = None,
    heads: Heads = None,
    prefix_tokens: PrefixTokens = None,
    high: High = 1.0,
    half: Half = False,
    report: Report = None,
    overwrite: Overwrite = False,
) -> None:
    """Convert weights or a network to a trunk.

    It is compared with the original at every tap before it is written."""
    from edge.core.errors import ConfigError
    from edge.core.imaging.known_profiles import profile as known_profile
    from edge.core.imaging.region import Region
    from export.backbone import BackboneOptions

    if output.exists() and not overwrite:
        raise ConfigError(f"{output} exists already; choose another name or pass --overwrite")
    sensor = known_profile(profile)
    inspected = Region.parse(region, sensor.size)
    options = BackboneOptions(
        licence=licence,
        topology=topology,
        taps=tuple(tap.strip() for tap in taps.split(",") if tap.strip()),
        encoder=encoder or None,
        steps=_steps(encoder, mean, std, size),
        background=None if background is None else _free_gel(background, sensor, inspected),
        frame=(inspected.height, inspected.width),
        weights="float16" if half else "float32",
        version=version,
        second=second,
        prefix=prefix,
        heads=heads,
        prefix_tokens=prefix_tokens,
        high=high,
    )
    _make(checkpoint, output, options, report)


def _make(checkpoint: Path, output: Path, options: "BackboneOptions", report: Path | None) -> None:
    from edge.model.licence import is_non_commercial
    from export.backbone import export_backbone

    made = export_backbone(checkpoint, output, options, report)
    worst = max(made.parity.results, key=lambda result: result.difference)
    typer.echo(f"{output}: {', '.join(made.taps)}, {len(made.trunk) / 1e6:.1f} MB")
    typer.echo(f"equal to the original: largest difference {worst.difference:.1e}, at {worst.name}")
    limit = "; not for commercial use" if is_non_commercial(made.facts["licence"]) else ""
    typer.echo(f"licence of the weights {made.facts['licence']}{limit}")
    for name in ("release", "weights_sha256"):
        if name in made.facts:
            typer.echo(f"{name.replace('_', ' ')} {made.facts[name]}")
    typer.echo(f"trunk sha256 {made.sha256}")


def _steps(encoder: str, mean: str, std: str, size: str) -> "InputSteps | None":
    """The preprocessing that the options change; None where they leave it alone."""
    from dataclasses import replace

    from export.known_weights import encoder as known_encoder
    from plugins.backbones.input_steps import IMAGENET

    if not (mean or std or size):
        return None
    usual = known_encoder(encoder).steps if encoder else IMAGENET
    steps = usual or IMAGENET
    if mean:
        steps = replace(steps, mean=three_numbers("--mean", mean))
    if std:
        steps = replace(steps, std=three_numbers("--std", std))
    return replace(steps, size=_two_sizes(size)) if size else steps


def _free_gel(picture: Path, sensor: "SensorProfile", region: "Region") -> "NDArray[np.uint8]":
    """The region of a picture of the free gel, uint8 (h, w, 3). Errors: as `read_presses`."""
    import numpy as np

    from calibration.fitting.nominal_presses import read_presses

    return np.asarray(read_presses([picture], sensor, region).frames[0], np.uint8)


def _two_sizes(text: str) -> tuple[int, int]:
    from edge.core.errors import ConfigError

    try:
        height, width = (int(number) for number in text.split("x"))
    except ValueError as error:
        raise ConfigError(f"--size is HEIGHTxWIDTH such as 224x224, found '{text}'") from error
    if not (1 <= height <= 4096 and 1 <= width <= 4096):
        raise ConfigError(f"--size is 1 to 4096 pixels each way, found '{text}'")
    return height, width


def three_numbers(option: str, text: str) -> tuple[float, float, float]:
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
