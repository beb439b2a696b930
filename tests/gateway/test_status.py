"""The state of a station, from all its faults."""

import json

import pytest
import tiny

from edge.acquisition import AcquisitionState, AcquisitionStatus
from edge.clock import ManualClock
from edge.core.ports import DeviceIdentity, Message
from edge.features.overview import say_overview_camera
from edge.gateway.status import StationStatus
from edge.model.bundle import Bundle
from edge.model.manifest import Provenance


class Heard:
    """The published states in order, and the raised alarms."""

    def __init__(self) -> None:
        self.states: list[str] = []
        self.reasons: list[str | None] = []
        self.alarms: set[str] = set()
        self.available: list[bytes] = []
        self.info: dict[str, object] = {}

    def __call__(self, message: Message) -> None:
        if message.topic == "state":
            content = json.loads(message.payload)
            self.states.append(content["state"])
            self.reasons.append(content["reason"])
        elif message.topic == "availability":
            self.available.append(message.payload)
        elif message.topic == "info":
            self.info = json.loads(message.payload)
        elif message.payload and message.topic.startswith("alarm/"):
            self.alarms.add(message.topic)
        else:
            self.alarms.discard(message.topic)


def test_ready_is_said_when_nothing_is_awaited_any_more() -> None:
    """A sensor alone is not enough: before the free gel is learnt no press is detected."""
    heard = Heard()
    status = StationStatus(heard, ManualClock())
    status.set_waiting_for("the sensor")
    status.set_waiting_for("the free gel")
    status.set_waiting_for(None)
    status.stopped()

    assert [heard.available[0], *heard.available[-2:]] == [b"online", b"online", b"offline"]
    assert heard.states == ["starting", "starting", "ready", "stopped"]
    assert heard.reasons == ["waiting for the sensor", "waiting for the free gel", None, None]


def test_one_fault_cleared_is_not_ready_while_another_lasts() -> None:
    """The sensor comes back while the disk is still full."""
    heard = Heard()
    status = StationStatus(heard, ManualClock())
    status.set_fault("device", "the sensor is gone.")
    status.set_fault("store", "the disk is full.")
    status.set_fault("device", None)

    assert (heard.states[-1], heard.reasons[-1]) == ("halted", "the disk is full.")
    assert heard.alarms == {"alarm/store"}
    status.set_fault("store", None)
    assert heard.states[-1] == "ready"
    assert heard.alarms == set()


def test_a_fault_that_lasts_is_said_once() -> None:
    """And again when its sentence is another."""
    heard = Heard()
    status = StationStatus(heard, ManualClock())

    assert [status.set_fault("store", text) for text in ("full", "full", "read-only")] == [True, False, False]
    assert heard.reasons == ["full", "read-only"]


def test_an_alarm_that_stays_as_it_is_is_published_once() -> None:
    """And again with another sentence or severity, and after it was cleared."""
    heard: list[Message] = []
    status, disk, full = StationStatus(heard.append, ManualClock()), "the disk is full", "it is full"
    status.say("disk", None)
    for sentence in (disk, disk, full, None, None, full):
        status.say("disk", sentence, "warning")
    status.say("disk", full)

    texts = [message.payload and json.loads(message.payload)["text"] for message in heard]
    assert texts == [disk, full, b"", full, full]


def test_an_alarm_is_in_the_log_once_until_it_is_cleared(caplog: pytest.LogCaptureFixture) -> None:
    """The log has an overload once, not every ten seconds."""
    status = StationStatus(Heard(), ManualClock())
    for text in ("96 of 179 frames were dropped", "40 of 100 frames were dropped", None, "again"):
        status.say("overload", text)

    assert [record.getMessage() for record in caplog.records] == [
        "alarm overload: 96 of 179 frames were dropped",
        "alarm overload: again",
    ]


def test_info_says_what_the_fit_warned_of_and_what_is_promised() -> None:
    """The broker has the warnings of the fit, and how often sound presses fail."""
    heard = Heard()
    said = "press 'a' stands apart"
    facts = tiny.tiny_files(provenance=Provenance(created="2026-01-01", warnings=(said,)))
    identity = DeviceIdentity("Mini", "1", (640, 480), 25.0)
    StationStatus(heard, ManualClock()).info(Bundle.in_memory(*facts), identity)

    assert heard.info["warnings"] == [said]
    assert heard.info["false_alarms"] == "no rate is promised: the threshold was given"


@pytest.mark.parametrize(
    ("is_needed", "severity", "effect"),
    [(True, "error", "presses are refused"), (False, "warning", "results come without its still")],
)
@pytest.mark.parametrize(
    "lost",
    [
        AcquisitionStatus(AcquisitionState.FAULT, fault="camera C1 was unplugged"),
        AcquisitionStatus(AcquisitionState.ENDED),
    ],
)
def test_an_overview_camera_that_is_away_is_an_alarm_and_no_halt(
    lost: AcquisitionStatus, is_needed: bool, severity: str, effect: str
) -> None:
    """As severe as what it causes, and cleared when it is back; the state does not change."""
    said: list[Message] = []
    status = StationStatus(said.append, ManualClock())
    say_overview_camera(status, lost, is_needed=is_needed)
    alarm = json.loads(said[-1].payload)
    say_overview_camera(status, AcquisitionStatus(AcquisitionState.STREAMING), is_needed=is_needed)

    assert [message.topic for message in said] == ["alarm/overview"] * 2
    assert (alarm["severity"], said[-1].payload) == (severity, b"")
    assert (lost.fault or "is over") in alarm["text"]
    assert alarm["text"].endswith(f"; until it is back {effect}")
