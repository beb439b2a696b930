"""A recording played on demand misses nothing, and a run that missed a press fails."""

import shutil
from pathlib import Path

import pytest
from command_line import gelgate
from station import Configure, Motion, press_recording, station_config

from edge import registry
from edge.clock import SystemClock
from edge.config import PluginTable
from edge.core.contact.mask import Touch
from edge.core.errors import ConfigError, PressesMissed
from edge.core.imaging.frames import CameraFrame
from edge.gateway.opening import played_recording
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.recording.format import Recording
from plugins.devices.recorded import RecordedOptions


@pytest.mark.parametrize(
    ("device", "faults"), [("recorded", []), ("usb_mock", []), ("usb_mock", ["unplug@34:0.05"])]
)
def test_played_on_demand_every_press_is_seen(configure: Configure, device: str, faults: list[str]) -> None:
    """Contact uses the recording's time: with pace 0 each press is found, whatever the machine's speed. Unplugged
    while a part is held, the time that passes on demand has the gap, so the press is not counted twice; the sensor
    that was opened for the check is opened again, and goes on with the recording."""
    config = configure(faults=faults)
    text = config.read_text().replace('"usb_mock"', f'"{device}"')
    config.write_text(text.replace(", faults = []", "") if device == "recorded" else text)
    done = gelgate("run", "--config", config)

    assert done.code == 0, done.err
    presses, frames = done.out.splitlines()[-2:]
    assert presses == "3 presses: 1 fail, 2 pass"
    assert faults or frames == "82 frames: 0 dropped, 0 late, 0 repeated, 0 corrupt"


def test_a_frame_on_demand_has_no_age(bundle: Path, recording: Path) -> None:
    """A machine that is slower than the recording inspects frames of long ago; they are not stale."""
    inspector = Inspector(Scorer(Bundle.load(bundle), 1), SystemClock())
    payload = Recording.open(recording)[0].frame.payload
    touch = Touch(0.1)

    def reason(is_on_demand: bool) -> str:
        verdict = inspector.inspect(CameraFrame(payload, 0, 0, is_on_demand), touch).verdict
        return verdict.rejection.reason.value if verdict and verdict.rejection else ""

    assert reason(False) == "stale"
    assert reason(True) != "stale"


class NamesItsRecording:
    """A plugin whose author took the recording for its folder."""

    Options = RecordedOptions

    def recording(self, options: RecordedOptions) -> Path:
        return options.recording


def test_a_recording_that_cannot_be_compared_is_refused_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the plugin's name, and not after the last press."""
    monkeypatch.setattr(registry, "device", lambda name: NamesItsRecording())
    with pytest.raises(ConfigError, match="device plugin 'films' gives a PosixPath as its recording"):
        played_recording(PluginTable(plugin="films", options={"recording": "presses"}))


def test_a_run_that_missed_a_press_fails(tmp_path: Path, bundle: Path) -> None:
    """Presses of two frames are too short for contact: one sentence with both numbers, and the exit code of its own."""
    crowded = press_recording(tmp_path / "presses", 2, motion=Motion(hold=0), seed=4)
    done = gelgate("run", "--config", station_config(tmp_path, crowded, bundle))

    assert done.code == 6
    assert "it holds 2 presses and the run saw 0" in done.sentence()


@pytest.mark.parametrize(
    ("seen", "dropped", "words"),
    [
        (3, 0, None),
        (3, 5, None),
        (2, 0, "it holds 3 presses and the run saw 2; no frame was dropped"),
        (4, 0, "it holds 3 presses and the run saw 4"),
        (2, 5, "5 of its 90 frames were dropped"),
    ],
)
def test_what_a_labelled_run_must_see(recording: Path, seen: int, dropped: int, words: str | None) -> None:
    played = Recording.open(recording)
    if words is None:
        played.check_presses(seen, 90, dropped)
        return
    with pytest.raises(PressesMissed, match=words):
        played.check_presses(seen, 90, dropped)


def test_a_run_that_was_stopped_before_the_end_is_not_compared(config: Path) -> None:
    done = gelgate("run", "--presses", "1", "--config", config)
    assert done.code == 0, done.err


def test_without_labels_a_dropped_frame_is_a_doubt(tmp_path: Path) -> None:
    """What the recording holds is not known: a run that dropped frames fails, and so does one that saw no press."""
    played = Recording.open(press_recording(tmp_path / "presses", 0))
    with pytest.raises(PressesMissed, match=r"the run saw 0; no frame was dropped; a press counts after two"):
        played.check_presses(0, 28, 0)
    played.check_presses(1, 28, 0)
    with pytest.raises(PressesMissed, match=r"not known and the run saw 1; 2 of its 28 frames were dropped"):
        played.check_presses(1, 28, 2)


def test_a_recording_that_was_cut_is_named(tmp_path: Path, recording: Path) -> None:
    """Presses that the index no longer lists are not searched for in the contact rules."""
    cut = shutil.copytree(recording, tmp_path / "cut")  # the other tests play the whole one
    index = cut / "index.jsonl"
    index.write_text(index.read_text(encoding="utf-8")[:-9], encoding="utf-8")

    with pytest.raises(PressesMissed, match="its index ends in the middle of a line"):
        Recording.open(cut).check_presses(0, 90, 0)
