"""Releases of weights, known by their hash, touch encoders as their authors publish them, and licences that are stated.

The names of torchvision's files carry the first eight digits of their SHA-256, so a file is recognised also when it
was renamed. Ref: torchvision.models.resnet (the `url` of each weights entry).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from edge.core.errors import ConfigError
from plugins.backbones.input_steps import InputSteps

__all__ = ["ENCODERS", "RELEASES", "Encoder", "Release", "check_release", "encoder", "stated_licence"]


MOST_CHARACTERS = 200


@dataclass(frozen=True)
class Release:
    """One published file of weights."""

    topology: str
    version: str
    """The version of torchvision's weights, V1 or V2."""
    name: str


RELEASES: Mapping[str, Release] = {
    "f37072fd": Release("resnet18", "V1", "torchvision resnet18 IMAGENET1K_V1"),
    "5c106cde": Release("resnet18", "V1", "torchvision resnet18 IMAGENET1K_V1, first file"),
    "0676ba61": Release("resnet50", "V1", "torchvision resnet50 IMAGENET1K_V1"),
    "19c8e357": Release("resnet50", "V1", "torchvision resnet50 IMAGENET1K_V1, first file"),
    "11ad3fa6": Release("resnet50", "V2", "torchvision resnet50 IMAGENET1K_V2"),
    "95faca4d": Release("wide_resnet50_2", "V1", "torchvision wide_resnet50_2 IMAGENET1K_V1"),
    "9ba9bcbe": Release("wide_resnet50_2", "V2", "torchvision wide_resnet50_2 IMAGENET1K_V2"),
}
"""By the first eight digits of the file's SHA-256."""


def check_release(sha256: str, declared: str | None, topology: str, file: str) -> str:
    """The name of the release, or `unknown`. declared: V1 or V2 where the caller states it.

    Errors: ConfigError where the file is another version or another network than stated.
    """
    release = RELEASES.get(sha256[:8])
    if release is None:
        return "unknown" if declared is None else f"{declared} (stated; the file's hash is not a known one)"
    if declared not in (None, release.version):
        raise ConfigError(
            f"{file} are the {release.version} weights ({release.name}), {declared} was declared; features of the two "
            f"differ: give the {declared} file, or declare {release.version}"
        )
    if topology != release.topology:
        raise ConfigError(f"{file} is {release.name}, not a {topology}; pass --topology {release.topology}")
    return release.name


@dataclass(frozen=True)
class Encoder:
    """A published touch encoder: its licence as its authors state it, and its preprocessing."""

    name: str
    licence: str
    source: str
    steps: InputSteps | None
    """The preprocessing; None where the user must state mean and std."""
    needs_background: bool = False
    """Whether it was trained on differences from the untouched gel."""
    eps: float = 1e-6
    """The epsilon of the layer norms."""


_TVL_MEAN = (0.29174602047139075, 0.2971325588927249, 0.2910404549605639)
_TVL_STD = (0.18764469044810236, 0.19467651810273057, 0.21871583397361818)

ENCODERS: Mapping[str, Encoder] = {
    known.name: known
    for known in (
        # Mean and std: TAC_MEAN and TAC_STD of tvl_enc/tacvis.py.
        Encoder("tvl", "Apache-2.0", "github.com/Max-Fu/tvl", InputSteps(_TVL_MEAN, _TVL_STD, (224, 224))),
        # Its statistics belong to the data set of each sensor; its norms keep torch's default.
        Encoder("t3", "MIT", "github.com/alanzjl/t3", None, eps=1e-5),
        # Two frames in six channels, background subtracted (model card); the offset of a half is not on the card.
        Encoder(
            "sparsh",
            "CC-BY-NC-4.0",
            "huggingface.co/facebook/sparsh-dino-base",
            InputSteps((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (224, 224), offset=0.5, copies=2),
            needs_background=True,
        ),
        # Levels in 0..1, resized by OpenCV's linear interpolation: tactile_representation_dataset.py and its config.
        Encoder(
            "unit",
            "MIT",
            "github.com/ZhengtongXu/UniT",
            InputSteps((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (128, 160), is_antialiased=False),
        ),
    )
}


def encoder(name: str) -> Encoder:
    """A touch encoder by name. Errors: ConfigError naming those that are known."""
    if name not in ENCODERS:
        raise ConfigError(
            f"no touch encoder is named '{name}'; known: {', '.join(ENCODERS)}; others come in as ONNX with --taps"
        )
    return ENCODERS[name]


def stated_licence(text: str | None, what: str, usual: str | None = None) -> str:
    """The stated licence without surrounding spaces. what: the file or weights; usual: what its authors state.

    Errors: ConfigError where it is not stated, or is not one short line.
    """
    licence = (text or "").strip()
    if not licence:
        hint = f"its authors state {usual}; " if usual else ""
        raise ConfigError(
            f"the licence of {what} is not stated; {hint}look it up and pass --licence, such as --licence Apache-2.0, "
            "or --licence own for weights that you trained"
        )
    if len(licence) > MOST_CHARACTERS or not licence.isprintable():
        raise ConfigError(
            f"the licence of {what} has {len(licence)} characters or is not one line; give its short name, such as "
            "CC-BY-NC-4.0"
        )
    return licence
