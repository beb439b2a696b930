"""`gelgate bundle acquire`: presses one by one, from recordings, pictures and a sensor, until they are enough."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import gelgate

from edge.model.bundle import Bundle

# Twelve presses of six pieces promise 18 %; the region keeps the trunk small.
OPTIONS = ("--part", "bolt", "--position", "pos1", "--profile", "cropped_lr", "--promise", "0.2",
           "--region", "112,72,96x96")  # fmt: skip


def rows(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "signals.jsonl").read_text().splitlines()]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "presses").iterdir())


def payloads(folder: Path) -> set[bytes]:
    return {path.read_bytes() for path in (folder / "presses").iterdir()}


def test_a_recording_until_it_is_enough_then_fitted(recording: Path, tmp_path: Path) -> None:
    """Signals after every press, a forecast after every fourth, and the printed command fits what was promised."""
    out = tmp_path / "acquired"
    # The command fits on this backbone: a comparison of several would take seconds.
    words = (*OPTIONS, "--per-piece", 2, "--most", 12, "--go-on", "--backbone", "tactile_resnet18")
    done = gelgate("bundle", "acquire", recording, "-o", out, *words)
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert sum(line.startswith("press ") for line in lines) == 12
    assert sum(line.startswith("forecast: ") for line in lines) >= 2
    assert "put in piece 6" in lines
    assert any(
        line.startswith("12 presses of 6 pieces: at most 18 % false alarms by press, 32 %") for line in lines
    )
    found = rows(out)
    assert [row["presses"] for row in found] == list(range(1, 13))
    assert found[2]["unseen"] is None
    assert 0 < float(str(found[-1]["unseen"])) < float(str(found[7]["unseen"]))
    assert names(out)[:3] == ["bolt-pos1_s001_p01.png", "bolt-pos1_s001_p02.png", "bolt-pos1_s002_p01.png"]
    assert (out / "coverage.png").read_bytes().startswith(b"\x89PNG")
    printed = shlex.split(lines[-1])
    printed[printed.index("-o") + 1] = str(tmp_path / "bundle")
    assert gelgate(*printed[1:]).code == 0
    limit = Bundle.load(tmp_path / "bundle").manifest.threshold
    assert limit.by_press is not None
    assert limit.by_piece is not None
    assert limit.by_press.rate == pytest.approx(float(str(found[-1]["by_press"])))
    assert limit.by_piece.rate == pytest.approx(float(str(found[-1]["by_piece"])))


def test_pictures_know_their_pieces_and_are_fitted_at_once(pictures: Path, tmp_path: Path) -> None:
    """The names of the files carry the pieces; --fit leaves a bundle."""
    done = gelgate(
        "bundle", "acquire", pictures / "presses", "--no-contact", pictures / "free.png", "-o", tmp_path / "acquired",
        *OPTIONS, "--fit", tmp_path / "bundle", "--backbone", "tactile_resnet18",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert rows(tmp_path / "acquired")[-1]["pieces"] == 6
    manifest = Bundle.load(tmp_path / "bundle").manifest
    assert manifest.threshold.pieces == 6
    assert manifest.contact is not None


def test_a_piece_of_an_earlier_run_is_no_new_one(pictures: Path, tmp_path: Path) -> None:
    """Its name says so; the second half of a line is of a run that was killed."""
    out = tmp_path / "acquired"
    words = ("bundle", "acquire", pictures / "presses", "-o", out, *OPTIONS, "--go-on", "--pattern")
    assert gelgate(*words, "*_s00[0-3]_p01.png").code == 0
    with (out / "signals.jsonl").open("a") as file:
        file.write('{"file": "bolt-')
    done = gelgate(*words, "*_s00[1-4]_p02.png")
    assert done.code == 0, done.err
    assert {name[:14] for name in names(out)} == {f"bolt-pos1_s00{k}" for k in range(1, 6)}
    assert "8 presses of 5 pieces: at most" in done.out


def test_a_sensor_is_read_and_an_acquisition_continues(recording: Path, tmp_path: Path) -> None:
    """The virtual sensor of a station plays the recording twice: presses that are there are not taken again."""
    station = tmp_path / "station.toml"
    station.write_text(
        'version = 1\n[device]\nplugin = "usb_mock"\n'
        f'options = {{ recording = "{recording}", pace = 0 }}\n'
        '[inspection]\nbundle = "not-there-yet"\n[gel]\nlimit_presses = 500\n[[sinks]]\nplugin = "memory"\n'
    )
    out = tmp_path / "acquired"
    first = gelgate("bundle", "acquire", "-c", station, "-o", out, *OPTIONS, "--most", 5)
    assert first.code == 0, first.err
    assert "of a gel rated for 500 presses" in first.out
    again = gelgate("bundle", "acquire", "-c", station, "-o", out, *OPTIONS, "--most", 7)
    assert f"{out} has 5 presses already; they count" in again.out
    assert [row["presses"] for row in rows(out)] == [1, 2, 3, 4, 5, 6, 7]
    assert len(payloads(out)) == 7


def _started(recording: Path, out: Path) -> subprocess.Popen[str]:
    """The command in a process of its own; the device plays in real time, so it does not end at once."""
    return subprocess.Popen(
        [sys.executable, "-c", "from edge.cli import main; main()", "bundle", "acquire", "--device", "recorded",
         "--option", f"recording={recording}", "--option", "pace=1", "--option", "loop=true",
         "-o", str(out), *OPTIONS, "--most", "100", "--go-on"],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip


def _until_pressed(process: subprocess.Popen[str], count: int) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(f"press {count:3}"):
            return
    raise AssertionError("it ended before")


def test_a_kill_loses_no_press_and_ctrl_c_ends_with_the_summary(recording: Path, tmp_path: Path) -> None:
    """Killed after the third press: all three are there, and the same folder is continued, by one process. Interrupted
    then, it says what the presses promise and how to fit them; exit code 0."""
    out = tmp_path / "acquired"
    with _started(recording, out) as process:
        _until_pressed(process, 3)
        process.kill()
    assert len(payloads(out)) >= 3
    (out / "presses" / "press_0099.part").write_bytes(b"half a pictu")
    with _started(recording, out) as process:
        _until_pressed(process, 5)
        beside = gelgate("bundle", "acquire", recording, "-o", out, *OPTIONS)
        process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        rest = process.stdout.read()
    assert process.returncode == 0
    assert "not enough: the promise is not reached" in rest
    assert "gelgate fit" in rest
    assert len(names(out)) == len(payloads(out)) >= 5
    assert f"another process takes presses into {out}" in beside.sentence()


def test_presses_that_cannot_be_scored_are_said_and_left_out(pictures: Path, tmp_path: Path) -> None:
    """A black picture and a truncated one: a sentence each, the other presses count."""
    folder = tmp_path / "presses"
    folder.mkdir()
    good = sorted((pictures / "presses").iterdir())[:4]
    for path in good:
        (folder / path.name).write_bytes(path.read_bytes())
    cv2.imwrite(str(folder / "a_black.png"), np.zeros((240, 320, 3), np.uint8))
    (folder / "b_cut.png").write_bytes(good[0].read_bytes()[:2000])
    done = gelgate("bundle", "acquire", folder, "-o", tmp_path / "acquired", *OPTIONS)
    assert done.code == 0, done.err
    assert len(names(tmp_path / "acquired")) == 4
    said = [line for line in done.err.splitlines() if line.startswith("warning: left out: ")]
    assert len(said) == 2
    assert "is black" in said[0]
    assert "b_cut.png" in said[1]


def test_one_piece_alone_is_said(pictures: Path, tmp_path: Path) -> None:
    """Twelve presses of it are no coverage of other pieces."""
    done = gelgate(
        "bundle", "acquire", pictures / "presses", "-o", tmp_path / "acquired", *OPTIONS, "--pattern", "*_s000_*",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "2 presses, 1 piece; what a new piece would show is not known" in done.out
    assert "--method padim --backbone tactile_lite0" in done.out


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((), 3, "name one of SOURCE, --config and --device"),
        (("--device", "recorded", "--option", "recording=nowhere"), 3, "recording nowhere does not exist"),
        (("--device", "gelsight_mini", "--option", "serial=NOSUCH00"), 4, "NOSUCH00"),
        (("--device", "no_such"), 3, "no_such"),
        (("nowhere",), 3, "there is nothing at nowhere"),
        (("black",), 3, "no press was taken: "),
        (("broken",), 3, "frame files"),
        (("--device", "recorded", "--position", "a\nb"), 3, "--position is a name of 1 to 128"),
        (("--device", "recorded", "--promise", "0"), 3, "--promise lies between 0 and 1"),
        (("--device", "recorded", "--per-piece", "2", "--enter"), 3, "give one of them"),
    ],
)
def test_what_cannot_be_acquired_is_one_sentence(
    arguments: tuple[str, ...],
    code: int,
    said: str,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a press nothing is promised: black ones, and a recording whose index lists frames that are not there."""
    monkeypatch.chdir(tmp_path)
    Path("black").mkdir()
    cv2.imwrite("black/black.png", np.zeros((240, 320, 3), np.uint8))
    shutil.copytree(recording, "broken", ignore=shutil.ignore_patterns("frames"))
    done = gelgate("bundle", "acquire", *OPTIONS[:6], *arguments, "-o", "acquired")
    assert said in done.sentence()
    assert done.code == code


def test_another_acquisition_is_not_continued(pictures: Path, tmp_path: Path) -> None:
    """Another part, or a folder of something else: refused with what is there."""
    out, source = tmp_path / "acquired", pictures / "presses"
    assert gelgate("bundle", "acquire", source, "-o", out, *OPTIONS, "--most", 1).code == 0
    other = gelgate("bundle", "acquire", source, "-o", out, "--part", "nut", *OPTIONS[2:])
    assert "holds another acquisition: part 'bolt', not 'nut'" in other.sentence()
    foreign = gelgate("bundle", "acquire", source, "-o", source, *OPTIONS)
    assert "is not empty and holds no acquisition" in foreign.sentence()
    file = gelgate("bundle", "acquire", source, "-o", pictures / "free.png", *OPTIONS)
    assert "is a file, a folder is expected" in file.sentence()
