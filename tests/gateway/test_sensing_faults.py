"""Faults of the sensing side, from press 4 of 8 on: what the station says, and what its pass light shows.

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
from station import FPS, JSONL, SERIAL, SIZE, gel, jpeg, station_config
from stepped_station import SteppedStation

from edge.core.imaging.image_bytes import with_comment
from edge.recording.format import RecordingHeader, RecordingWriter

PASS_LIGHT = """
[[actuators]]
plugin = "virtual_hid"
options = { log = "switched.jsonl" }
outputs = [{ channel = 1, when = ["pass"] }]
"""
PRESSES, SOUND = 8, 3
FREE, HOLD, IDLE = 28, 10, 18
CYCLE = HOLD + IDLE + 2
BROKEN_AT = FREE + SOUND * CYCLE - IDLE // 2
LIFTED_AT = FREE + SOUND * CYCLE + HOLD


def depth_at(number: int) -> float:
    """The part's depth at a frame: 8 presses of half a second, a second apart."""
    press, at = divmod(number - FREE, CYCLE)
    if number < FREE or press >= PRESSES:
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
    """picture: the BGR frame from the fault on, given the sound one. broken: its bytes, given the sound ones and those
    of the last sound frame. What is expected at the end: presses judged, state, alarm.
    """

    judged: int
    state: str
    alarm: str | None
    picture: Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]] = lambda number, frame: frame
    broken: Callable[[int, bytes, bytes], bytes] = lambda number, now, last: now


def flat(level: int) -> Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]:
    return lambda number, frame: np.full_like(frame, level)


def with_added(
    added: Callable[[int], NDArray[np.float32]],
) -> Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]:
    """What lies on the gel from the lift of press 4 on; it shows while no part presses."""

    def picture(number: int, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if depth_at(number) > 0 or number < LIFTED_AT:
            return frame
        colours = np.array([1.0, 0.4, -1.0], np.float32)
        return np.clip(frame + added(number)[..., None] * colours, 0, 255).astype(np.uint8)

    return picture


def garbled(number: int, now: bytes, last: bytes) -> bytes:
    """A sound header, and no picture behind it."""
    start = now.index(b"\xff\xda") + 14
    return now[:start] + bytes([number % 200 + 1]) * 3 + b"\xff\xd9"


FAULTS = {
    "black": Fault(SOUND, "halted", "device", flat(0)),
    "white": Fault(SOUND, "halted", "device", flat(255)),
    "one colour": Fault(SOUND, "halted", "device", flat(120)),
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
    "a chip of 70 %": Fault(SOUND + 1, "halted", "contact", with_added(left_behind(0.7))),
    "recovery of 25 % in 1 s": Fault(PRESSES, "ready", None, with_added(recovery(0.25, 1.0))),
    "recovery of 25 % in 2.5 s": Fault(PRESSES, "ready", None, with_added(recovery(0.25, 2.5))),
    "recovery of 17 % in 1 s": Fault(PRESSES, "ready", None, with_added(recovery(0.17, 1.0))),
    "none": Fault(PRESSES, "ready", None),
}


@cache
def sound(number: int) -> NDArray[np.uint8]:
    return gel(np.random.default_rng(number), depth_at(number))


def film(folder: Path, fault: Fault) -> Path:
    last = b""
    header = RecordingHeader("GelSight Mini R0B TEST-0001", SERIAL, SIZE, FPS, profile="cropped_lr")
    with RecordingWriter(folder, header) as writer:
        for number in range(FREE + PRESSES * CYCLE):
            frame = sound(number)
            if number < BROKEN_AT:
                payload = last = jpeg(frame)
            else:
                payload = fault.broken(number, jpeg(fault.picture(number, frame)), last)
            writer.add(payload, round(number * 1e9 / FPS), None)
    return folder


@dataclass(frozen=True)
class Row:
    """What a station did: presses judged, its last state and alarms, the time from the fault until it was halted, and
    whether the pass light was on while it was."""

    judged: int
    state: str
    alarms: tuple[str, ...]
    halted_s: float | None
    was_lit_while_halted: bool


def played(folder: Path, bundle: Path, fault: Fault) -> Row:
    sinks = JSONL % (folder / "out") + PASS_LIGHT
    config = station_config(folder, film(folder / "film", fault), bundle, sinks="SINKS", pace=1.0)
    config.write_text(config.read_text().replace("SINKS", sinks))
    with SteppedStation(config) as station:
        seen = list(looks(station))
        judged = len(station.reports)
    broken_s = next(look.at_s for look in seen if look.frames >= BROKEN_AT)
    halted = [look for look in seen if look.state == "halted"]
    return Row(
        judged,
        seen[-1].state,
        tuple(sorted(seen[-1].alarms)),
        halted[0].at_s - broken_s if halted else None,
        any(look.is_lit for look in halted),
    )


@dataclass(frozen=True)
class Look:
    at_s: float
    frames: int
    state: str
    alarms: frozenset[str]
    is_lit: bool


def looks(station: SteppedStation) -> Iterator[Look]:
    """One after every turn, from the first frame to the recording's end."""
    driver = station.parts.io.drivers[0]
    while not station.has_ended:
        station.read(1)
        while (frame := station.parts.acquisition.next(0)) is not None:
            station.loop.step(frame)
        station.loop.step(None)
        driver.step()
        view, frames = station.parts.status.view(), station.parts.acquisition.status.frames
        if frames and not station.has_ended:
            at_s = station.clock.monotonic_ns() / 1e9
            yield Look(at_s, frames, view.state, view.alarms, is_pass_lit(station))


def is_pass_lit(station: SteppedStation) -> bool:
    log = station.parts.store.path.with_name("switched.jsonl")
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    lit = [line["on"] for line in lines if line["channel"] == 1]
    return bool(lit) and lit[-1]


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_sensing_side_is_said_or_does_no_harm(
    name: str, tmp_path: Path, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The state, the alarm and the number of judged presses are those wanted; a halted station lights no pass."""
    fault = FAULTS[name]
    row = played(tmp_path, bundle, fault)
    if name == next(iter(FAULTS)):
        with capsys.disabled():
            print(
                "\n| fault | presses | judged | state | alarm | halted after |\n|---|---|---|---|---|---|",
                end="",
            )
    with capsys.disabled():
        halted = "" if row.halted_s is None else f"{row.halted_s:.1f} s"
        print(
            f"\n| {name} | {PRESSES} | {row.judged} | {row.state} | {', '.join(row.alarms)} | {halted} |",
            end="",
        )
    assert (row.judged, row.state) == (fault.judged, fault.state)
    assert row.alarms == (() if fault.alarm is None else (fault.alarm,))
    assert not row.was_lit_while_halted, "a station that inspects nothing shows a pass"
    if fault.alarm == "device":
        assert row.halted_s is not None
        assert row.halted_s <= 2.5


def test_a_chip_is_really_there() -> None:
    """What the films leave on the gel differs from it by more than a contact's level, over the share they name."""
    free = gel(np.random.default_rng(0)).astype(np.float32)
    chip = with_added(left_behind(0.36))(LIFTED_AT + 2, gel(np.random.default_rng(0))).astype(np.float32)
    touched = np.abs(cv2.GaussianBlur(chip - free, (5, 5), 0)).max(axis=2) > 15
    assert 0.2 < touched.sum() / (np.pi * 70 * 80) < 0.4
