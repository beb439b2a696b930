import edge.core  # noqa: F401 - before onnxruntime
