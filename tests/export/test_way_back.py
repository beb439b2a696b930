"""A bundle in other programs: plain Python without gelgate, OpenVINO, and a comparison with the research model."""

import ast
import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tiny
from command_line import Outcome, gelgate, ran
from numpy.typing import NDArray

from edge.core.detector import Bank, Grid
from edge.core.imaging.region import Region
from edge.core.imaging.tiles import Tiles
from edge.model.bundle import Bundle, GoldenFrame, Graphs
from edge.model.bundle_writer import bundle_files, write_bundle
from edge.model.manifest import GridEntry
from edge.model.scorer import Scorer
from plugins.backbones.tiled import tile_trunk

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "score_bundle.py"


def smooth(seed: int) -> NDArray[np.uint8]:
    """A frame whose PNG uses every kind of line filter."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((32, 32))
    waves = 128 + 60 * np.sin(rows / 5 + seed) + 40 * np.cos(columns / 3)
    return np.clip(waves[..., None] + rng.normal(0, 3, (32, 32, 3)) * (rows > 16)[..., None], 0, 255).astype(
        np.uint8
    )


def scored(*arguments: object) -> str:
    """The example as a program of its own, isolated from this installation's import path."""
    command = [sys.executable, "-I", "-W", "error", str(EXAMPLE), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("packing", "name"), [("none", "bolt"), ("float16", "bolt.zip"), ("int8", "bolt")])
def test_the_example_scores_as_the_gateway(tmp_path: Path, packing: str, name: str) -> None:
    """Golden frames out of their PNG, and a frame of one's own: the scores of gelgate's scorer, to six digits."""
    bank = tiny.tiny_bank(0.47, packing)  # type: ignore[arg-type]
    plain = Bundle.in_memory(*tiny.tiny_files(bank))
    scores = [Scorer(plain).score(smooth(seed)).anomaly_score for seed in range(3)]
    golden = [GoldenFrame(smooth(k), f"frame {k}", score, ((0.0,),)) for k, score in enumerate(scores)]
    write_bundle(tmp_path / name, tiny.tiny_files(bank, golden=golden)[1])
    lines = scored(tmp_path / name).splitlines()
    assert lines == [f"frame {k}: score {score:.6g}, expected {score:.6g}" for k, score in enumerate(scores)]
    np.save(tmp_path / "press.npy", smooth(7))
    expected = Scorer(plain).score(smooth(7))
    verdict = plain.manifest.decide(expected.anomaly_score).kind.value
    assert f"score {expected.anomaly_score:.6g}, {verdict}, largest at" in scored(
        tmp_path / name, tmp_path / "press.npy"
    )


def test_the_example_smooths_a_frame_of_ones_own(tmp_path: Path) -> None:
    """As the gateway does; golden frames are smoothed already."""
    changes = {"bank": tiny.tiny_bank(0.47), "is_smoothed": True}
    plain = Scorer(Bundle.in_memory(*tiny.tiny_files(**changes)))
    golden = GoldenFrame(smooth(0), "frame", plain.score_prepared(smooth(0)).anomaly_score, ((0.0,),))
    write_bundle(tmp_path / "bolt", tiny.tiny_files(**changes, golden=[golden])[1])
    np.save(tmp_path / "press.npy", smooth(7))
    assert scored(tmp_path / "bolt") == f"frame: score {golden.score:.6g}, expected {golden.score:.6g}\n"
    expected = plain.score(smooth(7)).anomaly_score
    assert f"score {expected:.6g}, " in scored(tmp_path / "bolt", tmp_path / "press.npy")
    assert f"{expected:.6g}" != f"{plain.score_prepared(smooth(7)).anomaly_score:.6g}"


def test_the_example_runs_tiles(tmp_path: Path) -> None:
    """Two tiles next to each other: the features are placed as the gateway places them."""
    tiles = Tiles((32, 64), 32, (0,), (0, 32))
    grid = Grid((32, 64), {"layer1": (3, 4, 8), "layer2": (3, 2, 4)}, tiny.PROFILE.pixels_per_mm, tiles)
    bank = Bank({"mean": np.random.default_rng(0).random((3, 4, 8)).astype(np.float32)})
    graphs = Graphs(tile_trunk(tiny.tiny_trunk(), tiles), tiny.TINY.head(grid, bank, tiny.TinyParameters()))
    profile = dataclasses.replace(tiny.PROFILE, size=(64, 32), native=(64, 32))
    region = Region(0, 0, 64, 32)
    facts = tiny.tiny_facts(profile=profile, region=region, grid=GridEntry.of(grid))
    manifest, files = bundle_files(facts, graphs, bank, backbone="tiny")
    write_bundle(tmp_path / "bolt", files)
    frame = np.concatenate([smooth(1), smooth(2)], axis=1)
    np.save(tmp_path / "press.npy", frame)
    expected = Scorer(Bundle.in_memory(manifest, files)).score(frame)
    assert f"score {expected.anomaly_score:.6g}" in scored(tmp_path / "bolt", tmp_path / "press.npy")


