"""Ctrl-C while a dataset is made: only complete files, and the same bytes in the end."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
from digests import digests

from calibration.simulator.scene import load_scene
from calibration.simulator.simulate import simulate_dataset

COMMAND = Path(sys.executable).with_name("gelgate")
PATIENCE_S = 300.0  # only what hangs takes so long


def test_an_interrupted_dataset_has_complete_files_and_continues(tmp_path: Path) -> None:
    """After SIGINT: exit code 130, every picture readable, no partial files; the same command then gives the bytes of
    an uninterrupted run."""
    scene = load_scene("small")
    whole = digests(simulate_dataset(scene, tmp_path / "whole", presses=12))
    cut, pictures = interrupted(tmp_path, sum(name.endswith(".png") for name in whole))
    assert all(cv2.imread(str(path)) is not None for path in pictures)
    assert [path.name for path in cut.rglob(".*")] == []
    assert digests(simulate_dataset(scene, cut, presses=12)) == whole


def interrupted(folder: Path, complete: int) -> tuple[Path, list[Path]]:
    """A dataset that Ctrl-C ended before it was complete, and its pictures; a busy machine needs several attempts."""
    for attempt in range(10):
        cut = folder / f"cut{attempt}"
        process = begun(cut)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
        pictures = list(cut.rglob("*.png"))
        if len(pictures) < complete:
            assert process.returncode == 130, errors
            return cut, pictures
    raise AssertionError("it was complete each time, before it could be interrupted")


def begun(cut: Path) -> "subprocess.Popen[str]":
    """The command that makes a dataset of twelve presses there, with its first pictures."""
    arguments = ["lab", "simulate", "small", "-o", str(cut), "--presses", "12", "--workers", "2"]
    process = subprocess.Popen([COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE_S
    while process.poll() is None and time.monotonic() < deadline and len(list(cut.rglob("*.png"))) < 6:
        time.sleep(0.02)
    return process


def test_a_killed_command_leaves_no_workers_and_no_half_files(tmp_path: Path) -> None:
    """After SIGKILL its workers end too (they hold its standard error open), and a second run removes partial files."""
    cut = tmp_path / "cut"
    process = begun(cut)
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    simulate_dataset(load_scene("small"), cut, presses=12)
    assert [path.name for path in cut.rglob(".*")] == []
