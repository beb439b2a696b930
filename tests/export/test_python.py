"""`from export import ...`: the names exist, have docstrings, and are loaded at use."""

import subprocess
import sys

import pytest

import export


def test_names_are_loaded_at_use() -> None:
    """The package alone loads neither onnx nor torch; an unknown name lists the known ones."""
    program = "import export, sys; print(sorted({'onnx', 'torch', 'onnxruntime'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)

    assert done.stdout.strip() == "[]"
    assert [name for name in export.__all__ if not getattr(export, name).__doc__] == []
    with pytest.raises(AttributeError, match="export has no 'import_nothing'; it has Adapted"):
        _ = export.import_nothing
