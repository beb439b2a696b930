"""The register map: every address that a PLC reads or writes, with its meaning; docs/plc.md prints it from here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, get_args

from edge.core.contact_state import ContactState
from edge.core.handshake import LONGEST_TEXT, HandshakeView, Trigger

__all__ = [
    "ALARM_BITS",
    "COILS",
    "HOLDING",
    "INPUTS",
    "MAP_VERSION",
    "STATUS_BITS",
    "TEXT_REGISTERS",
    "Register",
    "input_registers",
    "read_trigger",
    "status_bits",
]

# Changes with every change of an address or a meaning.
MAP_VERSION: Final = 1
TEXT_REGISTERS: Final = LONGEST_TEXT // 2
# A score ratio in thousandths; at and above the largest value, and where a press has none.
_LARGEST_RATIO: Final = 65_534
_NO_RATIO: Final = 65_535

COILS: Final[Sequence[tuple[str, str]]] = (
    ("trigger", "0 to 1: inspect, with the holding registers as they are then"),
    ("acknowledge", "0 to 1: the result was read; while busy: it is not wanted, and no press answers it"),
    ("watchdog", "every change is a sign of life, with `watchdog_s`"),
)
"""By address: name and meaning."""

STATUS_BITS: Final[Sequence[tuple[str, str, Callable[[HandshakeView], bool]]]] = (
    ("ready", "a trigger would be taken", lambda view: view.is_ready),
    ("busy", "a trigger waits for its press", lambda view: view.step == "busy"),
    ("done", "the result is there, until it is acknowledged", lambda view: view.step == "done"),
    ("pass", "and it is a pass", lambda view: view.is_pass),
    ("fail", "and it is a fail", lambda view: view.word == "fail"),
    ("unsure", "and the score is too near to the threshold", lambda view: view.word == "unsure"),
    ("rejected", "and the press could not be used", lambda view: view.word == "rejected"),
    ("error", "and there is none: `error code` says why", lambda view: view.word == "error"),
    ("not passed", "the complement of pass, also while there is no result", lambda view: not view.is_pass),
    ("alarm", "any alarm is raised", lambda view: bool(view.station.alarms)),
    ("piece", "a piece of several places is in progress", lambda view: view.station.piece_id is not None),
    (
        "place",
        "done, and one place of a piece passed; others are missing, so it is not passed",
        lambda view: view.word == "place",
    ),
)
"""By bit of the status word, and by address of the discrete inputs: name, meaning and value."""

ALARM_BITS: Final[Sequence[tuple[str, ...]]] = (
    ("device",),
    ("contact", "free_gel"),
    ("store", "counts"),
    ("disk", "archive"),
    ("outbox_full", "refused", "receiver"),
    ("bundle", "golden"),
    ("gel", "gel_expired"),
    ("gel_proof", "gel_scar", "gel_mark"),
    ("reference",),
    ("overview",),
    ("overload", "gel_overload"),
    ("press_again", "piece"),
    ("trigger_device", "actuator", "pulse"),
    ("plc",),
    ("drift", "false_alarms", "escape"),
)
"""By bit of the alarm word: the alarms that set it. The last bit, 15, is set by every other one."""


@dataclass(frozen=True)
class Register:
    """One value of a PLC, in one or several registers, the high word first."""

    name: str
    meaning: str
    value: Callable[[HandshakeView], int]
    count: int = 1


def status_bits(view: HandshakeView) -> list[bool]:
    """Return the discrete inputs, from address 0 on."""
    return [value(view) for _, _, value in STATUS_BITS]


def _alarm_word(view: HandshakeView) -> int:
    left, word = set(view.station.alarms), 0
    for bit, alarms in enumerate(ALARM_BITS):
        word |= (not left.isdisjoint(alarms)) << bit
        left -= set(alarms)
    return word | bool(left) << 15


def _ratio(view: HandshakeView) -> int:
    if view.score_ratio is None:
        return _NO_RATIO
    return min(max(round(view.score_ratio * 1000), 0), _LARGEST_RATIO)


_CONTACT: Final[tuple[str, ...]] = get_args(ContactState)

INPUTS: Final[Sequence[Register]] = (
    Register(
        "status word",
        "the discrete inputs as bits, input 0 in bit 0",
        lambda view: sum(is_set << bit for bit, is_set in enumerate(status_bits(view))),
    ),
    Register("id", "of the trigger that is busy or done; 0 for none", lambda view: view.trigger_id, 2),
    Register("error code", "why the result is an error", lambda view: view.code),
    Register(
        "refusal code", "why the newest trigger was refused; 0 since one was taken", lambda view: view.refused
    ),
    Register(
        "score ratio",
        "1000 times score / threshold: above 1000 fails; 65534 for more, 65535 for none",
        _ratio,
    ),
    Register("gel life", "percent of its presses that the gel has left", lambda view: view.gel_left_percent),
    Register("alarm word", "the raised alarms", _alarm_word),
    Register(
        "contact",
        "as on the topic `contact`: " + ", ".join(f"{n} {word}" for n, word in enumerate(_CONTACT)),
        lambda view: _CONTACT.index(view.station.contact),
    ),
    Register("map version", "of this table", lambda view: MAP_VERSION),
)

HOLDING: Final[Mapping[str, tuple[int, str]]] = {
    "trigger id": (2, "1 to 4294967295, the high word first; another one than that of the trigger before"),
    "piece id": (TEXT_REGISTERS, "ASCII, two characters in a register, zeros behind; zeros for none"),
    "part": (TEXT_REGISTERS, "the same: a name of the part to inspect; zeros for the one that is selected"),
}
"""Name to number of registers and meaning, from address 0 on."""


def input_registers(view: HandshakeView) -> list[int]:
    """Return the input registers, from address 0 on: all of one moment."""
    words: list[int] = []
    for register in INPUTS:
        value = register.value(view)
        words += [value >> 16 * place & 0xFFFF for place in reversed(range(register.count))]
    return words


def read_trigger(holding: Sequence[int]) -> Trigger:
    """Read what a trigger asks for. What is not ASCII stays recognisable as that."""
    texts = [
        b"".join(word.to_bytes(2, "big") for word in holding[start : start + TEXT_REGISTERS])
        for start in (2, 2 + TEXT_REGISTERS)
    ]
    piece, part = (text.rstrip(b"\0").decode("latin-1") for text in texts)
    return Trigger(holding[0] << 16 | holding[1], piece, part)
