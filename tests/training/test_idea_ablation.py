"""The ablation of ideas at a tiny size: rows of both readings, ideas without frames, what is refused."""

import json
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

from calibration.benchmark.evaluation import random_trunk
from calibration.benchmark.idea_ablation import ROWS, Comparison, ablate, joined, main
from calibration.benchmark.ideas import BASE, DIFFERENCE, NOT_TRAINED, PHOTOGRAPH, PHOTOGRAPH_OF_IT
from calibration.benchmark.short_trunks import TrialReading
from calibration.benchmark.trial import Trial
from calibration.fitting.nominal_presses import NominalPresses
from calibration.training.checkpoint import load
from calibration.training.train_config import TrainConfig
from edge.model.session import open_session
from plugins.backbones.efficientnet_lite0 import PACKAGE

TINY = TrainConfig.shipped(steps=1, pairs=2, side=64, precision="float32", stages=1)


def noisy() -> Trial:
    """Eight noisy grey presses to learn; two more, and two with a square that is little darker."""
    rng = np.random.default_rng(0)
    learnt = rng.integers(110, 140, (8, 64, 64, 3), dtype=np.uint8)
    scored, masks = rng.integers(110, 140, (4, 64, 64, 3), dtype=np.uint8), np.zeros((4, 64, 64), np.bool_)
    masks[2:, 24:40, 24:40] = True
    scored[masks] -= 12
    nominal = NominalPresses(learnt, tuple(map(str, range(8))), no_contact=learnt[:1])
    return Trial("squares", nominal, scored, masks, np.zeros(4, np.bool_), alpha=0.05)


def comparison(folder: Path) -> Comparison:
    """One trial by one method; the folder of real frames is not there."""
    trials = [TrialReading("squares", noisy, ("patchcore",))]
    return Comparison(folder / "none", trials, lambda: noisy().nominal.frames)


@pytest.fixture(scope="module")
def package() -> None:
    try:
        distribution(PACKAGE)
    except PackageNotFoundError:
        pytest.skip("SKIPPED, NOT TESTED: the extra `comparison` brings the weights")


@pytest.fixture(scope="module")
def done(package: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """One seed of four ideas, one of which has no frames."""
    folder, said = tmp_path_factory.mktemp("done"), list[str]()
    ideas = (BASE, DIFFERENCE, "real gels", "distilled")
    ablate(folder, TINY, 1, comparison(folder), ideas, said.append)
    return folder, said


def test_each_trunk_has_a_row_with_both_readings(done: tuple[Path, list[str]]) -> None:
    """What is compared with, each idea, and two more of the base; alone and joined differ but for no trunk."""
    rows = [json.loads(line) for line in (done[0] / ROWS).read_text().splitlines()]

    assert [(row["idea"], row["seed"]) for row in rows] == [
        (NOT_TRAINED, 0),
        (PHOTOGRAPH, 0),
        (PHOTOGRAPH_OF_IT, 0),
        *((BASE, seed) for seed in range(3)),
        (DIFFERENCE, 0),
        ("distilled", 0),
    ]
    assert {tuple(row["joined_aupro_fpr01"]["squares"]) for row in rows} == {("patchcore",)}
    assert [row["idea"] for row in rows if row["aupro_fpr01"] == row["joined_aupro_fpr01"]] == [
        PHOTOGRAPH,
        PHOTOGRAPH_OF_IT,
    ]


def test_the_difference_is_read_from_differences(done: tuple[Path, list[str]]) -> None:
    """The same network of photographs finds other damage in them than in the frames."""
    rows = [json.loads(line) for line in (done[0] / ROWS).read_text().splitlines()]

    one, other = (next(row for row in rows if row["idea"] == name) for name in (PHOTOGRAPH, PHOTOGRAPH_OF_IT))
    assert one["aupro_fpr01"] != other["aupro_fpr01"]


def test_photographs_weigh_twice_as_much_in_a_joined_trunk(package: None) -> None:
    """On the frames that are given, over all channels."""
    frames = noisy().frames
    (maps,) = open_session(joined(random_trunk(), frames), 1, "trunk").run(["layer1"], {"frames": frames})

    felt, seen = (np.sqrt(part.sum()) for part in np.split(maps.var(axis=(0, 2, 3)), [64]))
    assert seen == pytest.approx(2 * felt, rel=1e-3)


def test_an_idea_without_its_frames_is_announced(done: tuple[Path, list[str]]) -> None:
    """Skipped, with the sentence about the picture that is missing."""
    assert [line for line in done[1] if "SKIPPED" in line] == [
        f"SKIPPED, NOT MEASURED: real gels: '{done[0]}/none/rpl-cmu__normalflow/background.png' is not there; "
        "fetch the real tactile frames again"
    ]


def test_an_idea_that_learns_weights_of_its_own_keeps_them(done: tuple[Path, list[str]]) -> None:
    """They are in the checkpoint, so an interrupted training goes on; the trunk begins as the base's."""
    own = {name for name in load(done[0] / "runs" / "distilled_0").weights if name.startswith("further.")}

    assert own == {"further.reading.weight", "further.reading.bias"}


def test_a_complete_run_trains_nothing_again(done: tuple[Path, list[str]]) -> None:
    """The same command says what is skipped, and leaves the rows as they are."""
    before, said = (done[0] / ROWS).read_bytes(), list[str]()
    ablate(done[0], TINY, 1, comparison(done[0]), (BASE, DIFFERENCE, "distilled"), said.append)

    assert said == []
    assert (done[0] / ROWS).read_bytes() == before


def test_an_unknown_idea_and_an_absent_folder_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the nearest name, or the folder's, before anything is trained."""
    assert main([str(tmp_path / "out"), "--tactile", str(tmp_path), "--only", "other dot"]) == 3
    assert "no idea is named 'other dot'; did you mean 'other dots'?" in capsys.readouterr().err
    assert main([str(tmp_path / "out"), "--tactile", str(tmp_path / "none")]) == 3
    assert "none' is no folder of real tactile frames" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
