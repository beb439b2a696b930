"""The evaluation: what is learnt is not scored, plain cases get plain numbers, and refusals are sentences."""

from pathlib import Path

import numpy as np
import pytest

from calibration.backbone import evaluation_sets
from calibration.backbone.evaluation import evaluate, main
from calibration.backbone.evaluation_sets import Trial, real_trials, simulated_trials
from calibration.presses import NominalPresses
from calibration.simulator.field import LR
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk


def trial(name: str, seed: int) -> Trial:
    """Sixteen noisy grey presses to learn; four more, four with a black square, and two white foreign frames."""
    rng = np.random.default_rng(seed)

    def grey(n: int) -> np.ndarray:
        return rng.integers(110, 140, (n, 64, 64, 3), dtype=np.uint8)

    scored, masks = grey(10), np.zeros((10, 64, 64), np.bool_)
    masks[4:8, 24:40, 24:40] = True
    scored[masks] = 0
    scored[8:] = rng.integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)
    nominal = NominalPresses(grey(16), tuple(map(str, range(16))))
    return Trial(name, nominal, scored, masks, np.arange(10) >= 8)


def test_a_black_square_is_found() -> None:
    """Two trials of an obvious defect: image AUROC 1, foreign frames far out, intervals around the mean of both."""
    found = evaluate(
        {"random": build_trunk(random_state("resnet18"), "resnet18")},
        {"squares": lambda: [trial("a", 0), trial("b", 1)]},
        ("padim",),
        replicates=20,
    )
    (row,) = found["sets"]["squares (a, b)"]
    assert (row["backbone"], row["detector"]) == ("random", "padim")
    assert row["measures"]["image_auroc"] == {"value": 1.0, "over_images": [1.0, 1.0]}
    assert row["measures"]["foreign_out"]["value"] == 1.0
    pixel = row["measures"]["pixel_auroc"]
    assert 0.8 < pixel["over_images"][0] <= pixel["value"] <= pixel["over_images"][1] <= 1
    each = [row["trials"][name]["pixel_auroc"] for name in ("a", "b")]
    assert np.isclose(np.mean(each), pixel["value"], atol=1e-4)


def test_simulated_trials_hold_pieces_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No learnt piece is scored, damaged presses have masks, and the unseen sensor looks different."""
    for name, value in (
        ("_PIECES", 3),
        ("_HELD_OUT", 1),
        ("_PRESSES", 1),
        ("_DAMAGED", 1),
        ("_FREE_GELS", 1),
    ):
        monkeypatch.setattr(evaluation_sets, name, value)
    (known,) = simulated_trials(tmp_path, is_unseen_sensor=False, parts=("PZ3",))
    assert len(known.nominal) == 2
    assert known.frames.shape == (2, 224, 224, 3)
    assert sorted(bool(m.any()) for m in known.masks) == [False, True]
    assert known.nominal.touched is not None
    assert known.nominal.no_contact is not None
    (other,) = simulated_trials(tmp_path, is_unseen_sensor=True, parts=("PZ3",))
    free = [
        t.nominal.no_contact.astype(float).mean(axis=(0, 1, 2))
        for t in (known, other)
        if t.nominal.no_contact is not None
    ]
    assert np.abs(free[0] - free[1]).max() > 5


def test_an_edit_changes_its_place_alone() -> None:
    """A bump rendered into a frame moves pixels at its mask, and none further than 2 mm from it."""
    background = np.full((240, 320, 3), 120, np.uint8)
    press = background.copy()
    press[100:140, 140:180] = 160
    edited, mask = evaluation_sets._edited(press, background, np.random.default_rng(0))
    assert mask.any()
    assert (edited != press).any()
    row, column = (axis.mean() for axis in np.nonzero(mask))
    rows, columns = np.nonzero((edited != press).any(axis=2))
    assert np.hypot(rows - row, columns - column).max() * LR.mm_per_px[0] < 2


def test_missing_real_frames_give_no_trial(tmp_path: Path) -> None:
    """Where the real frames are not at hand, nothing is claimed about them."""
    assert list(real_trials(tmp_path)) == []


def test_an_unknown_backbone_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The sentence names it, and nothing is written."""
    assert main(["--out", str(tmp_path / "out"), "resnet_of_nowhere"]) == 3
    assert "resnet_of_nowhere" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
