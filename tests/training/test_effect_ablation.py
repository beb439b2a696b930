"""The ablation of the simulator's effects at a tiny size: rows, continuing, and a folder of other rows."""

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from calibration.benchmark.effect_ablation import (
    ALL,
    NOT_TRAINED,
    OPTICAL,
    ROWS,
    VARIANTS,
    ablate,
    main,
)
from calibration.benchmark.short_trunks import TrialReading
from calibration.benchmark.trial import Trial
from calibration.fitting.nominal_presses import NominalPresses
from calibration.simulator.effects import EFFECTS as SIMULATED
from calibration.training.checkpoint import load
from calibration.training.train_config import EFFECTS, TrainConfig
from edge.core.errors import ConfigError

TINY = TrainConfig.shipped(steps=1, pairs=2, side=64, precision="float32", stages=1)
FEW = {ALL: EFFECTS, "dust": VARIANTS["dust"]}


def noisy() -> Trial:
    """Eight noisy grey presses to learn; two more, and two with a black square."""
    rng = np.random.default_rng(0)
    learnt = rng.integers(110, 140, (8, 64, 64, 3), dtype=np.uint8)
    scored, masks = rng.integers(110, 140, (4, 64, 64, 3), dtype=np.uint8), np.zeros((4, 64, 64), np.bool_)
    masks[2:, 24:40, 24:40] = True
    scored[masks] = 0
    nominal = NominalPresses(learnt, tuple(map(str, range(8))))
    return Trial("squares", nominal, scored, masks, np.zeros(4, np.bool_), alpha=0.05)


TRIALS = [TrialReading("squares", noisy), TrialReading("drawn", noisy, ("patchcore",), is_real=False)]
silent = partial(ablate, trials=TRIALS, variants=FEW, say=lambda _: None)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One seed of each, so four with every effect."""
    folder = tmp_path_factory.mktemp("done")
    silent(folder, TINY, 1)
    return folder


def test_each_trunk_has_a_row(done: Path) -> None:
    """Random weights, four seeds with every effect, one without dust; each trial by its methods."""
    rows = [json.loads(line) for line in (done / ROWS).read_text().splitlines()]

    assert [(row["without"], row["seed"]) for row in rows] == [
        (NOT_TRAINED, 0),
        *((ALL, seed) for seed in range(4)),
        ("dust", 0),
    ]
    assert {tuple(row["real"]) for row in rows} == {("squares",)}
    assert {name: list(of) for name, of in rows[0]["aupro_fpr01"].items()} == {
        "squares": ["padim", "patchcore"],
        "drawn": ["patchcore"],
    }


def test_a_trunk_is_learnt_from_the_presses_of_its_variant(done: Path) -> None:
    """With one seed and other effects the weights differ."""
    complete, without = (load(done / "runs" / name) for name in ("all_effects_0", "dust_0"))

    assert [complete.recipe.effects, without.recipe.effects] == [*FEW.values()]
    name = "trunk.conv1.weight"
    assert not torch.equal(complete.weights[name], without.weights[name])


def test_a_complete_run_trains_nothing_again(done: Path) -> None:
    """The same command says nothing and leaves the rows as they are."""
    before, said = (done / ROWS).read_bytes(), []
    ablate(done, TINY, 1, TRIALS, FEW, said.append)

    assert said == []
    assert (done / ROWS).read_bytes() == before


def test_an_interrupted_run_is_continued(done: Path, tmp_path: Path) -> None:
    """Half a line at the end is dropped, and the rows become those of an uninterrupted run."""
    expected = (done / ROWS).read_text()
    shutil.copytree(done / "runs", tmp_path / "runs")
    (tmp_path / ROWS).write_text(expected[:-40])
    said: list[str] = []
    ablate(tmp_path, TINY, 1, TRIALS, FEW, said.append)

    assert (tmp_path / ROWS).read_text() == expected
    assert [line.partition(":")[0] for line in said] == ["dust, seed 0"]


def test_rows_of_another_recipe_or_other_trials_are_refused(done: Path) -> None:
    """The sentence says what differs; the seed and the effects may."""
    with pytest.raises(ConfigError, match=r"has rows of another recipe .*'steps': 1.*choose another folder"):
        silent(done, TINY.model_copy(update={"steps": 2}), 1)
    with pytest.raises(ConfigError, match=r"has rows of another real \(\['squares'\], not \[\]\)"):
        ablate(done, TINY, 1, TRIALS[1:], FEW)


def test_every_variant_is_named_after_what_it_leaves_out() -> None:
    """One effect less each, and one without light and camera."""
    assert VARIANTS[ALL] == EFFECTS
    assert {name: {*EFFECTS} - {*VARIANTS[name]} for name in EFFECTS} == {name: {name} for name in EFFECTS}
    assert {SIMULATED[name].stage for name in VARIANTS[OPTICAL]} == {"pose", "surface"}


def test_an_unknown_variant_is_refused_with_the_nearest_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is measured."""
    assert main([str(tmp_path / "out"), "--tactile", str(tmp_path), "--only", "shadow"]) == 3
    assert "no variant is named 'shadow'; did you mean 'shadows'?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_names_a_folder_without_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is trained."""
    assert main([str(tmp_path / "out"), "--tactile", str(tmp_path / "none")]) == 3
    assert "none" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
