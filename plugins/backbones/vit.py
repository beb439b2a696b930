"""Vision transformers as data: their sizes, read from the weights, in the names of timm and of DINO's releases.

Ref: Dosovitskiy et al., "An Image is Worth 16x16 Words", arXiv:2010.11929; Oquab et al., arXiv:2304.07193 (layer
scale); Darcet et al., arXiv:2309.16588 (registers). Names re-stated from the state dicts.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.core.arrays import F32
from edge.core.errors import ConfigError
from plugins.backbones.input_steps import cubic_matrix
from plugins.backbones.topology import State, refuse_faults, refuse_infinite

__all__ = [
    "PREFIXES",
    "REGISTERS",
    "VitShape",
    "check_vit_taps",
    "list_vit_taps",
    "prefix_tokens",
    "vit_shape",
]

REGISTERS = ("reg_token", "register_tokens")
PREFIXES = ("cls_token", "dist_token")
# Of the classifier, of masked training, and of heads behind the features.
IGNORED = re.compile(r"^(head|head_dist|fc_norm|mask_token|pre_logits|attn_pool|decoder_\w+)(\.|$)")
_OPTIONAL = re.compile(r"^(norm|norm_pre)\.|^patch_embed\.proj\.bias$|.*\.(attn\.qkv\.bias|ls[12]\.gamma)$")
USUAL_HEAD = 64
USUAL_EPS = 1e-6


@dataclass(frozen=True)
class VitShape:
    """A transformer's sizes, read from its weights."""

    width: int
    depth: int
    heads: int
    patch: int
    """Pixels per side."""
    grid: int
    """Patches per side in training."""
    channels: int
    prefixes: int
    """Tokens before the patches."""
    placed: int
    """How many of them have a position."""
    eps: float = USUAL_EPS
    """The epsilon of the layer norms."""


def list_vit_taps(shape: VitShape) -> tuple[str, ...]:
    """List the taps in the order of computation."""
    return (*(f"block{number}" for number in range(shape.depth)), "norm")


