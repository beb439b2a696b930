"""The arguments and options of `gelgate export backbone`, each with its help."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "Background",
    "Checkpoint",
    "Encoder",
    "Half",
    "Heads",
    "High",
    "Licence",
    "Mean",
    "Output",
    "Overwrite",
    "Prefix",
    "PrefixTokens",
    "Profile",
    "RegionText",
    "Report",
    "Second",
    "Size",
    "Std",
    "Taps",
    "Topology",
    "Version",
]

Licence = Annotated[
    str | None,
    typer.Option(help="Licence of the weights, such as MIT; 'own' for your own.", show_default=False),
]
Checkpoint = Annotated[Path, typer.Argument(help="A .pth, .safetensors or .onnx file.")]
Output = Annotated[Path, typer.Option("--output", "-o", help="The trunk to write.")]
Topology = Annotated[
    str | None,
    typer.Option(
        help="Of a ResNet: resnet18, resnet50 or wide_resnet50_2. Default: the one that the weights have.",
        show_default=False,
    ),
]
Taps = Annotated[
    str,
    typer.Option(
        help="Maps to output: layer1,layer2 of a ResNet, block5,norm of a transformer, level2,latent of a VQGAN, "
        "NAME=VALUE of a graph."
    ),
]
Encoder = Annotated[
    str, typer.Option(help="A touch encoder whose preprocessing is used: tvl, t3, sparsh or unit.")
]
Mean = Annotated[str, typer.Option(help="Subtracted from RGB in 0..1; default: ImageNet's.")]
Std = Annotated[str, typer.Option(help="Then RGB is divided by this; default: ImageNet's.")]
Size = Annotated[str, typer.Option(help="Resize frames to HEIGHTxWIDTH before the network.")]
Background = Annotated[
    Path | None, typer.Option(help="A picture of the free gel, subtracted from every frame.")
]
Profile = Annotated[str, typer.Option(help="Sensor profile of the frames.")]
RegionText = Annotated[str, typer.Option(help="The inspected region, as for `fit`.")]
Version = Annotated[
    str | None, typer.Option(help="V1 or V2 of torchvision's weights: refused if the file is the other.")
]
Second = Annotated[Path | None, typer.Option(help="Weights of the blocks that follow, such as T3's trunk.")]
Prefix = Annotated[
    str | None, typer.Option(help="Of the weights' names, where a file holds several networks.")
]
Heads = Annotated[int | None, typer.Option(min=1, help="Attention heads; default: one per 64 channels.")]
PrefixTokens = Annotated[
    int | None, typer.Option(min=0, help="Tokens before the patches in a graph's sequences.")
]
High = Annotated[float, typer.Option(help="Value of full brightness in a graph's input: 1 or 255.")]
Half = Annotated[bool, typer.Option(help="Store the weights as float16: half the file.")]
Report = Annotated[
    Path | None, typer.Option(help="Folder for the comparison with the original, parity.html.")
]
Overwrite = Annotated[bool, typer.Option(help="Replace an existing file.")]
