"""Ctrl-C while a dataset is made: only complete files, and the same bytes in the end."""

import hashlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2

from calibration.simulator.scene import load_scene
from calibration.simulator.simulate import simulate_dataset

COMMAND = Path(sys.executable).with_name("gelgate")


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*.*"))
        if path.is_file()
    }


def test_an_interrupted_dataset_has_complete_files_and_continues(tmp_path: Path) -> None:
    """After SIGINT: exit code 130, every picture readable, no partial files; the same command then gives the bytes of
    an uninterrupted run."""
    cut = tmp_path / "cut"
    arguments = ["simulate", "small", "-o", str(cut), "--presses", "12", "--workers", "2"]
    process = subprocess.Popen([COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline and len(list(cut.rglob("*.png"))) < 6:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    pictures = list(cut.rglob("*.png"))
    assert all(cv2.imread(str(path)) is not None for path in pictures)
    assert [path.name for path in cut.rglob(".*")] == []
    scene = load_scene("small")
    resumed = digests(simulate_dataset(scene, cut, presses=12))
    assert len(pictures) < sum(name.endswith(".png") for name in resumed)
    assert resumed == digests(simulate_dataset(scene, tmp_path / "whole", presses=12))


def test_a_killed_command_leaves_no_workers_and_no_half_files(tmp_path: Path) -> None:
    """After SIGKILL its workers end too (they hold its standard error open), and a second run removes partial files."""
    cut = tmp_path / "cut"
    arguments = ["simulate", "small", "-o", str(cut), "--presses", "12", "--workers", "2"]
    process = subprocess.Popen([COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline and len(list(cut.rglob("*.png"))) < 6:
        time.sleep(0.02)
    process.kill()
    process.communicate(timeout=30)
    simulate_dataset(load_scene("small"), cut, presses=12)
    assert [path.name for path in cut.rglob(".*")] == []
