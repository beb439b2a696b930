"""What open sessions take together."""

import resource
from pathlib import Path

import numpy as np

from edge.model.session import open_session
from plugins.onnx_builder import Graph


def test_sessions_work_in_one_memory() -> None:
    """Each has 3 MB in between; with an arena of its own it kept 4 for them."""
    graph = Graph("wide")
    frames = graph.input("frames", (1, 1024))
    wide = graph.op("Tile", frames, graph.ints(768, 1))
    graph.output("least", graph.op("ReduceMin", wide, graph.ints(0), keepdims=0), (1024,))
    sessions = [open_session(graph.serialise(), 1, "wide") for _ in range(9)]
    taken = []
    for session in sessions:
        session.run(None, {"frames": np.zeros((1, 1024), np.float32)})
        taken.append(int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize())
    assert taken[-1] - taken[0] < 8 * 1e6
