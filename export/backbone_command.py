"""`gelgate export backbone`: weights or a network from other tools become a trunk."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from calibration.fitting.command import refuse_existing
from calibration.fitting.presses.nominal_presses import read_presses
from edge.cli.arguments import add_argument, add_option, flatten
from edge.core.errors import ConfigError
from edge.core.imaging.known_profiles import profile as known_profile
from edge.core.imaging.region import Region
from edge.model.manifest_facts import is_non_commercial
from export.backbone import BackboneOptions, export_backbone
from export.known_weights import encoder as known_encoder
from plugins.backbones.input_steps import IMAGENET, InputSteps

__all__ = ["backbone", "three_numbers"]


@dataclass(frozen=True)
class BackboneArguments:
    """What the command line says."""

    checkpoint: Path = add_argument(..., "A .pth, .safetensors or .onnx file.")
    output: Path = add_option(Path("trunk.onnx"), "The trunk to write.", "--output", "-o")
    licence: str | None = add_option(
        None, "Licence of the weights, such as MIT; 'own' for your own.", show_default=False
    )
    topology: str | None = add_option(
        None,
        "Of a ResNet: resnet18, resnet50 or wide_resnet50_2. Default: the one that the weights have.",
        show_default=False,
    )
    taps: str = add_option(
        "", "Maps to output: layer1,layer2 of a ResNet, block5,norm of a transformer, NAME=VALUE of a graph."
    )
    encoder: str = add_option("", "A touch encoder whose preprocessing is used: tvl, t3, sparsh or unit.")
    mean: str = add_option("", "Subtracted from RGB in 0..1; default: ImageNet's.")
    std: str = add_option("", "Then RGB is divided by this; default: ImageNet's.")
    size: str = add_option("", "Resize frames to HEIGHTxWIDTH before the network.")
    background: Path | None = add_option(None, "A picture of the free gel, subtracted from every frame.")
    profile: str = add_option("mini_lr", "Sensor profile of the frames.")
    region: str = add_option("centre", "The inspected region, as for `fit`.")
    version: str | None = add_option(
        None, "V1 or V2 of torchvision's weights: refused if the file is the other."
    )
    second: Path | None = add_option(None, "Weights of the blocks that follow, such as T3's trunk.")
    prefix: str | None = add_option(None, "Of the weights' names, where a file holds several networks.")
    heads: int | None = add_option(None, "Attention heads; default: one per 64 channels.", min=1)
    prefix_tokens: int | None = add_option(None, "Tokens before the patches in a graph's sequences.", min=0)
    high: float = add_option(1.0, "Value of full brightness in a graph's input: 1 or 255.")
    half: bool = add_option(False, "Store the weights as float16: half the file.")
    report: Path | None = add_option(None, "Folder for the comparison with the original, parity.html.")
    overwrite: bool = add_option(False, "Replace an existing file.")


@flatten
def backbone(given: BackboneArguments) -> None:
    """Convert weights or a network to a trunk.

    It is compared with the original at every tap before it is written."""
    refuse_existing(given.output, given.overwrite, is_bundle=False)
    sensor = known_profile(given.profile)
    region = Region.parse(given.region, sensor.size)
    options = BackboneOptions(
        licence=given.licence,
        topology=given.topology,
        taps=tuple(tap.strip() for tap in given.taps.split(",") if tap.strip()),
        encoder=given.encoder or None,
        steps=_steps(given.encoder, given.mean, given.std, given.size),
        background=None
        if given.background is None
        else read_presses([given.background], sensor, region).frames[0],
        frame=(region.height, region.width),
        weights="float16" if given.half else "float32",
        version=given.version,
        second=given.second,
        prefix=given.prefix,
        heads=given.heads,
        prefix_tokens=given.prefix_tokens,
        high=given.high,
    )
    made = export_backbone(given.checkpoint, given.output, options, given.report)
    worst = max(made.parity.results, key=lambda result: result.difference)
    typer.echo(f"{given.output}: {', '.join(made.taps)}, {len(made.trunk) / 1e6:.1f} MB")
    typer.echo(f"equal to the original: largest difference {worst.difference:.1e}, at {worst.name}")
    limit = "; not for commercial use" if is_non_commercial(made.facts["licence"]) else ""
    typer.echo(f"licence of the weights {made.facts['licence']}{limit}")
    for name in ("release", "weights_sha256"):
        if name in made.facts:
            typer.echo(f"{name.replace('_', ' ')} {made.facts[name]}")
    typer.echo(f"trunk sha256 {made.sha256}")


def _steps(encoder: str, mean: str, std: str, size: str) -> InputSteps | None:
    """The preprocessing that the options change; None where they leave it alone."""
    if not (mean or std or size):
        return None
    usual = known_encoder(encoder).steps if encoder else IMAGENET
    steps = usual or IMAGENET
    if mean:
        steps = replace(steps, mean=three_numbers("--mean", mean))
    if std:
        steps = replace(steps, std=three_numbers("--std", std))
    return replace(steps, size=_two_sizes(size)) if size else steps


def _two_sizes(text: str) -> tuple[int, int]:
    try:
        height, width = (int(number) for number in text.split("x"))
    except ValueError as error:
        raise ConfigError(f"--size is HEIGHTxWIDTH such as 224x224, found '{text}'") from error
    if not (1 <= height <= 4096 and 1 <= width <= 4096):
        raise ConfigError(f"--size is 1 to 4096 pixels each way, found '{text}'")
    return height, width


def three_numbers(option: str, text: str) -> tuple[float, float, float]:
    """Three numbers, red, green, blue. Errors: ConfigError."""
    try:
        red, green, blue = (float(number) for number in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option} is three numbers such as 0.485,0.456,0.406, found '{text}'") from error
    if not all(math.isfinite(value) for value in (red, green, blue)) or (
        option == "--std" and min(red, green, blue) <= 0
    ):
        raise ConfigError(f"{option} holds numbers that cannot scale a picture: '{text}'")
    return red, green, blue
