"""Packaging: graphs equal to the trained network, variants of limited size, and a model card made of facts."""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest
import torch
from trunk_state import state_arrays

from calibration.benchmark.model_card import TRIALS_FORMAT, card, page
from calibration.benchmark.trial import FORMAT
from calibration.training import package as packaging
from calibration.training.network import TrunkNetwork
from calibration.training.train_config import STAGES, TrainConfig
from edge import cli
from edge.core.errors import ConfigError
from plugins.backbones.resnet import build_trunk


def run(graph: bytes, frames: np.ndarray) -> list[np.ndarray]:
    session = ort.InferenceSession(graph, providers=["CPUExecutionProvider"])
    answer: list[np.ndarray] = session.run(list(STAGES), {"frames": frames})
    return answer


def test_the_graph_is_the_network(trunk: TrunkNetwork) -> None:
    """The ONNX trunk answers as torch does, to 1e-4 of the largest feature, at two sizes."""
    graph = build_trunk(state_arrays(trunk), "resnet18", STAGES)
    for side in (64, 96):
        frames = np.random.default_rng(side).integers(0, 256, (2, side, side, 3), dtype=np.uint8)
        with torch.no_grad():
            expected = trunk(torch.tensor(frames.tolist(), dtype=torch.float32).permute(0, 3, 1, 2))
        for found, wanted in zip(run(graph, frames), expected, strict=True):
            assert np.abs(found - wanted.numpy()).max() < 1e-4 * float(wanted.max())


def test_int8_keeps_inputs_outputs_and_features(trunk: TrunkNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    """The int8 trunk takes the same frames and gives the same taps within a fifth, in a third of the bytes."""

    def few(purpose: str, batches: int, pairs: int = 2) -> object:
        rng = np.random.default_rng(batches)
        return iter([rng.integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)])

    monkeypatch.setattr(packaging, "calibration_frames", few)
    plain = build_trunk(state_arrays(trunk), "resnet18", STAGES)
    small = packaging.quantised(plain, batches=1)
    assert len(small) < len(plain) / 3
    assert len(small) < packaging.MOST_BYTES
    errors = packaging.feature_errors(small, plain)
    assert list(errors) == list(STAGES)
    assert 0 < max(errors.values()) < 0.2
    half = build_trunk(state_arrays(trunk), "resnet18", STAGES, weights="float16")
    assert len(half) < packaging.MOST_BYTES
    assert max(packaging.feature_errors(half, plain).values()) < 0.005


BACKBONES = Path(__file__).parents[2] / "plugins" / "backbones"
FACTS = {
    "name": "tactile_resnet18",
    "topology": "resnet18",
    "taps": list(STAGES),
    "recipe": {"seed": 0, "steps": 5},
    "trained_steps": 5,
    "pairs_seen": 10,
    "last_entry": {"step": 5, "geometry": 0.1234567},
    "variants": {
        "tactile_resnet18": {
            "bytes": 7,
            "sha256": "ab" * 32,
            "relative_error": dict.fromkeys(STAGES, 0.00012),
        }
    },
}


def evaluation(measures: dict[str, object]) -> dict[str, object]:
    """An evaluation file with one row, and a set that was left out."""
    row = {"backbone": "trained", "detector": "padim", "measures": measures}
    return {
        "format": FORMAT,
        "replicates": 200,
        "settings": {"padim": {"taps": ["layer1", "layer2"], "rank": 16, "channels": None}},
        "trunks": {"trained": {"sha256": "ab" * 32}, "pairs": {"sha256": "cd" * 32}},
        "sets": {
            "parts": {"title": "Unseen parts", "text": "Five.", "trials": ["PZ1"], "rows": [row]},
            "screws": {"title": "Screws", "text": "Turned.", "missing": "no folder was given"},
        },
    }


def test_the_card_has_the_facts_and_the_evaluation() -> None:
    """Every number of the card is in the facts or the evaluation; without an evaluation it says so."""
    assert "Not evaluated yet" in card(FACTS, None)
    measures = {"aupro_fpr01": {"value": 0.71, "over_images": [0.65, 0.77]}, "image_auroc": {"value": None}}
    text = card(FACTS, evaluation(measures))
    assert "| trained | padim | 0.710 (0.650 to 0.770) | - |" in text
    assert "- padim: taps layer1 and layer2, rank 16" in text
    assert "Not measured: no folder was given." in text
    assert "0.1235" in text
    assert "abababababababab" in text
    assert "Training trials" not in text


