"""`from export import ...`: the names exist, have docstrings, and are loaded at use."""

import subprocess
import sys

import pytest

import export


@pytest.mark.parametrize("name", export.__all__)
def test_every_name_is_there_with_a_docstring(name: str) -> None:
    """A notebook's `from export import NAME` works, and its help says something."""
    assert getattr(export, name).__doc__


def test_the_package_loads_neither_onnx_nor_torch() -> None:
    """Names are loaded at use."""
    program = "import export, sys; print(sorted({'onnx', 'torch', 'onnxruntime'} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout.strip() == "[]"


def test_an_unknown_name_lists_the_known_ones() -> None:
    """As any module, with a hint."""
    with pytest.raises(AttributeError, match="export has no 'import_nothing'; it has Adapted"):
        _ = export.import_nothing
