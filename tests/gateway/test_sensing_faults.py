"""Faults of the sensing side, from press 3 of 5 on: what the station says, and what its light and its gate do.

`make test-faults` prints the table. Everything runs on the test's clock, at the sensor's pace.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from overview_stills import encoded, with_qr
from station import FPS, JSONL, SERIAL, SIZE, gel, jpeg, station_config
from stepped_station import SteppedStation

from edge.core.imaging.image_bytes import with_comment
from edge.features.outputs.stage import Outputs
from edge.features.overview import Overview
from edge.features.reference_press import ReferenceGuard
from edge.recording.format import RecordingHeader, RecordingWriter

OUTPUTS = """
[[actuators]]
plugin = "virtual_hid"
options = { log = "switched.jsonl" }
outputs = [
  { channel = 1, when = ["pass"] },
  { channel = 3, when = ["fail", "unsure", "rejected", "error"], pulse_ms = 300, deadline_ms = 500 },
]
[[reference.pieces]]
name = "M1"
"""
OVERVIEW = """
[overview]
plugin = "recorded"
codes = ["qr"]
options = { recording = "overview" }
"""
PRESSES, SOUND = 5, 2
FREE, HOLD, IDLE = 28, 10, 18
CYCLE = HOLD + IDLE + 2
BROKEN_AT = FREE + SOUND * CYCLE - IDLE // 2
LIFTED_AT = FREE + SOUND * CYCLE + HOLD
NOTICED = 4
LONG_S = 3.0
HEADING = (
    "\n| fault | presses | judged | state | alarm | halted after | frames lit for another part | rejected |"
    "\n|---|---|---|---|---|---|---|---|"
)


def depth_at(number: int) -> float:
    """The part's depth at a frame: presses of half a second, a second apart."""
    at = (number - FREE) % CYCLE
    if number < FREE:
        return 0.0
    return {0: 0.5, HOLD + 1: 0.3}.get(at, 1.0 if at <= HOLD else 0.0)


def left_behind(share: float) -> Callable[[int], NDArray[np.float32]]:
    """A chip that stays on the gel, so large against the press's area, under whatever presses."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    inside = ((x - 160) / 70) ** 2 + ((y - 120) / 80) ** 2 < share
    return lambda number: np.where(inside, 60 * np.sin(y / 3.0), 0.0).astype(np.float32)


def recovery(share: float, tau_s: float) -> Callable[[int], NDArray[np.float32]]:
    """The imprint of the last press, of which a share is left at its release and fades."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    ribs = 88 * np.sin(y / 3.0) * (((x - 160) / 70) ** 2 + ((y - 120) / 80) ** 2 < 1)

    def fade(number: int) -> NDArray[np.float32]:
        since_s = max(0, (number - FREE) % CYCLE - HOLD - 1) / FPS
        return (ribs * share * np.exp(-since_s / tau_s)).astype(np.float32)

    return fade


@dataclass(frozen=True)
class Fault:
    """What is done to a station, and the presses that it must report, its state and its alarm at the end."""

    judged: int
    state: str
    alarm: str | None
    picture: Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]] = lambda number, frame: frame
    """The BGR frame from the fault on, given the sound one."""
    broken: Callable[[int, bytes, bytes], bytes] = lambda number, now, last: now
    """The frame's bytes from the fault on, given the sound ones and those of the last sound frame."""
    usb: str | None = None
    """A fault of the mock USB device."""
    dented: tuple[int, ...] = ()
    """The damaged parts."""
    master_piece: int | None = None
    """The press before which a reference press is asked for."""
    lit_s: float = 0.0
    """How long the pass light may show another part's verdict at most."""
    overview: bool = False
    """Whether an overview camera looks, whose picture hangs from the fault on."""
    presses: int = PRESSES
    """Those of the film."""
    words: tuple[str, ...] = ()
    """The verdicts from press 3 on, where they are what the row is about."""


def flat(level: int) -> Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]:
    return lambda number, frame: np.full_like(frame, level)


