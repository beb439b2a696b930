"""What a start costs: no heavy module is imported before it is used."""

import json
import subprocess
import sys

HEAVY = {
    *("torch", "onnx", "onnxscript", "depthai", "zxingcpp", "asyncua", "matplotlib", "sklearn", "scipy"),
    *("cv2", "onnxruntime", "usb", "paho"),
}


def test_a_start_imports_nothing_heavy_that_it_does_not_need() -> None:
    program = "import json, sys, edge.gateway.build\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert HEAVY & {name.split(".")[0] for name in json.loads(done.stdout)} == {"cv2", "onnxruntime"}
