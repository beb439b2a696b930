"""What a start costs: no heavy module is imported before it is used."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import edge

HEAVY = {
    *("torch", "onnx", "onnxscript", "depthai", "zxingcpp", "asyncua", "matplotlib", "sklearn", "scipy"),
    *("cv2", "onnxruntime", "usb", "paho"),
}


def test_a_start_imports_nothing_heavy_that_it_does_not_need() -> None:
    program = "import json, sys, edge.gateway.build\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert HEAVY & {name.split(".")[0] for name in json.loads(done.stdout)} == {"cv2", "onnxruntime"}


@pytest.mark.parametrize(
    "module", ["edge.model.session", "calibration.fitting.features", "plugins.conformance.detector", "export"]
)
def test_onnxruntime_reports_nothing_to_its_maker(module: str, tmp_path: Path) -> None:
    """It writes a device id into the home of its user, and sends what it runs, where it is imported before gelgate."""
    probe = Path(edge.__file__).with_name("model") / "saturation_probe.onnx"
    program = f"import {module}, onnxruntime\nonnxruntime.InferenceSession({str(probe)!r})"
    own = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    places = dict.fromkeys(("HOME", "TMPDIR", "XDG_CACHE_HOME"), str(tmp_path))
    subprocess.run([sys.executable, "-c", program], env=own | places, check=True)

    assert list(tmp_path.rglob("*")) == []


def test_a_verb_runs_with_the_collector_of_garbage() -> None:
    """It is off while modules are imported, which then stay out of its way."""
    program = (
        "import atexit, gc, sys\nfrom gelgate import main\nsys.argv = ['gelgate', 'check', '--example']\n"
    )
    said = "atexit.register(lambda: print(gc.isenabled(), gc.get_freeze_count() > 10_000))\nmain()"
    done = subprocess.run([sys.executable, "-c", program + said], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-2:] == ["True", "True"]
