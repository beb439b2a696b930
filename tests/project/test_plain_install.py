"""Every verb in an environment with `gelgate` and no extras: it works, or names at its start what it needs.

Run by `make test-plain`.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import onnx.parser
import pytest
from station import JSONL, press_recording, station_config
from tracked_tree import copy_tracked

from edge import registry
from edge.cli import place

pytestmark = pytest.mark.plain

# In the order in which they are run: the line, its exit code, and words of what it says.
VERBS: list[tuple[str, int, str]] = [
    ("devices", 0, ""),
    ("new sink webhook", 0, "pytest gelgate-webhook"),
    ("station docs", 0, "architecture"),
    ("station topics", 0, "result"),
    ("station install-service --print", 3, "/opt/gelgate"),
    ("station install-service --print --remove", 0, "udev"),
    ("lab simulate demo -o simulated --run nominal --presses 1", 0, "recording: simulated"),
    ("record copy --device recorded --option recording=nominal --option pace=0", 0, ""),
    ("fit nominal -o pz0 --part PZ0", 0, "bundle PZ0/default written"),
    (
        "fit nominal -o other --part PZ0 --backbone tactile_lite0 --set ridge=0.3",
        0,
        "bundle PZ0/default written",
    ),
    ("bundle verify pz0", 0, "sound"),
    ("bundle inspect pz0", 0, "padim"),
    ("bundle wrap theirs.onnx nominal -o theirs --part PZ0 --licence MIT", 0, "written"),
    ("bundle carry pz0 nominal -o carried --gel G2", 3, "expected 4 to 8"),
    ("bundle acquire nominal -o pressed --part PZ0", 0, "gelgate fit"),
    (
        "new-part PZ0 -c new/station.toml --device usb_mock --option recording=nominal --option pace=0 --promise 0.2 "
        "--yes",
        0,
        "PZ0 is ready after",
    ),
    ("evaluate pz0 dataset --part * --position * --bootstrap 20 --sheet sheet.png", 0, "image_auroc"),
    ("check --config gelgate.toml", 0, "ok"),
    ("run --config gelgate.toml", 0, "12 presses"),
    ("bundle learn pz0 nominal -o learnt --config gelgate.toml", 3, "say what presses were"),
    ("bundle teach pz0 nominal --damaged 01J --config gelgate.toml", 1, "no press 01J"),
    ("bundle regions pz0 --add 'ignore logo 6,6 8,6 8,8' -o logo", 0, "ignored: "),
    ("station overview --config gelgate.toml", 3, "has no [overview]"),
    ("station replay --all --config gelgate.toml", 0, "12 equal"),
    ("station reference press --config gelgate.toml", 3, "names no master piece"),
    ("station reference chart --config gelgate.toml", 0, "no reference press"),
    ("lab msa plan --pieces 2 --operators 2 --repeats 2 -o plan.toml", 0, "8 presses"),
    (
        "lab calibrate nominal/frames --simulator --no-contact nominal/frames/000000.jpg --ball-radius-mm 3 -o s.toml",
        3,
        "",
    ),
    (
        "lab calibrate nominal/frames --heights --no-contact nominal/frames/000000.jpg --ball-radius-mm 3 -o h.toml",
        3,
        "",
    ),
    ("station heights nominal/frames/000000.jpg -o a.png", 3, "this sensor is not calibrated"),
    ("station page --allow-from 10.0.0.1", 3, "bind"),
    ("gel show --config gelgate.toml", 0, "12"),
    ("gel prove --config gelgate.toml", 0, "is proven on it"),
    ("history --config gelgate.toml", 0, "12 presses"),
    ("history --config gelgate.toml -o presses.csv", 0, "12 presses in presses.csv"),
    ("history --config gelgate.toml -o presses.parquet", 3, "gelgate[parquet]"),
    ("db check --config gelgate.toml", 0, "sound"),
    ("station acts --config gelgate.toml", 0, ""),
    ("station describe --config gelgate.toml", 0, "asyncapi"),
    ("watch --port 1 --timeout 1 --count 1", 4, "no broker answers"),
    ("watch --port 1 --validate", 3, "gelgate[validate]"),
    ("export tiles pz0/trunk.onnx -o tiles.onnx", 0, "tiles.onnx"),
    ("export merge pz0 -o merged.onnx", 3, "fit it again with --set register=never"),
    ("export backbone weights.pth --licence MIT", 3, "weights.pth"),
    ("export openvino pz0", 3, "gelgate[openvino]"),
    ("export import theirs.onnx nominal -o x --licence MIT --part PZ0", 3, ""),
    ("export precision pz0 nominal -o x", 0, "x"),
    ("export parity pz0 stages.npz", 3, "stages.npz"),
    ("bundle keys new maker", 3, "gelgate[signing]"),
    ("bundle sign pz0 --key maker.key", 3, "gelgate[signing]"),
    ("lab train-backbone training", 3, "gelgate[train]"),
    ("lab evaluate-backbone evaluation --set nothing", 3, "no set of trials is named"),
    ("lab study good-fraction dataset -o studies", 3, "gelgate[studies]"),
    ("lab study good-fraction dataset -o studies --dask tcp://127.0.0.1:1", 3, "gelgate[cluster]"),
    ("lab report studies -o report", 3, "gelgate[studies]"),
    ("lab msa report", 3, "gelgate[studies]"),
    ("lab recommend studies", 3, "gelgate[studies]"),
    ("lab tradeoff dataset -o tradeoff", 3, "gelgate[studies]"),
    ("lab bench pz0 nowhere", 3, "nowhere"),
    ("lab month -o month", 3, "gelgate[studies]"),
    ("lab detectability pz0 nominal -o found", 3, "gelgate[studies]"),
]
# `make demo` runs it in an environment with the one package, a broker, that it needs where mosquitto is missing.
ELSEWHERE = {"demo"}

THEIRS = """
    < ir_version: 8, opset_import: ["" : 17] >
    theirs (uint8[n, h, w, 3] frames) => (float[n, h, w] score_map, float[n] score)
    {
        pixels = Cast <to = 1> (frames)
        score_map = ReduceMean <axes = [3], keepdims = 0> (pixels)
        score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
    }
