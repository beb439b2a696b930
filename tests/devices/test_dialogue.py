"""Owners' reports are played to today's driver, and a dialogue is recorded as an owner records it."""

import json
from pathlib import Path

import pytest
from command_line import gelgate
from small_recordings import write_recording

from edge.clock import ManualClock
from edge.core.errors import RecordingError
from plugins.devices.uvc.dialogue import DialoguePlayer, listen
from plugins.devices.uvc.identity import choose, discover

REPORTS = sorted((Path(__file__).parents[2] / "firmware_notes/reports").glob("*.jsonl"))


def heard_in(path: Path) -> tuple[object, object]:
    """What the driver makes of a dialogue today, and made of it when it was recorded."""
    clock = ManualClock()
    player = DialoguePlayer(path, clock)
    then = player.header["heard"]
    sensor = choose(discover(player), then.get("serial"))
    return listen(player, sensor, clock, lock_name=f"dialogue-{path.stem}"), then


def test_an_example_is_there() -> None:
    """So that a report is never played to nobody."""
    assert "virtual_sensor.jsonl" in [path.name for path in REPORTS]


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.stem)
def test_a_report_is_heard_as_at_its_owner(path: Path) -> None:
    """Identity, controls that were not set, and each frame; or the same fault."""
    today, then = heard_in(path)

    assert today == then


@pytest.mark.parametrize(
    ("faults", "ending"),
    [
        ([], ""),
        (["lost_packet@2"], "a packet was lost on the bus"),
        (["truncate@2"], "without its end marker"),
        (["unplug@3"], "No such device"),
    ],
    ids=lambda value: str(value[0]).partition("@")[0] if value else "sound",
)
def test_a_dialogue_is_recorded_and_played(tmp_path: Path, faults: list[str], ending: str) -> None:
    """By the verb, with a fault too; no picture is in the file."""
    recording = write_recording(tmp_path / "recording", 8)
    options = [
        "--option",
        f"recording={recording}",
        "--option",
        "pace=0",
        "--option",
        f"faults={json.dumps(faults)}",
    ]
    path = tmp_path / "dialogue.jsonl"
    done = gelgate("devices", "--device", "usb_mock", *options, "--dialogue", path)
    today, then = heard_in(path)

    assert done.code == 0, done.err
    assert ending in done.out
    assert today == then
    frames = sorted(recording.glob("**/*.jpg"))
    assert frames
    assert frames[0].read_bytes().hex()[-400:] not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is no dialogue of version 1"),
        ("{}", "is no dialogue of version 1"),
        ('{"dialogue": 2}', "it has version 2"),
        ('{"dialogue": 1}\n7', "record one with"),
    ],
)
def test_a_file_that_is_no_dialogue_is_refused(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "one.jsonl"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(RecordingError, match=sentence):
        DialoguePlayer(path, ManualClock())


def test_a_question_that_was_not_asked_has_no_answer(tmp_path: Path) -> None:
    """A sentence with the call, not an answer that was made up."""
    path = tmp_path / "one.jsonl"
    path.write_text('{"dialogue": 1}\n["open_device", 0, null]\n', encoding="utf-8")
    player = DialoguePlayer(path, ManualClock())

    assert player.open_device(0) == 0
    with pytest.raises(RecordingError, match=r"no answer to \['claim_interface', 0, 1\]"):
        player.claim_interface(0, 1)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--dialogue", "x.jsonl"], "belong to one plugin"),
        (["--device", "recorded", "--dialogue", "x.jsonl"], "keeps no dialogue"),
    ],
)
def test_a_dialogue_needs_a_sensor_on_usb(words: list[str], sentence: str) -> None:
    done = gelgate("devices", *words)

    assert done.code != 0
    assert sentence in done.err
