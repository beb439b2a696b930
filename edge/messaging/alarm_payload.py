"""The alarms: every id with its meaning, payload and messages."""

from collections.abc import Mapping
from typing import Final, Literal

from pydantic import Field

from edge.core.ports import Message
from edge.messaging.payload_base import Payload

__all__ = ["ALARMS", "AlarmPayload", "alarm_cleared", "alarm_message"]

ALARMS: Final[Mapping[str, str]] = {
    "device": "the sensor is missing, stalled or blind: its frames are broken, black, of one colour or frozen",
    "contact": "something has pressed the gel much longer than usual; nothing over it is seen, and inspection halts",
    "store": "the database or its disk refuses writes; inspection halts",
    "disk": "the disk of the database has little room left; when it is full, inspection halts",
    "archive": "presses are judged, and what their verdicts are made from is not kept: no room, or a fault of the disk",
    "outbox_full": "unsent messages were dropped: too old, or no room; heatmaps first, passes next, fails last",
    "refused": "a receiver refused a message; it is kept and offered again within a minute",
    "receiver": "a receiver works, with a fault that a person should correct: denied topics, its MQTT level, client id",
    "counts": "the database knew less than the second record of the counts: it was removed, damaged or replaced",
    "free_gel": "the free gel was learnt while something pressed; nothing is scored until the free gel is seen at rest",
    "bundle": "a configured bundle cannot be used, or is older than one that was; the ones in use go on inspecting",
    "golden": "the golden frames of the bundle in use score otherwise than at its fit; no press has a verdict",
    "overview": "the overview camera gives no pictures: presses are refused where it must see the part",
    "overload": "this machine is too slow for its frames: some were dropped or judged too late, presses may be missed",
    "press_again": "a second press of a piece was asked for and did not come; the piece has no verdict",
    "gel": "the gel is due or must be replaced",
    "gel_proof": "the bundle in use is not yet proven on the mounted gel; with `refuse` parts are rejected meanwhile",
    "reference": "a reference press is due, out of limits or waited for; with `refuse` parts are rejected meanwhile",
    "gel_scar": "scars of the gel hide more of what is pressed than is accepted; presses do not pass",
    "gel_mark": "one place of the gel exceeds the limit in five presses in a row; the text says where",
    "trigger_device": "a pedal or button cannot be used",
    "actuator": "a light or relay cannot be used, or its watchdog has put it into its safe state",
    "pulse": "a pulse was not given in time: a part may have passed; stays until acknowledged, or a restart",
}
"""Alarm id to meaning. All are cleared at start, so that no alarm outlives the process that raised it."""


class AlarmPayload(Payload):
    """A fault that a person should check. The topic is emptied when it is over."""

    alarm: str
    severity: Literal["warning", "error"] = "error"
    text: str = Field(description="one sentence: the thing, what was found, what to do")
    count: int = Field(default=1, ge=1, description="how often since it was last clear")


def alarm_message(payload: AlarmPayload) -> Message:
    """A raised alarm, retained until it is cleared. Errors: ValueError for an id that is not in ALARMS."""
    return Message(f"alarm/{_check_alarm(payload.alarm)}", payload.encode(), qos=1, retain=True)


def alarm_cleared(alarm: str) -> Message:
    """Removes the retained alarm from the broker. Errors: ValueError for an id that is not in ALARMS."""
    return Message(f"alarm/{_check_alarm(alarm)}", b"", qos=1, retain=True)


def _check_alarm(alarm: str) -> str:
    if alarm not in ALARMS:
        raise ValueError(f"alarm {alarm!r} is not known; known: {', '.join(ALARMS)}")
    return alarm
