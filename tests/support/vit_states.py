"""Random weights of small vision transformers, in the names and shapes of the published encoders."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

WIDTH = 128
State = dict[str, NDArray[np.float32]]


def random_vit(
    depth: int = 3, *, patch: int = 8, grid: int = 4, channels: int = 3, registers: int = 0
) -> State:
    """timm's names: class token, positions of all but registers, blocks, last norm. Two heads of 64."""
    rng = np.random.default_rng(depth + 10 * channels)

    def noise(*shape: int, about: float = 0.0) -> NDArray[np.float32]:
        return (about + 0.2 * rng.normal(size=shape)).astype(np.float32)

    state = {
        "cls_token": noise(1, 1, WIDTH),
        "pos_embed": noise(1, 1 + grid * grid, WIDTH),
        "patch_embed.proj.weight": noise(WIDTH, channels, patch, patch),
        "patch_embed.proj.bias": noise(WIDTH),
        "norm.weight": noise(WIDTH, about=1),
        "norm.bias": noise(WIDTH),
    }
    if registers:
        state["register_tokens"] = noise(1, registers, WIDTH)
    for number in range(depth):
        state |= {f"blocks.{number}.{key}": value for key, value in _block(noise).items()}
    return state


def _block(noise: Callable[..., NDArray[np.float32]]) -> State:
    sizes = {"attn.qkv": (3 * WIDTH, WIDTH), "attn.proj": (WIDTH, WIDTH)}
    sizes |= {"mlp.fc1": (2 * WIDTH, WIDTH), "mlp.fc2": (WIDTH, 2 * WIDTH)}
    block = {f"{name}.weight": noise(*size) for name, size in sizes.items()}
    block |= {f"{name}.bias": noise(size[0]) for name, size in sizes.items()}
    for norm in ("norm1", "norm2"):
        block |= {f"{norm}.weight": noise(WIDTH, about=1), f"{norm}.bias": noise(WIDTH)}
    return block


def save_safetensors(path: Path, state: State) -> None:
    """Write weights with the format's own library."""
    from safetensors.numpy import save_file

    save_file(state, str(path))