def test_the_card_has_the_trunk_for_real_touch() -> None:
    """The means over the detectors, over the trials and of each; without its facts the card has no such section."""
    rows = [
        {
            "backbone": "own",
            "detector": name,
            "measures": {"aupro_fpr01": {"value": a}, "image_auroc": {"value": b}},
            "trials": {"ball": {"aupro_fpr01": c}, "finger": {"aupro_fpr01": 2 * a - c}},
        }
        for name, a, b, c in (("padim", 0.2, 0.9, 0.1), ("spade", 0.4, 0.7, 0.6))
    ]
    balls = {"title": "Touch", "text": "Balls.", "trials": ["ball", "finger"], "rows": rows}
    touch = {
        "facts": {
            "bytes": 7,
            "sha256": "ef" * 32,
            "channels": {"tactile": 64, "efficientnet_lite0": 24},
            "blocks": 1,
            "tactile_scale": 4.5,
        },
        "evaluation": {"trunks": {"own": {}}, "sets": {"touch": balls}},
        "trials": {
            "text": "Tried.",
            "trials": ["ball"],
            "rows": [{"note": "wide", "measures": {"padim": {}}}],
        },
    }
    text = card(FACTS, None, touch=touch)
    assert "| own | 0.300 | 0.800 | 0.350 | 0.250 |" in text
    assert "| wide | padim | - |" in text
    assert "The trunk for real touch" not in card(FACTS, None)


def test_the_card_prints_no_evaluation_of_other_weights() -> None:
    """An evaluation of other files is ignored."""
    other = {**evaluation({"aupro_fpr01": {"value": 0.7}}), "trunks": {"trained": {"sha256": "ef" * 32}}}
    for stale in (other, {**evaluation({"aupro_fpr01": {"value": 0.7}}), "format": 1}):
        text = card(FACTS, stale)
        assert "Not evaluated yet" in text
        assert "0.700" not in text


def test_the_card_tells_what_was_tried() -> None:
    """One row per run: how its settings differ from those that ship, its numbers by method, and the means per set."""
    recipe = json.loads(TrainConfig.shipped(seed=0, steps=9, window_mm=0.25).to_json())
    measures = {
        name: {"aupro_fpr01": value, "image_auroc": 0.9}
        for name, value in (("padim", 0.7512), ("spade", 0.7))
    }
    row = {
        "name": "longer",
        "note": "on a Tuesday",
        "before": 0,
        "recipe": recipe,
        "measures": {"parts": measures},
    }
    tried = {"format": TRIALS_FORMAT, "sets": {"parts": "Unseen parts"}, "rows": [row]}
    facts = {**FACTS, "recipe": json.loads(TrainConfig.shipped(seed=0, steps=5, window_mm=0.5).to_json())}
    text = card(facts, None, tried)
    assert "| trial | settings | padim: parts | spade: parts | AU-PRO: parts | AUROC: parts |" in text
    assert "| longer | on a Tuesday; steps 9, window_mm 0.25 | 0.751 | 0.700 | 0.726 | 0.900 |" in text
    assert "Training trials" not in card(facts, None, {**tried, "rows": []})


def test_the_page_names_the_call_that_made_its_tables(tmp_path: Path) -> None:
    """Trunks that do not ship are named as runs of their own; random weights need no name."""
    (tmp_path / "tactile_resnet18.json").write_text(json.dumps(FACTS))
    found = evaluation({"aupro_fpr01": {"value": 0.7}})
    (tmp_path / "tactile_resnet18_evaluation.json").write_text(json.dumps(found))
    assert "gelgate train-backbone RUN1 --set steps=5 --package plugins/backbones" in page(tmp_path)
    assert (
        "gelgate evaluate-backbone plugins/backbones trained=tactile_resnet18 trained_int8=tactile_resnet18_int8 "
        "pairs=RUN_pairs/tactile_resnet18.onnx --workers 2"
    ) in page(tmp_path)


def test_the_card_needs_its_facts(tmp_path: Path) -> None:
    """Missing or invalid facts give one error and no page; with facts alone there is a page."""
    with pytest.raises(ConfigError, match="package the run again"):
        page(tmp_path)
    file = tmp_path / "tactile_resnet18.json"
    file.write_text(json.dumps({**FACTS, "variants": {"tactile_resnet18": {}}}))
    with pytest.raises(ConfigError, match="package the run again"):
        page(tmp_path)
    file.write_text(json.dumps(FACTS))
    assert "# The tactile backbone" in page(tmp_path)


def command(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["gelgate", "train-backbone", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


def test_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file and --set give the recipe: one small step runs, a second start in the same folder is refused, and a
    missing torch names the extra.
    """
    recipe = tmp_path / "small.toml"
    recipe.write_text("steps = 1\npairs = 1\nside = 32\n")
    small = (str(tmp_path / "run"), "--recipe", str(recipe), "--set", "side=64", "--device", "cpu")
    assert command(monkeypatch, *small, "--set", "side=100") == 3
    assert "'side' is 100" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert command(monkeypatch, *small) == 0
    assert "step 1/1" in capsys.readouterr().err
    assert command(monkeypatch, *small) == 3
    assert "already holds a run" in capsys.readouterr().err
    assert command(monkeypatch, *small, "--resume", "--set", "seed=1") == 3
    assert "seed: 1, not 0" in capsys.readouterr().err
    for name in [n for n in sys.modules if n.startswith("calibration.training.t")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    assert command(monkeypatch, *small) == 3
    assert "pip install 'gelgate[train]'" in capsys.readouterr().err
