"""What a start costs: no heavy module is imported before it is used."""

import json
import subprocess
import sys

HEAVY = {
    "torch",
    "onnx",
    "onnxscript",
    "depthai",
    "zxingcpp",
    "matplotlib",
    "sklearn",
    "scipy",
    "cv2",
    "onnxruntime",
    "usb",
    "paho",
}


def modules_after(statement: str) -> set[str]:
    program = f"import json, sys\n{statement}\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in json.loads(done.stdout)}


def test_building_the_command_line_imports_nothing_heavy() -> None:
    """`gelgate --help` needs typer and every verb's signature, and nothing that computes."""
    loaded = modules_after("import typer, edge.cli; dict(typer.main.get_command(edge.cli.build()).commands)")

    assert not HEAVY & loaded


def test_the_gateway_imports_no_training_module() -> None:
    """Starting the gateway imports neither torch, onnx, depthai, matplotlib nor scikit-learn."""
    loaded = modules_after("import edge.gateway.gateway")

    assert not {"torch", "onnx", "onnxscript", "depthai", "matplotlib", "sklearn", "scipy"} & loaded
    assert {"onnxruntime", "cv2"} <= loaded
