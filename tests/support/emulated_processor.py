"""A processor without VNNI, emulated by qemu's user mode, and which kind the tests themselves run on."""

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.model.session import saturates

_ROOT = Path(__file__).parents[2]
_EMULATOR = shutil.which("qemu-x86_64") if platform.machine() == "x86_64" else None
_RUN = """
import sys
import numpy as np
from edge.model.session import open_session, saturates
session = open_session(open(sys.argv[1], "rb").read(), 1, "graph")
np.savez(sys.argv[3], *session.run(None, dict(np.load(sys.argv[2]))))
print(saturates())
"""

needs_emulator = pytest.mark.skipif(
    _EMULATOR is None,
    reason="SKIPPED, NOT TESTED: an x86_64 machine with qemu-x86_64 (Debian: qemu-user) is needed",
)


def run_on_haswell(graph: bytes, inputs: Mapping[str, NDArray[Any]], folder: Path) -> list[NDArray[Any]]:
    """The outputs of a graph, opened as the gateway opens it, on an emulated Intel Haswell: AVX2 and no VNNI."""
    given = [folder / name for name in ("graph.onnx", "inputs.npz", "outputs.npz")]
    given[0].write_bytes(graph)
    np.savez(given[1], **dict(inputs))
    words = [_EMULATOR, "-cpu", "Haswell", Path(sys.executable).resolve(), "-c", _RUN, *given]
    places = [str(_ROOT), sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    own = {"PYTHONPATH": ":".join(places), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        list(map(str, words)), env=os.environ | own, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "True"  # its int8 sums saturate where wide ones are not asked for
    with np.load(given[2]) as outputs:
        return [outputs[name] for name in outputs.files]


def processor_kind() -> str:
    """In words, for a measurement: whether int8 trunks run with narrow sums here."""
    if saturates():
        return "a processor without VNNI: int8 trunks run with wide sums, about twice as long"
    return "a processor with VNNI, or another whose int8 sums do not saturate"
