"""Trunks of a few channels that need no weights' file: frames averaged over squares, then mixed by a random matrix."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from edge.model.session import open_session
from plugins.onnx_builder import Graph


def toy_trunk(taps: Mapping[str, tuple[int, int]], seed: int = 0) -> bytes:
    """Frames to taps, positive. taps: name to (channels, stride); `avgpool` gives one cell."""
    rng = np.random.default_rng(seed)
    graph = Graph("toy")
    frames = graph.op("Cast", graph.input("frames", ("n", "h", "w", 3), "uint8"), to=1)
    planes = graph.op("Mul", graph.transpose(frames, 0, 3, 1, 2), graph.scalar(1 / 255))
    for name, (channels, stride) in taps.items():
        mixed = graph.op(
            "Conv",
            planes,
            graph.constant(rng.normal(size=(channels, 3, 3, 3)).astype(np.float32)),
            pads=[1] * 4,
        )
        seen = graph.op("Relu", mixed)
        if name == "avgpool":
            graph.output(name, graph.op("GlobalAveragePool", seen), ("n", channels, 1, 1))
        else:
            pooled = graph.op("AveragePool", seen, kernel_shape=[stride] * 2, strides=[stride] * 2)
            graph.output(name, pooled, ("n", channels, f"{name}_h", f"{name}_w"))
    return graph.serialise()


def features_of(trunk: bytes, frames: NDArray[np.uint8]) -> dict[str, NDArray[np.float32]]:
    """Every tap of the frames, float32 (n, c, h, w)."""
    session = open_session(trunk, 1, "toy")
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, {"frames": frames}), strict=True))
