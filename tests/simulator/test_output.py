"""Recordings and datasets: right counts, true labels, equal bytes, and resuming."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from digests import digests
from typer.testing import CliRunner

from calibration.dataset import open_dataset
from calibration.simulator.command import simulate
from calibration.simulator.dataset_writer import press_pictures, simulate_dataset
from calibration.simulator.plan import dataset_plan
from calibration.simulator.record import simulate_recording
from calibration.simulator.scene import Scene, load_scene
from edge.core.errors import ConfigError, DatasetError, RecordingError
from edge.core.imaging.decode import decode
from edge.core.imaging.known_profiles import PROFILES
from edge.recording.format import Recording

TINY = """version = 1
name = "tiny"
part = "PZ5"
effects = ["pose_jitter", "deformation", "dust", "illumination", "led_drift", "noise", "jpeg"]
"""
RUNS = """
[camera]
modes = ["lr"]
[motion]
idle_s = 0.3
approach_s = 0.2
hold_s = 0.2
[defects]
kinds = ["dent"]
severity = [0.8, 1.0]
[[runs]]
name = "line"
presses = 3
faulty = 1
"""
SET = """
[camera]
modes = ["lr", "hr"]
[nominal]
specimens = 2
presses = 1
[defects]
images = 1
severity = [1.0, 1.0]
kinds = ["dent"]
"""


def scene_of(folder: Path, text: str) -> Scene:
    path = folder / "tiny.toml"
    path.write_text(TINY + text)
    return load_scene(path)


def test_a_recording_is_labelled_with_the_truth(tmp_path: Path) -> None:
    """Three presses with all phases in order, free gel before and after, one damaged and never the first."""
    scene = scene_of(tmp_path, RUNS)
    recording = Recording.open(simulate_recording(scene, tmp_path / "out", 1))
    labels = [frame.label for frame in recording]
    assert all(label is not None for label in labels)
    presses = [label["press"] for label in labels if label]
    assert presses[0] is None
    assert presses[-1] is None
    assert {p for p in presses if p is not None} == {0, 1, 2}
    damaged = {label["press"]: label["defect"] for label in labels if label and label["defect"]}
    assert len(damaged) == 1
    assert 0 not in damaged
    assert all(defect["kind"] == "dent" and defect["severity"] > 0 for defect in damaged.values())
    holds = [frame for frame in recording if frame.label and frame.label["phase"] == "hold"]
    assert len({frame.frame.payload for frame in holds}) == len(holds)


def test_a_native_recording_decodes_to_the_low_resolution_picture(tmp_path: Path) -> None:
    """A 3280x2464 frame, read through the profile mini_lr, is the frame that the mode lr renders."""
    text = RUNS.replace("faulty = 1", "faulty = 0").replace("presses = 3", "presses = 1")
    still = TINY.replace(', "noise"', "").replace('"dust", ', "")
    (tmp_path / "lr.toml").write_text(still + text)
    (tmp_path / "native.toml").write_text(still + text.replace('"lr"', '"native"'))
    views = []
    for name, profile in (("lr", "cropped_lr"), ("native", "mini_lr")):
        recording = Recording.open(
            simulate_recording(load_scene(tmp_path / f"{name}.toml"), tmp_path / name, 1)
        )
        held = next(f for f in recording if f.label and f.label["phase"] == "hold")
        views.append(decode(held.frame, PROFILES[profile]).astype(np.float32))
    assert Recording.open(tmp_path / "native").header.mode == (3280, 2464)
    assert np.abs(views[0] - views[1]).mean() < 2.0


def test_recordings_repeat_and_are_never_overwritten(tmp_path: Path) -> None:
    """Same seed, same bytes; a complete one is kept, another one is refused."""
    scene = scene_of(tmp_path, RUNS)
    first = digests(simulate_recording(scene, tmp_path / "a", 1))
    assert first == digests(simulate_recording(scene, tmp_path / "b", 1, workers=2))
    assert first == digests(simulate_recording(scene, tmp_path / "a", 1))
    with pytest.raises(RecordingError, match="choose another folder"):
        simulate_recording(scene, tmp_path / "a", 2)


def test_presses_and_runs_can_be_chosen(tmp_path: Path) -> None:
    """Fewer presses keep the share of damage."""
    scene = scene_of(tmp_path, RUNS)
    recording = Recording.open(simulate_recording(scene, tmp_path / "one", 1, run="line", presses=1))
    assert {f.label["press"] for f in recording if f.label} == {None, 0}


def test_a_dataset_is_read_back_with_its_counts(tmp_path: Path) -> None:
    """Two sound and one damaged press, at both sizes, with masks that mark something, and its own summary."""
    scene = scene_of(tmp_path, SET)
    root = simulate_dataset(scene, tmp_path / "set", 4)
    for resolution in ("lr", "hr"):
        dataset = open_dataset(root, resolution)  # type: ignore[arg-type]
        assert (len(dataset.good), len(dataset.defective)) == (2, 1)
    summary = json.loads((root / "dataset.json").read_text())
    assert summary["complete"] is True
    assert summary["scenes"][0]["counts"] == {"pos1": {"nominal": 2, "faulty": 1}}
    assert [fault["kind"] for fault in summary["faults"].values()] == ["dent"]


def test_low_resolution_masks_are_pooled_blocks_of_the_high_resolution_ones(tmp_path: Path) -> None:
    """A pixel of the small mask is set exactly where any of its 4 x 3 pixels is; the small picture is their mean."""
    scene = scene_of(tmp_path, SET)
    plan = next(plan for plan in dataset_plan(scene, 4) if plan.kind)
    made = dict(press_pictures(scene, plan, 4))
    assert {kind: picture.shape[:2] for kind, picture in made.items()} == {
        "rgb": (720, 1280),
        "mask": (720, 1280),
        "rgb_320x240": (240, 320),
        "mask_320x240": (240, 320),
    }
    blocks = made["mask"].reshape(240, 3, 320, 4).max(axis=(1, 3))
    assert np.array_equal(made["mask_320x240"], blocks)
    assert set(np.unique(made["mask"])) == {0, 255}
    assert made["mask"].any()
    mean = made["rgb"].reshape(240, 3, 320, 4, 3).mean(axis=(1, 3))
    assert np.abs(mean - made["rgb_320x240"]).max() <= 0.51


def test_a_foreign_folder_is_not_changed(tmp_path: Path) -> None:
    """A folder with something else in it is neither written to nor read."""
    (tmp_path / "photos.txt").write_text("mine")
    with pytest.raises(DatasetError, match="choose another folder"):
        simulate_dataset(load_scene("small"), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["photos.txt"]
    for make, error in ((simulate_dataset, DatasetError), (simulate_recording, RecordingError)):
        with pytest.raises(error, match="is a file, a folder is expected"):
            make(load_scene("small" if make is simulate_dataset else "demo"), tmp_path / "photos.txt")  # type: ignore[operator]


def test_an_incomplete_dataset_and_another_version_are_not_read(tmp_path: Path) -> None:
    """An incomplete dataset is refused: its measures would be taken for those of the complete one."""
    root = simulate_dataset(scene_of(tmp_path, SET), tmp_path / "set", 4)
    summary = json.loads((root / "dataset.json").read_text())
    for changes, sentence in (
        ({"complete": False}, "is incomplete, because 'gelgate lab simulate' was interrupted"),
        ({"version": 2}, "has version 2, this program reads version 1"),
    ):
        (root / "dataset.json").write_text(json.dumps({**summary, **changes}))
        with pytest.raises(DatasetError, match=sentence):
            open_dataset(root)
    (root / "dataset.json").write_text("[]")
    with pytest.raises(DatasetError, match="not a summary"):
        open_dataset(root)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda to: simulate_recording(load_scene("demo"), to, run="night"), "has no run 'night'; it has"),
        (lambda to: simulate_dataset(load_scene("demo"), to), r"no \[nominal\]"),
        (lambda to: simulate_dataset(load_scene("small"), to, presses=101), "'presses' is 101"),
        (lambda to: simulate_recording(load_scene("demo"), to, presses=100_001), "'presses' is 100001"),
        (lambda to: simulate("small", to, run="night"), "leave --run out"),  # a dataset has no run
    ],
)
def test_what_a_scene_lacks_is_refused(make: Callable[[Path], object], words: str, tmp_path: Path) -> None:
    """Also numbers beyond the limits of its file; nothing is made."""
    with pytest.raises(ConfigError, match=words):
        make(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_makes_a_preview(tmp_path: Path) -> None:
    """`--preview` writes one sheet for the scene and nothing else."""
    app = typer.Typer()
    app.command()(simulate)
    (tmp_path / "tiny.toml").write_text(TINY + SET)
    done = CliRunner().invoke(app, [str(tmp_path / "tiny.toml"), "-o", str(tmp_path / "out"), "--preview"])
    assert done.exit_code == 0, done.output
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["tiny_preview.png"]
    sheet = cv2.imread(str(tmp_path / "out" / "tiny_preview.png"))
    assert sheet is not None
    assert "effects that tiny does not use: partial_contact, residual_imprint, wear," in done.output


def test_a_recording_without_a_press_that_is_seen_is_said(tmp_path: Path) -> None:
    """Relief shows by its light; and a gateway leaves out frames that are equal."""
    app = typer.Typer()
    app.command()(simulate)
    scene = (
        (TINY + RUNS)
        .replace('"illumination", "led_drift", "noise", ', "")
        .replace("presses = 3", "presses = 2")
    )
    (tmp_path / "dark.toml").write_text(scene)
    done = CliRunner().invoke(app, [str(tmp_path / "dark.toml"), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    warned = [
        line for line in done.output.splitlines() if line.startswith("warning: a gateway finds no press")
    ]
    assert [line.split("'")[1] for line in warned] == ["illumination", "noise"]