"""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `bin` of a new environment with the tree as git knows it, and no extras."""
    home = tmp_path_factory.mktemp("environment")
    source = copy_tracked(tmp_path_factory.mktemp("source"))
    subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
    uv = [Path(sys.executable).parent / "uv", "pip", "install", "--quiet", "--python", home / "bin/python"]
    subprocess.run([*uv, source], check=True)
    return home / "bin"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with presses, a dataset of two pictures, a foreign graph and a station's configuration."""
    folder = tmp_path_factory.mktemp("desk")
    press_recording(folder / "nominal", 12, seed=1)
    (folder / "theirs.onnx").write_bytes(onnx.parser.parse_model(THEIRS).SerializeToString())
    station_config(folder, folder / "nominal", folder / "pz0", sinks=JSONL % (folder / "out"))
    frames = sorted((folder / "nominal" / "frames").iterdir())[34:38]
    mask = np.zeros((240, 320), np.uint8)
    mask[100:140, 140:180] = 255
    for number, path in enumerate(frames):
        kind = "good" if number % 2 else "dent"
        name = f"bolt_test_s{number:03d}_p01"
        picture = cv2.imread(str(path))
        if kind == "dent":
            picture[mask > 0] = 255
            (folder / "dataset/ground_truth/dent").mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / f"dataset/ground_truth/dent/{name}_mask.png"), mask)
        (folder / "dataset/test" / kind).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / f"dataset/test/{kind}/{name}.png"), picture)
    return folder


def test_every_verb_works_or_names_its_extra(plain: Path, desk: Path) -> None:
    """No verb ends in a traceback, and none refuses after it has worked."""
    faults = {}
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    for line, code, words in VERBS:
        done = subprocess.run(
            [plain / "gelgate", *shlex.split(line)],
            cwd=desk, env=environment, capture_output=True, text=True, timeout=1800, check=False,
        )  # fmt: skip
        said = done.stdout + done.stderr
        if done.returncode != code or words not in said or "Traceback" in said:
            faults[line] = (done.returncode, said[-600:])
        if code == 3:
            assert "%" not in said, line  # no stage had begun

    assert faults == {}


def test_the_table_has_every_verb() -> None:
    names = set(registry.names("commands"))
    run = {name for name in names if any(f"{line} ".startswith(f"{place(name)} ") for line, _, _ in VERBS)}
    assert run == names - ELSEWHERE


def test_nothing_is_installed_that_nothing_imports(plain: Path) -> None:
    """The packages of the extras are absent, and so is what only the card once named."""
    listed = subprocess.run(
        [plain / "pip", "list"], capture_output=True, text=True, check=True
    ).stdout.lower()
    packages = {line.split()[0] for line in listed.splitlines()[2:] if line.strip()}

    extras = {"hidapi", "depthai", "zxing-cpp", "matplotlib", "scipy", "scikit-learn", "torch", "amqtt"}
    assert not packages & extras
    assert "threadpoolctl" in packages
