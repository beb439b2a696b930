"""Owners' reports are played to today's driver, and a dialogue is recorded as an owner records it."""

import errno
import json
from collections import defaultdict, deque
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
from command_line import gelgate
from small_recordings import write_recording

from edge.clock import ManualClock
from plugins.devices.uvc.dialogue import VERSION, listen
from plugins.devices.uvc.identity import choose, discover
from plugins.devices.uvc.payload import Packet

REPORTS = sorted((Path(__file__).parents[2] / "firmware_notes/reports").glob("*.jsonl"))


class Player:
    """A pyusb backend that answers from a file. The driver may ask in another order; what it asks must be there."""

    def __init__(self, path: Path, clock: ManualClock) -> None:
        self._clock = clock
        self._answers = defaultdict[str, deque[Any]](deque)
        self.header, *lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
        assert self.header["dialogue"] == VERSION
        for *words, answer in lines:
            self._answers[json.dumps(words)].append(answer)

    def enumerate_devices(self) -> Iterator[int]:
        number = 0
        while json.dumps(["get_device_descriptor", number]) in self._answers:
            yield number
            number += 1

    def open_device(self, device: int) -> int:
        self._answer("open_device", device)
        return device

    def close_device(self, handle: int) -> None:
        """Nothing is held."""

    def get_parent(self, device: int) -> None:
        return None

    def ctrl_transfer(
        self, handle: int, kind: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        is_in = bool(kind & 0x80)
        given = len(data) if is_in else bytes(data).hex()
        answer = self._answer("ctrl_transfer", handle, kind, request, value, index, given)
        if not is_in:
            return int(answer)
        content = bytes.fromhex(answer)
        for position, byte in enumerate(content):
            data[position] = byte
        return len(content)

    def packet_stream(self, handle: int, endpoint: int, packet_bytes: int) -> "Player":
        self._answer("packet_stream", handle, endpoint, packet_bytes)
        return self

    def read(self, timeout_ms: int) -> list[Packet]:
        """After the end nothing more comes in time."""
        batches = self._answers[json.dumps(["packets"])]
        if not batches:
            self._clock.sleep(timeout_ms / 1000)
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return [lengthen(packet) for packet in answered(batches.popleft())]

    def close(self) -> None:
        """Nothing is held."""

    def __getattr__(self, name: str) -> Any:
        return lambda *given: self._answer(name, *given)

    def _answer(self, *words: Any) -> Any:
        answers = self._answers[json.dumps(words)]
        assert answers, f"{words} was not asked when this was recorded"
        answer = answered(answers.popleft() if len(answers) > 1 else answers[0])
        if not isinstance(answer, dict):
            return answer
        extra = bytes.fromhex(answer.pop("extra_descriptors", ""))
        return SimpleNamespace(**answer, extra_descriptors=extra)


def answered(answer: Any) -> Any:
    """Return the answer of a line. Errors: what the bus had raised there."""
    if not (isinstance(answer, dict) and "error" in answer):
        return answer
    if not answer["error"]:
        raise IndexError
    text, code, number = answer["error"]
    kind = usb.core.USBTimeoutError if number == errno.ETIMEDOUT else usb.core.USBError
    raise kind(text, code, number)


def lengthen(kept: list[Any] | None) -> Packet:
    if kept is None:
        return Packet(b"", arrived=False)
    first, left_out, last = kept
    return Packet(bytes.fromhex(first) + bytes(left_out) + bytes.fromhex(last))


def heard_in(path: Path) -> tuple[object, object]:
    """What the driver makes of a dialogue today, and made of it when it was recorded."""
    clock = ManualClock()
    player = Player(path, clock)
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
