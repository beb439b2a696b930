"""An interrupted recording continues after its last complete press and ends with the bytes of an uninterrupted one."""

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from digests import digests

from calibration.simulator.record import simulate_recording
from calibration.simulator.scene import Scene, load_scene
from edge.core.errors import RecordingError
from edge.recording.format import Recording

COMMAND = Path(sys.executable).with_name("gelgate")
PATIENCE_S = 300.0  # only what hangs takes so long
# Every effect that depends on time or on earlier presses, on a gel that changes within the run.
SCENE = """version = 1
name = "tiny"
part = "PZ3"
effects = [
    "pose_jitter", "residual_imprint", "dust", "wear", "illumination", "motion_blur", "led_drift", "noise", "jpeg",
]
[camera]
modes = ["lr"]
[motion]
idle_s = 0.4
tail_s = 0.4
approach_s = 0.2
[defects]
kinds = ["dent"]
severity = [0.8, 1.0]
[[runs]]
name = "line"
presses = 8
faulty = 3
gel_presses = 600
"""
IDLE, PRESS, SEED = 8, 18, 3  # Frames of the free gel before the first press, and of one press.


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "tiny.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def scene(path: Path) -> Scene:
    return load_scene(path)


@pytest.fixture(scope="module")
def unbroken(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return digests(simulate_recording(scene, tmp_path_factory.mktemp("unbroken") / "r", SEED))


def lines(part: Path) -> int:
    index = part / "index.jsonl"
    return index.read_bytes().count(b"\n") if index.is_file() else 0


def changed(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in sorted((folder / "frames").iterdir())}


@pytest.mark.parametrize(("how", "workers", "then"), [(signal.SIGKILL, 2, 1), (signal.SIGINT, 1, 2)])
def test_a_killed_recording_continues(
    how: signal.Signals, workers: int, then: int, path: Path, unbroken: dict[str, str], tmp_path: Path
) -> None:
    """Killed and started again with another number of workers: equal bytes, and complete presses are not made again."""
    part = tmp_path / "r.part"
    command: list[str | Path] = [COMMAND, "lab", "simulate", path, "-o", tmp_path / "r"]
    command += ["--run", "line", "--seed", str(SEED)]
    presses = ended_within(how, [*command, "--workers", str(workers)], tmp_path / "r", part)
    before = changed(part)
    subprocess.run([*command, "--workers", str(then)], check=True, capture_output=True, timeout=PATIENCE_S)
    assert digests(tmp_path / "r") == unbroken
    numbers = [label["press"] for label in Recording.open(tmp_path / "r").labels() if label]
    assert (numbers.index(0), numbers.count(0)) == (IDLE, PRESS)
    after = changed(tmp_path / "r")
    whole = [f"{k:06d}.jpg" for k in range(IDLE + presses * PRESS)]
    assert [after[name] for name in whole] == [before[name] for name in whole]
    assert not part.exists()


def ended_within(how: signal.Signals, command: list[str | Path], whole: Path, part: Path) -> int:
    """Start the command, end it after some presses, and count them. A busy machine may look too late: then again."""
    for _ in range(10):
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + PATIENCE_S
        while process.poll() is None and time.monotonic() < deadline and lines(part) < IDLE + 3 * PRESS:
            time.sleep(0.005)
        process.send_signal(how)
        process.wait(timeout=PATIENCE_S)
        presses = (lines(part) - IDLE) // PRESS
        if presses < 8 and not whole.exists():
            assert presses >= 3
            return presses
        shutil.rmtree(whole, ignore_errors=True)
        shutil.rmtree(part, ignore_errors=True)
    raise AssertionError("it was complete each time, before it could be ended")


def test_a_full_disk_is_reported_and_the_recording_continues(
    path: Path, scene: Scene, unbroken: dict[str, str], tmp_path: Path
) -> None:
    """No room for the index in the middle of a line: a clear error; with room again, the bytes of an uninterrupted
    run."""
    command = (
        f'ulimit -f 12; exec "{COMMAND}" lab simulate "{path}" -o "{tmp_path}/r" --run line --seed {SEED}'
    )
    done = subprocess.run(
        ["bash", "-c", f"{command} --workers 1"], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode != 0
    assert "free some space" in " ".join(done.stderr.split())
    assert IDLE + PRESS < lines(tmp_path / "r.part") < len(unbroken) - 3
    assert digests(simulate_recording(scene, tmp_path / "r", SEED)) == unbroken


def _in_a_line(part: Path) -> None:
    index = part / "index.jsonl"
    index.write_bytes(index.read_bytes()[:-7])


def _in_a_frame(part: Path) -> None:
    """The file of the next frame is partial, its line is missing."""
    _in_a_line(part)
    last = sorted((part / "frames").iterdir())[-1]
    last.write_bytes(last.read_bytes()[:100])


def _in_a_kept_frame(part: Path) -> None:
    """As after a power cut: the line exists, the picture does not."""
    (part / f"frames/{IDLE + 2 * PRESS + 4:06d}.jpg").write_bytes(b"")


def _without_a_frame(part: Path) -> None:
    (part / f"frames/{IDLE + 2 * PRESS + 4:06d}.jpg").unlink()


def _in_the_header(part: Path) -> None:
    (part / "recording.toml").write_text("version = 1\nprod")
    (part / "index.jsonl").unlink()


def _in_the_stamp(part: Path) -> None:
    for path in part.glob("*.*"):
        path.unlink()
    for path in (part / "frames").iterdir():
        path.unlink()
    (part / "frames").rmdir()
    (part / "scene.json.part").write_text('{"vers')


CUTS = (_in_a_line, _in_a_frame, _in_a_kept_frame, _without_a_frame, _in_the_header, _in_the_stamp)


@pytest.fixture(scope="module")
def short(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_recording(scene, tmp_path_factory.mktemp("short") / "r", SEED, presses=3)


@pytest.mark.parametrize("cut", [*CUTS, lambda part: None], ids=lambda cut: cut.__name__)
def test_an_interrupted_recording_ends_as_an_uninterrupted_one(
    cut: Callable[[Path], None], scene: Scene, short: Path, tmp_path: Path
) -> None:
    """In a line, a frame, the header or the stamp, or before the last rename: the same bytes in the end."""
    cut(shutil.copytree(short, tmp_path / "r.part"))
    assert digests(simulate_recording(scene, tmp_path / "r", SEED, presses=3)) == digests(short)
    assert not (tmp_path / "r.part").exists()


def test_an_unfinished_recording_of_another_seed_is_refused(scene: Scene, tmp_path: Path) -> None:
    """So is one with other settings; the error names both seeds, and the files stay."""
    folder = simulate_recording(scene, tmp_path / "r", SEED, presses=1)
    part = folder.rename(tmp_path / "r.part")
    _in_a_line(part)
    before = digests(part)
    with pytest.raises(RecordingError, match=r"another unfinished recording: seed 3, not 4; move it away"):
        simulate_recording(scene, folder, 4, presses=1)
    with pytest.raises(RecordingError, match="other settings"):
        simulate_recording(scene, folder, SEED, presses=2)
    assert digests(part) == before


def test_something_else_in_the_unfinished_recordings_place_is_refused(scene: Scene, tmp_path: Path) -> None:
    """A recording of a real sensor that happens to have that name is not deleted."""
    (tmp_path / "r.part").mkdir()
    (tmp_path / "r.part" / "recording.toml").write_text("mine")
    with pytest.raises(RecordingError, match="move it away"):
        simulate_recording(scene, tmp_path / "r", SEED, presses=1)
    assert (tmp_path / "r.part" / "recording.toml").read_text() == "mine"
