"""What a person does about each alarm; docs/operations.md and the page at the station show the same words."""

from collections.abc import Mapping
from typing import Final

__all__ = ["ADVICE", "STAYING"]

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
