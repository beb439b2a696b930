"""Random weights of a small VQGAN, in the names and shapes of taming-transformers."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["random_vqgan"]

State = dict[str, NDArray[np.float32]]


def random_vqgan(prefix: str = "") -> State:
    """Two levels of 32 and 64 channels, one block each, attention in the second; three latent channels; and a part of
    the decoder, the quantiser and the loss, which a checkpoint holds too."""
    rng = np.random.default_rng(5)
    state: State = {}

    def conv(name: str, inputs: int, outputs: int, kernel: int = 3) -> None:
        shape = outputs, inputs, kernel, kernel
        scale = 1 / np.sqrt(inputs * kernel * kernel)
        state[f"{name}.weight"] = (scale * rng.normal(size=shape)).astype(np.float32)
        state[f"{name}.bias"] = (0.1 * rng.normal(size=outputs)).astype(np.float32)

    def norm(name: str, channels: int) -> None:
        state[f"{name}.weight"] = (1 + 0.2 * rng.normal(size=channels)).astype(np.float32)
        state[f"{name}.bias"] = (0.2 * rng.normal(size=channels)).astype(np.float32)

    def block(name: str, inputs: int, outputs: int) -> None:
        norm(f"{name}.norm1", inputs)
        conv(f"{name}.conv1", inputs, outputs)
        norm(f"{name}.norm2", outputs)
        conv(f"{name}.conv2", outputs, outputs)
        if inputs != outputs:
            conv(f"{name}.nin_shortcut", inputs, outputs, 1)

    def attention(name: str, channels: int) -> None:
        norm(f"{name}.norm", channels)
        for part in ("q", "k", "v", "proj_out"):
            conv(f"{name}.{part}", channels, channels, 1)

    conv("encoder.conv_in", 3, 32)
    block("encoder.down.0.block.0", 32, 32)
    conv("encoder.down.0.downsample.conv", 32, 32)
    block("encoder.down.1.block.0", 32, 64)
    attention("encoder.down.1.attn.0", 64)
    block("encoder.mid.block_1", 64, 64)
    attention("encoder.mid.attn_1", 64)
    block("encoder.mid.block_2", 64, 64)
    norm("encoder.norm_out", 64)
    conv("encoder.conv_out", 64, 3)
    conv("quant_conv", 3, 3, 1)
    conv("decoder.conv_in", 3, 64)
    conv("loss.discriminator.main.0", 3, 64, 4)
    state["quantize.embedding.weight"] = np.zeros((16, 3), np.float32)
    return {f"{prefix}{key}": value for key, value in state.items()}
