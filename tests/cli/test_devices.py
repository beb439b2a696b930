"""`gelgate devices` and `gelgate record` as a user runs them."""

import json
from pathlib import Path

import pytest
from command_line import gelgate, ran
from small_recordings import SERIAL, jpeg, write_recording
from station import press_recording

from edge.recording.format import Recording


def test_devices_names_sensor_and_refusal(tmp_path: Path) -> None:
    """The sensor with serial and mode; the webcam with the reason. One object per plugin for programs."""
    folder = write_recording(tmp_path / "r", 1)
    text = ran("devices", "--device", "usb_mock", "--option", f"recording={folder}")
    assert f"serial {SERIAL}, 64x48 at nominal 25 fps" in text
    assert "refused" in text
    assert "shared by webcams" in text
    (report,) = json.loads(
        ran("devices", "--json", "--device", "recorded", "--option", f"recording={folder}")
    )
    assert report["plugin"] == "recorded"
    assert report["seen"][0]["identity"]["serial"] == SERIAL


def test_devices_lists_every_plugin() -> None:
    """Each says what it sees or needs, and none stops the others; a camera that serves as both is a sensor."""
    text = ran("devices")
    for line in (
        "gelsight_mini:",
        "usb_mock: needs --option recording=...",
        "hid_pedal (trigger): nothing found",
        "virtual_hid (trigger):\n  found    FootSwitch, virtual/pedal",
        "virtual_hid (actuator):\n  found    USBRelay8, serial VIRT1, virtual/relay",
        "  found    virtual overview camera, serial VIRTUAL1, 640x480",
    ):
        assert line in text
    kinds = [(one["kind"], one["plugin"]) for one in json.loads(ran("devices", "--json"))]
    assert ("actuator", "dcttech_relay") in kinds
    assert [name for kind, name in kinds if kind == "overview"] == ["oak", "usb_camera", "virtual_overview"]


def test_record_from_a_device(tmp_path: Path) -> None:
    """Recorded through the virtual sensor: the same bytes, header and number; corrupt frames are left out."""
    folder = write_recording(tmp_path / "r", 6)
    source = ["--device", "usb_mock", "--option", f"recording={folder}", "--option", "pace=0"]
    said = ran("record", tmp_path / "copy", *source, "--option", 'faults=["truncate@2"]', "--frames", 4)
    copy = Recording.open(tmp_path / "copy")
    assert [frame.frame.payload for frame in copy] == [jpeg(seed) for seed in (0, 1, 3, 4)]
    assert copy.header.serial == SERIAL
    assert "4 frames, 1 corrupt" in said
    assert "presses in it are not counted: no sensor profile has frames of 64x48\n" in said


def test_record_says_how_many_presses_it_holds(tmp_path: Path) -> None:
    """Without a named profile, by that for frames of this size."""
    film = press_recording(tmp_path / "film", 3)
    source = ["--device", "recorded", "--option", f"recording={film}", "--option", "pace=0"]
    said = ran("record", tmp_path / "copy", *source)

    assert "seen in it: 3 presses, 3 of them at rest\n" in said


def test_what_was_recorded_before_a_loss_is_kept(tmp_path: Path) -> None:
    """Unplugged after three frames: an error, and three frames that play."""
    folder = write_recording(tmp_path / "r", 6)
    source = ["--device", "usb_mock", "--option", f"recording={folder}", "--option", "pace=0"]
    assert gelgate("record", tmp_path / "copy", *source, "--option", 'faults=["unplug@3"]').code == 4
    assert len(Recording.open(tmp_path / "copy")) == 3


def test_record_from_images(tmp_path: Path) -> None:
    """The reference may be among the press images; it is not taken as a press."""
    images = tmp_path / "images"
    images.mkdir()
    for seed, name in enumerate(("free", "a", "b")):
        (images / f"{name}.jpg").write_bytes(jpeg(seed))
    reference = ["--reference", images / "free.jpg", "--lead", 1, "--repeat-free", 2, "--repeat-press", 1]
    said = ran("record", tmp_path / "r", "--from-images", images, *reference)
    assert "9 frames, 2 presses" in said
    states = [frame.label["state"] for frame in Recording.open(tmp_path / "r") if frame.label]
    assert "".join(state[0] for state in states) == "fffpffpff"


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("devices --reset", 3, "--device"),
        ("devices --device recorded --reset", 3, "nothing to reset"),
        ("record out --device gelsight_mini --option serial=ZZZZZZZZ", 4, "ZZZZZZZZ"),
    ],
)
def test_bad_input_is_one_sentence(words: str, code: int, says: str) -> None:
    refused = gelgate(*words.split())

    assert (refused.code, says in refused.sentence()) == (code, True)