def with_added(
    added: Callable[[int], NDArray[np.float32]],
) -> Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]:
    """What lies on the gel from the lift of press 3 on; it shows while no part presses."""

    def picture(number: int, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if depth_at(number) > 0 or number < LIFTED_AT:
            return frame
        colours = np.array([1.0, 0.4, -1.0], np.float32)
        return np.clip(frame + added(number)[..., None] * colours, 0, 255).astype(np.uint8)

    return picture


def dimmed(number: int, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """One LED is out: a colour is weaker, the more the nearer to its side."""
    share = np.ones((1, frame.shape[1], 3), np.float32)
    share[0, :, 2] = np.linspace(0.5, 1.0, frame.shape[1])
    return (frame * share).astype(np.uint8)


def garbled(number: int, now: bytes, last: bytes) -> bytes:
    """A sound header, and no picture behind it."""
    start = now.index(b"\xff\xda") + 14
    return now[:start] + bytes([number % 200 + 1]) * 3 + b"\xff\xd9"


FAULTS = {
    "black": Fault(SOUND, "halted", "device", flat(0)),
    "white": Fault(SOUND, "halted", "device", flat(255)),
    "one colour": Fault(SOUND, "halted", "device", flat(120)),
    "a third of the light": Fault(
        SOUND, "halted", "device", lambda number, frame: (frame * 0.35).astype(np.uint8)
    ),
    "broken in every JPEG": Fault(SOUND, "halted", "device", broken=garbled),
    "frozen": Fault(SOUND, "halted", "device", broken=lambda number, now, last: last),
    "frozen, with other bytes": Fault(
        SOUND, "halted", "device", broken=lambda number, now, last: with_comment(last, str(number))
    ),
    "two frames in turn": Fault(
        SOUND, "halted", "device", broken=lambda number, now, last: with_comment(last, f"{number % 2}")
    ),
    "a chip of 5.8 %": Fault(PRESSES, "ready", None, with_added(left_behind(0.058))),
    "a chip of 16 %": Fault(PRESSES, "ready", None, with_added(left_behind(0.16))),
    "a chip of 36 %": Fault(PRESSES, "ready", None, with_added(left_behind(0.36))),
    # Until the alarm nothing tells it from a part that is held for longer.
    "a chip of 70 %": Fault(
        SOUND + 1, "halted", "contact", with_added(left_behind(0.7)), lit_s=LONG_S, presses=7
    ),
    "recovery of 25 % in 1 s": Fault(PRESSES, "ready", None, with_added(recovery(0.25, 1.0))),
    "recovery of 25 % in 2.5 s": Fault(PRESSES, "ready", None, with_added(recovery(0.25, 2.5))),
    "recovery of 17 % in 1 s": Fault(PRESSES, "ready", None, with_added(recovery(0.17, 1.0))),
    "unplugged in press 3": Fault(PRESSES, "ready", None, usb=f"unplug@{LIFTED_AT - 4}:1"),
    "parts 3 and 5 damaged": Fault(PRESSES, "ready", None, dented=(2, 4), words=("fail", "pass", "fail")),
    "a reference press of a damaged part": Fault(
        PRESSES, "ready", None, dented=(2,), master_piece=2, words=("reference", "pass", "pass")
    ),
    "one LED out": Fault(PRESSES, "ready", None, dimmed, words=("rejected",) * 3),
    # Press 3 follows half a second later, and a still may be two seconds old.
    "the overview's picture hangs": Fault(
        PRESSES, "ready", None, overview=True, words=("pass", "rejected", "rejected")
    ),
    "none": Fault(PRESSES, "ready", None, words=("pass",) * 3),
}


@cache
def sound(number: int, is_dented: bool = False) -> tuple[NDArray[np.uint8], bytes]:
    """A frame, and its JPEG."""
    frame = gel(np.random.default_rng(number), depth_at(number), is_dented)
    return frame, jpeg(frame)


def film(folder: Path, fault: Fault) -> dict[bytes, int]:
    """Write the recording; return the number of each frame by its bytes."""
    last, numbers = b"", {}
    header = RecordingHeader("GelSight Mini R0B TEST-0001", SERIAL, SIZE, FPS, profile="cropped_lr")
    with RecordingWriter(folder, header) as writer:
        for number in range(FREE + fault.presses * CYCLE):
            frame, payload = sound(number, (number - FREE) // CYCLE in fault.dented)
            if number < BROKEN_AT:
                last = payload
            else:
                shown = fault.picture(number, frame)
                payload = fault.broken(number, payload if shown is frame else jpeg(shown), last)
            numbers.setdefault(payload, number)
            writer.add(payload, round(number * 1e9 / FPS), None)
    return numbers


def overview_film(folder: Path) -> None:
    """A part with its code at each frame of the sensor; the picture hangs from the fault on, with other bytes."""
    part, noise = with_qr("PZ0").astype(np.float32), np.random.default_rng(1)
    with RecordingWriter(folder, RecordingHeader("overview", "C1", SIZE, FPS)) as writer:
        for number in range(FREE + PRESSES * CYCLE + 10):
            if number < BROKEN_AT:
                still = encoded(np.clip(part + noise.normal(0, 2, part.shape), 0, 255).astype(np.uint8))
            writer.add(with_comment(still, str(number)), round(number * 1e9 / FPS), None)


@dataclass(frozen=True)
class Row:
    """What a station did with its presses."""

    words: tuple[str, ...]
    """The verdict of each press that it reported."""
    state: str
    alarms: tuple[str, ...]
    halted_s: float | None
    """Seconds from the fault until it was halted."""
    lit_frames: int
    """Frames at which the pass light was on and the part that pressed last was not passed."""
    pulses: int
    """Pulses of the reject gate."""

    @property
    def not_passed(self) -> int:
        return sum(word not in ("pass", "reference") for word in self.words)


@dataclass(frozen=True)
class Look:
    at_s: float
    number: int
    state: str
    alarms: frozenset[str]
    is_lit_in_error: bool


def played(folder: Path, bundle: Path, fault: Fault) -> Row:
    numbers = film(folder / "film", fault)
    faults = [fault.usb] if fault.usb else []
    config = station_config(folder, folder / "film", bundle, sinks="SINKS", pace=1.0, faults=faults)
    tables = JSONL % (folder / "out") + OUTPUTS
    if fault.overview:
        overview_film(folder / "overview")
        tables += OVERVIEW
    config.write_text(config.read_text().replace("SINKS", tables))
    with SteppedStation(config) as station:
        seen = list(looks(station, numbers, fault))
        words = tuple(report.word for report in station.reports)
    broken_s = next(look.at_s for look in seen if look.number >= BROKEN_AT - 1)
    halted = [look for look in seen if look.state == "halted"]
    return Row(
        words,
        seen[-1].state,
        tuple(sorted(seen[-1].alarms)),
        halted[0].at_s - broken_s if halted else None,
        sum(look.is_lit_in_error for look in seen),
        sum(is_on for is_on in switched(station, 3)),
    )


def looks(station: SteppedStation, numbers: dict[bytes, int], fault: Fault) -> Iterator[Look]:
    """One after every turn, from the first frame to the recording's end."""
    parts, status, driver = station.parts, station.parts.status, station.find(Outputs).drivers[0]
    verdicts: dict[int, str] = {}
    part, number, reported, start_ns = 0, 0, 0, 0
    while not station.has_ended:
        if (overview := station.loop.find(Overview)) is not None:
            overview.camera.step()
        station.read(1)
        while (frame := parts.acquisition.next(0)) is not None:
            start_ns = start_ns or frame.timestamp_ns
            number = numbers.get(frame.payload, number)
            station.loop.step(frame)
        if start_ns and not fault.usb:  # a broken film has no frame by which its time could be told
            number = round((station.clock.monotonic_ns() - start_ns) * FPS / 1e9)
        part = max(0, number - FREE - NOTICED) // CYCLE
        station.loop.step(None)
        driver.step()
        for report in station.reports[reported:]:
            verdicts[part], reported = report.word, reported + 1
        if fault.master_piece == reported and number == BROKEN_AT:
            station.find(ReferenceGuard).request("M1")
        if parts.acquisition.status.frames and not station.has_ended:
            view = status.view()
            is_lit = [False, *switched(station, channel=1)][-1]
            at_s = station.clock.monotonic_ns() / 1e9
            yield Look(at_s, number, view.state, view.alarms, is_lit and verdicts.get(part) != "pass")


def switched(station: SteppedStation, channel: int) -> list[bool]:
    """What the board did with a channel."""
    log = station.parts.store.path.with_name("switched.jsonl")
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    return [line["on"] for line in lines if line["channel"] == channel]


# Those that differ from another row by a number alone.
ALIKE = (
    "white",
    "one colour",
    "a chip of 5.8 %",
    "a chip of 16 %",
    "recovery of 25 % in 2.5 s",
    "recovery of 17 % in 1 s",
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.lab if name in ALIKE else ()) for name in FAULTS]
)
def test_a_fault_of_the_sensing_side_is_said_or_does_no_harm(
    name: str, tmp_path: Path, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """State, alarm and judged presses are those wanted; the light is no other part's, the gate rejects what is not
    passed."""
    fault = FAULTS[name]
    row = played(tmp_path, bundle, fault)
    with capsys.disabled():
        if name == next(iter(FAULTS)):
            print(HEADING, end="")
        halted = "" if row.halted_s is None else f"{row.halted_s:.1f} s"
        cells = (
            name,
            fault.presses,
            len(row.words),
            row.state,
            ", ".join(row.alarms),
            halted,
            row.lit_frames,
        )
        print("\n|", *(f"{cell} |" for cell in cells), f"{row.pulses} of {row.not_passed} |", end="")
    assert (len(row.words), row.state) == (fault.judged, fault.state)
    assert row.alarms == (() if fault.alarm is None else (fault.alarm,))
    assert row.words[SOUND:] == fault.words or not fault.words
    assert row.lit_frames <= fault.lit_s * FPS, "the pass light is on for a part that was not passed"
    assert row.pulses == row.not_passed, "a part that was not passed went by the gate"
    if fault.alarm == "device":
        assert row.halted_s is not None
        assert row.halted_s <= 2.0 + 3 / FPS


def test_a_chip_is_really_there() -> None:
    """What the films leave on the gel differs from it by more than a contact's level, over the share they name."""
    free = gel(np.random.default_rng(0)).astype(np.float32)
    chip = with_added(left_behind(0.36))(LIFTED_AT + 2, gel(np.random.default_rng(0))).astype(np.float32)
    touched = np.abs(cv2.GaussianBlur(chip - free, (5, 5), 0)).max(axis=2) > 15
    assert 0.2 < touched.sum() / (np.pi * 70 * 80) < 0.4