def vit_shape(
    state: State, name: str = "the weights", heads: int | None = None, eps: float = USUAL_EPS
) -> VitShape:
    """The sizes of a transformer. heads: of the attention; one per 64 channels when None.

    Errors: ConfigError with what is missing, unexpected or wrongly shaped.
    """
    for key, wanted in (("patch_embed.proj.weight", 4), ("pos_embed", 3)):
        if key not in state or state[key].ndim != wanted:
            problem = "missing" if key not in state else f"of shape {state[key].shape}"
            raise ConfigError(
                f"{name} are not a vision transformer that is known here: '{key}' is {problem}, {wanted} axes are "
                "expected; export it to ONNX with its own program, then `gelgate export backbone FILE.onnx --taps ...`"
            )
    width, channels, patch, patch_w = state["patch_embed.proj.weight"].shape
    depth = 1 + max((int(m[1]) for m in map(re.compile(r"blocks\.(\d+)\.").match, state) if m), default=-1)
    heads = heads or max(1, width // USUAL_HEAD)
    if patch != patch_w or depth == 0 or width % heads or channels % 3:
        raise ConfigError(
            f"{name} have {depth} blocks of {width} channels, {heads} heads, patches of {patch}x{patch_w} and "
            f"{channels} input channels; expected are blocks, square patches, channels in threes, and heads that "
            "divide the channels (--heads)"
        )
    prefixes = sum(state[key].shape[-2] for key in (*PREFIXES, *REGISTERS) if key in state)
    placed, grid = _positions(state, prefixes, name)
    shape = VitShape(width, depth, heads, patch, grid, channels, prefixes, placed, eps)
    _check(state, shape, name)
    return shape


def _positions(state: State, prefixes: int, name: str) -> tuple[int, int]:
    """Count the prefix tokens that have a position, and find the side of the patch grid."""
    count = state["pos_embed"].shape[-2]
    for placed in range(prefixes + 1):
        side = round(max(count - placed, 0) ** 0.5)
        if side > 0 and side * side == count - placed:
            return placed, side
    raise ConfigError(
        f"{name} have {count} positions for {prefixes} prefix tokens and a square grid of patches; expected is a "
        "square number with or without the prefixes"
    )


def check_vit_taps(taps: Sequence[str], shape: VitShape, state: State) -> None:
    """Refuse no tap, an unknown one, one that is given twice, or `norm` without its weights. Errors: ConfigError."""
    known = [tap for tap in list_vit_taps(shape) if tap != "norm" or "norm.weight" in state]
    if not taps or len(set(taps)) != len(taps) or not set(taps) <= set(known):
        raise ConfigError(
            f"a trunk needs distinct taps of {', '.join(known)}; found {', '.join(taps) or 'none'}"
        )


def prefix_tokens(state: State, shape: VitShape, grid: tuple[int, int]) -> tuple[F32, F32]:
    """The prefix tokens (prefixes, d) with their positions added, and the positions of the patches (rows * columns, d).

    Class and distillation tokens come first, then the registers. Positions of another grid are resampled (bicubic).
    """
    positions = np.asarray(state["pos_embed"], np.float64).reshape(-1, shape.width)
    tokens = [
        np.asarray(state[key], np.float64).reshape(-1, shape.width)
        for key in (*PREFIXES, *REGISTERS)
        if key in state
    ]
    first = np.concatenate([*tokens, np.zeros((0, shape.width))])
    first[: shape.placed] += positions[: shape.placed]
    patches = positions[shape.placed :]
    if grid != (shape.grid, shape.grid):
        square = patches.reshape(shape.grid, shape.grid, shape.width)
        rows, columns = (cubic_matrix(shape.grid, side) for side in grid)
        patches = np.einsum("ra,abd,cb->rcd", rows, square, columns, optimize=True).reshape(-1, shape.width)
    return first.astype(np.float32), patches.astype(np.float32)


def _check(state: State, shape: VitShape, name: str) -> None:
    """Refuse missing, unknown and non-finite weights. Errors: ConfigError."""
    first = state.get("blocks.0.mlp.fc1.weight")
    known = _list_shapes(shape, 4 * shape.width if first is None else first.shape[0])
    missing = [key for key in known if key not in state and not _OPTIONAL.match(key)]
    tokens = {"pos_embed", *PREFIXES, *REGISTERS}
    extra = [key for key in state if key not in known and key not in tokens and not IGNORED.match(key)]
    end = "; export other kinds to ONNX with their own program"
    start = f"{name} are not a plain vision transformer in timm's naming: "
    refuse_faults(state, known, missing, extra, start, end)
    refuse_infinite(state, (*known, *tokens), name)


def _list_shapes(shape: VitShape, hidden: int) -> dict[str, tuple[int, ...]]:
    d = shape.width
    sizes: dict[str, tuple[int, ...]] = {
        "patch_embed.proj.weight": (d, shape.channels, shape.patch, shape.patch),
        "patch_embed.proj.bias": (d,),
        **{f"{norm}.{part}": (d,) for norm in ("norm", "norm_pre") for part in ("weight", "bias")},
    }
    matrices = {"attn.qkv": (3 * d, d), "attn.proj": (d, d), "mlp.fc1": (hidden, d), "mlp.fc2": (d, hidden)}
    for number in range(shape.depth):
        block = f"blocks.{number}."
        for name, (rows, columns) in matrices.items():
            sizes |= {f"{block}{name}.weight": (rows, columns), f"{block}{name}.bias": (rows,)}
        sizes |= {f"{block}{norm}.{part}": (d,) for norm in ("norm1", "norm2") for part in ("weight", "bias")}
        sizes |= {f"{block}{scale}.gamma": (d,) for scale in ("ls1", "ls2")}
    return sizes
