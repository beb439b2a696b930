"""A session for a test's own graph, with one thread: a second one spins on a core that another test uses."""

from pathlib import Path

import onnxruntime as ort

__all__ = ["open_graph"]


def open_graph(graph: bytes | Path) -> ort.InferenceSession:
    """Open a graph, or a file that holds one, with the defaults of onnxruntime."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    return ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
