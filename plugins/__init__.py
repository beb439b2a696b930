import edge  # noqa: F401 - before onnxruntime