def test_the_example_needs_numpy_and_onnxruntime_alone() -> None:
    """Nothing of gelgate, and nothing else that is installed."""
    tree = ast.parse(EXAMPLE.read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.split(".")[0] for name in imported} - set(sys.stdlib_module_names) == {
        "numpy",
        "onnxruntime",
    }


def test_openvino_computes_the_same(tmp_path: Path) -> None:
    """The .xml and .bin score a frame as the gateway does; existing files are kept; other names are refused."""
    openvino = pytest.importorskip("openvino", reason="SKIPPED, NOT TESTED: needs the extra 'openvino'")
    manifest, files = tiny.tiny_files(tiny.tiny_bank(0.47, "int8"))
    write_bundle(tmp_path / "bolt", files)
    words = ("export", "openvino", tmp_path / "bolt", "-o")
    assert "INFERENCE_PRECISION_HINT" in ran(*words, tmp_path / "new" / "bolt.xml")
    assert sorted(file.name for file in (tmp_path / "new").iterdir()) == ["bolt.bin", "bolt.xml"]
    exact = {"INFERENCE_PRECISION_HINT": "f32"}
    compiled = openvino.Core().compile_model(tmp_path / "new" / "bolt.xml", "CPU", exact)
    expected = Scorer(Bundle.in_memory(manifest, files)).score(smooth(1))
    np.testing.assert_allclose(compiled(smooth(1)[None])["score"][0], expected.anomaly_score, rtol=1e-4)
    assert gelgate(*words, tmp_path / "new" / "bolt.xml").code == 3
    assert "a file .xml with a file .bin" in gelgate(*words, tmp_path / "bolt.onnx").sentence()


@pytest.fixture
def stages(tmp_path: Path) -> dict[str, NDArray[np.generic]]:
    """What a research model computes: the tiny detector in NumPy."""
    write_bundle(tmp_path / "bolt", tiny.tiny_files()[1])
    frames = np.stack([smooth(seed) for seed in range(4)])
    planes = frames.transpose(0, 3, 1, 2) / 255
    cells = planes.reshape(4, 3, 4, 8, 4, 8).mean(axis=(3, 5))
    distance = np.linalg.norm(cells - 0.5, axis=1)
    score_map = distance.repeat(8, axis=1).repeat(8, axis=2)
    taps = {"frames": frames, "layer1": cells, "cell": distance[:, None]}
    return {**taps, "map": score_map, "score": score_map.max(axis=(1, 2))}


def parity(folder: Path, stages: dict[str, NDArray[np.generic]], *more: object) -> Outcome:
    np.savez(folder / "stages.npz", **stages)
    return gelgate("export", "parity", folder / "bolt", folder / "stages.npz", *more)


def test_research_is_compared_stage_by_stage(tmp_path: Path, stages: dict[str, NDArray[np.generic]]) -> None:
    """Taps, a value inside the head, map, score and order agree; where half a level is added, that stage is named."""
    done = parity(tmp_path, stages, "--report", tmp_path / "report")
    assert done.code == 0, done.err
    names = [line.split("'")[1] for line in done.out.splitlines() if line.startswith("equal")]
    assert names == ["layer1", "cell", "map", "score", "order of the presses"]
    assert (tmp_path / "report" / "parity.html").is_file()
    other = parity(tmp_path, stages | {name: stages[name] + 0.5 for name in ("cell", "map")})
    assert other.code == 5
    assert "stage 'cell': largest difference" in other.err
    assert "(equal before it: layer1)" in other.err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"frames": np.zeros((2, 8, 8, 3), np.uint8)},
            r"'frames' is uint8 \(2, 8, 8, 3\), expected uint8 \(n, 32",
        ),
        (
            {"map": np.zeros((4, 256, 256))},
            r"'map' is \(4, 256, 256\), expected \(4, 32, 32\).*resize the maps",
        ),
        ({"layer9": np.zeros(3)}, r"has no stage 'layer9'; known are input, map, score, its taps"),
        ({"layer1": np.array([{}], dtype=object)}, "not an .npz of plain arrays"),
    ],
)
def test_what_cannot_be_compared(
    tmp_path: Path, stages: dict[str, NDArray[np.generic]], change: dict[str, NDArray[np.generic]], words: str
) -> None:
    """Frames of another size, an unknown stage, pickled objects."""
    assert re.search(words, parity(tmp_path, stages | change).sentence())
