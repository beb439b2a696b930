"""The training loop on a few small steps: loss falls, a resumed run equals an uninterrupted one, errors are clear."""

import json
import multiprocessing
import os
import re
import shutil
import signal
from pathlib import Path

import pytest
import torch

from calibration.training import checkpoint as checkpoints
from calibration.training import train as module
from calibration.training.train import TrainingRun, train
from calibration.training.train_config import TrainConfig
from edge.core.errors import ConfigError, GelgateError

SMALL = TrainConfig.shipped(steps=6, pairs=2, side=64, precision="float32", max_rate=2e-3)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six steps without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    train(SMALL, TrainingRun(folder, log_every=1, validate_every=3, threads=1, device="cpu"))
    return folder


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return checkpoints.load(folder).weights


def test_a_resumed_run_equals_an_uninterrupted_one(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted within the fourth step, then two more in another folder: equal bit for bit, one continuous log."""
    first, second = tmp_path / "first", tmp_path / "second"
    calls = 0

    def interrupt_within_the_fourth(*args: object, **kwargs: object) -> object:
        nonlocal calls
        calls += 1
        if calls == 4:
            os.kill(os.getpid(), signal.SIGINT)
        return original(*args, **kwargs)

    original = module.losses
    monkeypatch.setattr(module, "losses", interrupt_within_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        train(SMALL, TrainingRun(first, log_every=1, validate_every=3, threads=1, device="cpu"))
    monkeypatch.undo()
    assert checkpoints.load(first).step == 4
    train(SMALL, TrainingRun(second, resume=first, log_every=1, validate_every=3, threads=1, device="cpu"))
    expected, found = weights(whole), weights(second)
    assert expected.keys() == found.keys()
    assert all(torch.equal(expected[name], found[name]) for name in expected)
    steps = [json.loads(line)["step"] for line in (second / "log.jsonl").read_text().splitlines()]
    assert steps == [1, 2, 3, 4, 5, 6]


def test_drawing_ahead_changes_nothing(whole: Path, tmp_path: Path) -> None:
    """With batches from a second process the weights are the same bits; a run depends only on its recipe."""
    train(SMALL, TrainingRun(tmp_path / "again", threads=1, device="cpu", is_drawn_ahead=True))
    found = weights(tmp_path / "again")
    assert all(torch.equal(value, found[name]) for name, value in weights(whole).items())
    other = TrainConfig(**{**vars(SMALL), "seed": 1, "steps": 1})
    train(other, TrainingRun(tmp_path / "other", threads=1, device="cpu"))
    name = "trunk.conv1.weight"
    assert not torch.allclose(weights(whole)[name], weights(tmp_path / "other")[name], atol=1e-2)


def test_a_dead_drawing_process_is_reported() -> None:
    """Killed after its first batch: a sentence with what to do."""
    others = set(multiprocessing.active_children())
    batches = module._draw_ahead(SMALL.model_copy(update={"steps": 100}), 0, 1)
    next(batches)
    (drawer,) = set(multiprocessing.active_children()) - others
    assert drawer.pid is not None
    os.kill(drawer.pid, signal.SIGKILL)
    with pytest.raises(GelgateError, match="the drawing process ended"):
        list(batches)


def test_a_run_begins_with_anothers_weights(whole: Path, tmp_path: Path) -> None:
    """The second run starts from the first, records it, and refuses a start that its recipe does not name."""
    recipe = TrainConfig(
        **{**vars(SMALL), "steps": 1, "start": checkpoints.weights_sha256(whole), "max_rate": 1e-9}
    )
    train(recipe, TrainingRun(tmp_path / "second", threads=1, device="cpu", start=whole))
    found = checkpoints.load(tmp_path / "second")
    assert [run["steps"] for run in found.history] == [6, 1]
    name = "trunk.layer1.0.conv1.weight"
    assert torch.allclose(found.weights[name], weights(whole)[name], atol=1e-6)
    with pytest.raises(ConfigError, match="the recipe starts from"):
        train(recipe, TrainingRun(tmp_path / "third", threads=1, device="cpu", start=tmp_path / "second"))
    with pytest.raises(ConfigError, match="and --start names ''"):
        train(recipe, TrainingRun(tmp_path / "fourth", threads=1, device="cpu"))


def test_the_loss_falls_on_a_repeated_batch() -> None:
    """Twelve steps on one batch halve the geometry loss."""
    recipe = TrainConfig.shipped(
        steps=12, pairs=2, side=64, precision="float32", warm_up=0.0, max_rate=2e-3, high_resolution=0.25
    )
    torch.set_num_threads(1)
    learner = module._Learner(recipe, torch.device("cpu"))
    batch = module._draw_step(recipe, 0)
    found = [learner.learn(batch) for _ in range(12)]
    assert found[-1].geometry.item() < 0.5 * found[0].geometry.item()
    assert found[-1].total(recipe).item() < found[0].total(recipe).item()


def test_other_settings_are_refused(whole: Path, tmp_path: Path) -> None:
    """A resume with another margin names the setting and both values."""
    changed = TrainConfig(**{**vars(SMALL), "margin": 0.5})
    with pytest.raises(ConfigError, match=r"other settings \(margin: 0\.5, not 1\.0\)"):
        train(changed, TrainingRun(tmp_path, resume=whole, device="cpu"))
    with pytest.raises(ConfigError, match="already holds a run"):
        train(SMALL, TrainingRun(whole, device="cpu"))
    with pytest.raises(ConfigError, match="no checkpoint"):
        train(SMALL, TrainingRun(tmp_path / "x", resume=tmp_path, device="cpu"))


def test_a_damaged_checkpoint_is_refused(whole: Path, tmp_path: Path) -> None:
    """One changed byte is noticed; a state from another format names the setting it does not know."""
    copy = Path(shutil.copytree(whole / "step_0000006", tmp_path / "step_0000006"))
    data = bytearray((copy / "weights.pt").read_bytes())
    data[len(data) // 2] ^= 1
    (copy / "weights.pt").write_bytes(data)
    with pytest.raises(ConfigError, match=r"weights\.pt' differs"):
        checkpoints.load(tmp_path)
    state = json.loads((copy / "state.json").read_text())
    state["recipe"]["colour"] = 1
    (copy / "state.json").write_text(json.dumps(state))
    with pytest.raises(ConfigError, match="'colour' is not known"):
        checkpoints.load(tmp_path)


def test_a_full_disk_keeps_the_last_checkpoint(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When writing fails, the error names the complete checkpoint, and it still loads."""
    saved = checkpoints.load(whole)
    checkpoints.save(tmp_path, saved)

    def full(path: Path, data: bytes) -> None:
        path.write_bytes(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints, "write_whole", full)
    later = checkpoints.Checkpoint(saved.recipe, 7, saved.weights, saved.first_moment, saved.second_moment)
    with pytest.raises(GelgateError, match=r"step 7 cannot be written: No space.*step_0000006' is complete"):
        checkpoints.save(tmp_path, later)
    assert checkpoints.load(tmp_path).step == 6
    assert [p.name for p in tmp_path.iterdir()] == ["step_0000006"]


@pytest.mark.parametrize(
    ("settings", "fault"),
    [
        ({"side": 100}, "'side' is 100"),
        ({"pairs": 0}, "'pairs' is 0"),
        ({"seed": -1}, "'seed' is -1"),
        ({"max_rate": float("nan")}, "'max_rate' is nan"),
        ({"stpes": 3}, "'stpes' is not known; did you mean 'steps'?"),
        ({"unchanged_mm": 0.03}, "unchanged_mm 0.03 is not below changed_mm 0.02"),
        ({"geometry_weight": 0.0, "pair_weight": 0.0, "rank_weight": 0.0}, "loss weights are all 0"),
    ],
)
def test_recipes_refuse_nonsense(settings: dict[str, object], fault: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(fault)):
        TrainConfig.shipped(**settings)


def test_a_recipe_of_an_earlier_version_is_known_where_it_means_the_same() -> None:
    """Settings that are gone now are read with the value that every run has, and refused with another."""
    shipped = TrainConfig.shipped()
    old = json.loads(shipped.to_json()) | {"distance": "euclidean", "stages": 3}
    assert TrainConfig.from_json(json.dumps(old)) == TrainConfig.from_json(shipped.to_json()) == shipped
    with pytest.raises(ConfigError, match="'distance' is not known"):
        TrainConfig.from_json(json.dumps(old | {"distance": "cosine"}))
