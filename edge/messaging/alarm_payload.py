"""The alarms: every id with its meaning, payload and messages."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, Literal

from pydantic import Field

from edge.core.ports import Message
from edge.messaging.payload_base import Payload

__all__ = ["ADVICE", "ALARMS", "STAYING", "AlarmPayload", "alarm_cleared"]

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

    def message(self) -> Message:
        """Return the alarm, retained until it is cleared. Errors: ValueError for an id that is not in ALARMS."""
        return replace(alarm_cleared(self.alarm), payload=self.encode())


def alarm_cleared(alarm: str) -> Message:
    """Removes the retained alarm from the broker. Errors: ValueError for an id that is not in ALARMS."""
    if alarm not in ALARMS:
        raise ValueError(f"alarm {alarm!r} is not known; known: {', '.join(ALARMS)}")
    return Message(f"alarm/{alarm}", b"", qos=1, retain=True)


STAYING: Final = frozenset({"pulse", "outbox_full", "counts"})
"""Alarms about something that is lost: they stay until a person acknowledges them, or a restart."""

ADVICE: Final[Mapping[str, str]] = {
    "device": "check cable and hub; `gelgate devices` lists what is plugged in; another program may hold the sensor; "
    "move it to a port of its own; a blind one: check its light and gel. Count the parts made since the time it names",
    "contact": "lift the part; wipe off what stays on the gel; press the parts made meanwhile again",
    "store": "free space on its disk; check the rights of its folder; `gelgate db check`; then it goes on by itself",
    "disk": "free space: old logs, backups, recordings. Until the disk is full nothing is lost",
    "archive": "free space, or lower `archive.mb`; check the rights of the folder; `archive.presses = 0` turns it off",
    "outbox_full": "find out why the receiver is away; raise `store.outbox_mb` or `outbox_days`; dropped results stay "
    "in `gelgate history`; then acknowledge it",
    "refused": "the text has its reason: correct the broker's rules or size limit; they are offered again within a "
    "minute",
    "receiver": 'correct the broker\'s rules; set `protocol = "5"`; give each station its own name',
    "counts": "look for the lost database file; if it is gone the count is right and only unsent results are lost; "
    "then acknowledge it",
    "free_gel": "lift the part for a second",
    "bundle": "the text names the file and its fault: make the bundle again or copy it again, then `systemctl reload "
    "gelgate`",
    "golden": "`gelgate bundle verify` on the bundle; exchange it, or the computer; look for a changed version of "
    "onnxruntime",
    "overview": "check its cable; `gelgate station overview` takes a still; presses are refused meanwhile where it "
    "must see the part",
    "overload": "end other programs; use a faster bundle (`gelgate lab tradeoff`); check presses against parts made",
    "press_again": "find the piece, and treat it as not inspected or press it twice again; it ends with the next press",
    "gel": "order a gel; change it while nothing presses, and record the new one on the page or with `gelgate gel "
    "replace`",
    "gel_proof": "press as many sound parts as the text says, then `gelgate gel prove`; or carry the bundle over "
    "(`gelgate bundle carry`), or fit one on this gel: see Gel change",
    "reference": "`gelgate station reference press`, then press the master piece; where it is out of limits, the text "
    "names what to check first",
    "gel_scar": "wipe the gel; if the alarm comes back at the next press, change it: see Gel change",
    "gel_mark": "wipe the gel at that place and press a part that is known to be good; if the alarm stays, change the "
    "gel",
    "trigger_device": "check its cable; `gelgate check` tries each; it is opened again when it is back",
    "actuator": "check its cable and its supply; stop the line where a reject gate depends on it",
    "pulse": "find the part, then acknowledge it, with the button, on the page or with the request",
}
"""Alarm id to what to do, in the order of `alarm_payload.ALARMS`. Backquotes are around what is typed."""
