"""What a start costs: no heavy module is imported before it is used."""

import json
import subprocess
import sys

import pytest

HEAVY = {
    *(
        "torch",
        "onnx",
        "onnxscript",
        "depthai",
        "zxingcpp",
        "asyncua",
        "matplotlib",
        "sklearn",
        "scipy",
        "cv2",
        "onnxruntime",
    ),
    *("usb", "paho"),
}


@pytest.mark.parametrize(
    ("statement", "needed"),
    [
        ("import edge.gateway.build", {"cv2", "onnxruntime"}),
    ],
)
def test_a_start_imports_nothing_heavy(statement: str, needed: set[str]) -> None:
    program = f"import json, sys\n{statement}\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert HEAVY & {name.split(".")[0] for name in json.loads(done.stdout)} == needed
