"""The alarms: every id with what to do, payload and messages."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

from pydantic import Field

from edge import registry
from edge.core.errors import ConfigError
from edge.core.ports import Message
from edge.core.sink_context import topic_level
from edge.messaging.payload_base import Payload

__all__ = ["ALARMS", "Alarm", "AlarmPayload", "alarm_cleared", "list_alarms"]


@dataclass(frozen=True)
class Alarm:
    """One kind of alarm."""

    what_to_do: str = ""
    """Backquotes are around what is typed. Empty where the text of each alarm says it."""
    stays: bool = False
    """Whether something is lost: it stays until a person acknowledges it, or a restart."""
    title: str = ""
    """What has happened, in a few words: the page has them in its languages."""


ALARMS: Final[Mapping[str, Alarm]] = {
    "device": Alarm(
        "check cable and hub; `gelgate devices` lists what is plugged in; another program may hold the "
        "sensor; move it to a port of its own; a blind one: check its light and gel. Count the parts made "
        "since the time it names",
        title="The sensor is missing, or sees nothing",
    ),
    "contact": Alarm(
        "lift the part; wipe off what stays on the gel; press the parts made meanwhile again",
        title="Something stays on the gel",
    ),
    "store": Alarm(
        "free space on its disk; check the rights of its folder; `gelgate db check`; then it goes on by "
        "itself",
        title="The database takes nothing",
    ),
    "disk": Alarm(
        "free space: old logs, backups, recordings. Until the disk is full nothing is lost",
        title="The disk is nearly full",
    ),
    "archive": Alarm(
        "free space, or lower `archive.mb`; check the rights of the folder; `archive.presses = 0` turns it "
        "off",
        title="Presses are not archived",
    ),
    "outbox_full": Alarm(
        "find out why the receiver is away; raise `store.outbox_mb` or `outbox_days`; dropped results stay "
        "in `gelgate history`; then acknowledge it",
        stays=True,
        title="Unsent messages were dropped",
    ),
    "refused": Alarm(
        "the text has its reason: correct the broker's rules or size limit; they are offered again within "
        "a minute",
        title="A receiver refuses messages",
    ),
    "receiver": Alarm(
        "correct the broker's rules, or a folder's rights; set `protocol = \"5\"`; give each station its own name, and "
        "each page its own port",
        title="A receiver works with a fault",
    ),
    "counts": Alarm(
        "look for the lost database file; if it is gone the count is right, and its history, unsent results, proofs "
        "and what people said and did are lost; then acknowledge it",
        stays=True,
        title="Counts were corrected",
    ),
    "free_gel": Alarm(
        "lift the part for a second",
        title="The free gel was learnt while something touched it",
    ),
    "bundle": Alarm(
        "the text names the file and its fault: make the bundle again or copy it again, then `systemctl "
        "reload gelgate`",
        title="A bundle cannot be used",
    ),
    "shadow": Alarm(
        "the text names the file and its fault: make the bundle again or copy it again, then `systemctl reload "
        "gelgate`",
        title="The shadow is not scored",
    ),
    "takeover": Alarm(
        "read why, then acknowledge it; `restore_bundle` brings the configured bundle back",
        stays=True,
        title="Another bundle inspects now",
    ),
    "golden": Alarm(
        "`gelgate bundle verify` on the bundle; exchange it, or the computer; look for a changed version "
        "of onnxruntime",
        title="The bundle scores otherwise than at its fit",
    ),
    "overview": Alarm(
        "check its cable; `gelgate station overview` takes a still; presses are refused meanwhile where it "
        "must see the part",
        title="The overview camera gives no pictures",
    ),
    "overload": Alarm(
        "end other programs; use a faster bundle (`gelgate lab tradeoff`); check presses against parts made",
        title="This machine is too slow",
    ),
    "gel_overload": Alarm(
        "take the part off and look at the gel for a cut; then press less deep, or set a stop. It ends when the gel is "
        "free; `gelgate station acts` keeps each (`overload`)",
        title="The gel is pressed too deep",
    ),
    "press_again": Alarm(
        "find the piece, and treat it as not inspected or press it twice again; it ends with the next press",
        title="A second press did not come",
    ),
    "piece": Alarm(
        "take the unfinished piece away and begin the next one, on the page, with `begin_piece` or with its code; a "
        "place without a bundle: put the bundle back, and reload",
        title="A piece is unfinished, or a place has no bundle",
    ),
    "gel": Alarm(
        "order a gel; change it while nothing presses, and record the new one on the page or with `gelgate "
        "gel replace`",
        title="The gel is worn",
    ),
    "gel_expired": Alarm(
        "mount another gel, and record it with its own date; where the date was mistyped, record this gel once more "
        "with its serial: its count goes on",
        title="The gel is past its date",
    ),
    "gel_proof": Alarm(
        "press as many sound parts as the text says, then `gelgate gel prove`; or say what its presses were "
        "and learn from them (`gelgate bundle learn`), or fit a bundle on this gel: see Gel change",
        title="The bundle is not proven on this gel",
    ),
    "reference": Alarm(
        "`gelgate station reference press`, then press the master piece; where it is out of limits, the "
        "text names what to check first",
        title="The master piece is due, or out of limits",
    ),
    "gel_scar": Alarm(
        "wipe the gel; if the alarm comes back at the next press, change it: see Gel change",
        title="Scars of the gel hide too much",
    ),
    "gel_mark": Alarm(
        "wipe the gel at that place and press a part that is known to be good; if the alarm stays, change "
        "the gel",
        title="One place of the gel stands out again and again",
    ),
    "drift": Alarm(
        "the text names what has shifted, since when, and what to check; acknowledge it where that is right: the chart "
        "then begins again",
        stays=True,
        title="Presses are no longer as before",
    ),
    "escape": Alarm(
        "find the pieces; `gelgate bundle teach` shows what would have found the damage, and what that costs; where a "
        "word was wrong, say what the press was",
        title="A damaged part has passed",
    ),
    "false_alarms": Alarm(
        "learn from them: `gelgate bundle learn`, and name the new bundle as the shadow; where a word was wrong, say "
        "what the press was",
        title="More good parts fail than promised",
    ),
    "trigger_device": Alarm(
        "check its cable; `gelgate check` tries each; it is opened again when it is back",
        title="A pedal or button cannot be used",
    ),
    "actuator": Alarm(
        "check its cable and its supply; stop the line where a reject gate depends on it",
        title="A light or relay cannot be used",
    ),
    "plc": Alarm(
        "check the PLC's program and its cable; it ends with the next change of the watchdog, or with "
        "acknowledge; see plc.md",
        title="The PLC does not answer",
    ),
    "pulse": Alarm(
        "find the part, then acknowledge it, with the button, on the page or with the request",
        stays=True,
        title="A pulse was not given in time",
    ),
}
"""Those of gelgate, by id, also of features that are not configured: all are cleared at start, so that no alarm
outlives the process that raised it."""


def list_alarms() -> Mapping[str, Alarm]:
    """Return gelgate's alarms and those of installed features of other packages.

    Errors: ConfigError for a feature that cannot be loaded, or whose alarms are none, or have an id that is no topic
    level or another's.
    """
    known = dict(ALARMS)
    for name in registry.foreign("features"):
        alarms: object = getattr(registry.feature(name), "alarms", {})
        if not isinstance(alarms, Mapping) or not all(isinstance(kind, Alarm) for kind in alarms.values()):
            raise ConfigError(
                f"the feature '{name}' declares the alarms {alarms!r:.80}, expected a mapping of each id to an Alarm; "
                "correct its package"
            )
        for alarm, kind in alarms.items():
            if alarm in known:
                raise ConfigError(
                    f"the feature '{name}' declares the alarm '{alarm}', which is another's; rename it"
                )
            try:
                known[topic_level(alarm)] = kind
            except ValueError as error:
                raise ConfigError(f"the feature '{name}' declares the alarm '{alarm}': {error}") from error
    return known


class AlarmPayload(Payload):
    """A fault that a person should check. The topic is emptied when it is over."""

    alarm: str
    severity: Literal["warning", "error"] = "error"
    text: str = Field(description="one sentence: the thing, what was found, what to do")
    count: int = Field(default=1, ge=1, description="how often since it was last clear")

    def message(self) -> Message:
        """Return the alarm, retained until it is cleared. Errors: ValueError for an id that no one declares."""
        return replace(alarm_cleared(self.alarm), payload=self.encode())


def alarm_cleared(alarm: str) -> Message:
    """Removes the retained alarm from the broker. Errors: ValueError for an id that no one declares."""
    if alarm not in ALARMS and alarm not in (known := list_alarms()):
        raise ValueError(f"alarm {alarm!r} is not known; known: {', '.join(known)}")
    return Message(f"alarm/{alarm}", b"", qos=1, retain=True)
