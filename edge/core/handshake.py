"""The handshake of a station with a PLC: which press answers which trigger, and what the PLC sees of it.

A PLC gives a trigger with an id; the station is busy until one press has answered it, then done with a result that
stays until it is acknowledged. What cannot be judged in time is done, too, as an error: never as a pass.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Final, Literal, Protocol, Self, final, runtime_checkable

from edge.core.digital_io import LOOP_S, StationView

__all__ = [
    "LONGEST_TEXT",
    "Code",
    "Handshake",
    "HandshakeMachine",
    "HandshakeServer",
    "HandshakeStep",
    "HandshakeView",
    "Refusal",
    "Trigger",
    "check_trigger",
]

# The longest piece id and name of a part, in characters.
LONGEST_TEXT: Final = 32
_LARGEST_ID: Final = 2**32 - 1

HandshakeStep = Literal["idle", "busy", "done"]


class Code(IntEnum):
    """Why a trigger is refused, or a result is an error. The numbers are part of the register map."""

    meaning: str
    """For the manual."""

    def __new__(cls, number: int, meaning: str) -> Self:
        member = int.__new__(cls, number)
        member._value_, member.meaning = number, meaning
        return member

    NONE = 0, "nothing is refused, and no result is an error"
    BUSY = 1, "a trigger while busy"
    NOT_ACKNOWLEDGED = 2, "a trigger before the last result was acknowledged"
    ID_TWICE = 3, "a trigger with the id of the one before"
    BAD_VALUE = (
        4,
        "a trigger with the id 0, or a text that is not printable ASCII; a trigger coil that was not 0 before",
    )
    NOT_READY = 5, "a trigger while the station does not inspect"
    UNKNOWN_PART = 6, "a trigger that names a part without a bundle, or with several positions"
    NO_BEAT = 7, "the PLC's watchdog stands still: a trigger is refused, a result is an error"
    TIMED_OUT = 8, "no press was judged and recorded in time"
    HALTED = 9, "the station stopped inspecting before the result was acknowledged"
    NOTHING_PRESSED = 10, "nothing pressed the gel, or its press had its verdict before the trigger"
    OTHER_PART = 11, "another part was selected when the press came, so it was not judged"
    NOT_JUDGED = 12, "the press could not be judged, or ended without a verdict"
    PIECE = (
        13,
        "the piece of several places that the trigger names cannot begin, for its id was used before, or was over "
        "when the press came",
    )


@dataclass(frozen=True)
class Refusal:
    """Why a trigger is not taken."""

    code: Code
    sentence: str
    """The thing, what was found, and what to do."""


@dataclass(frozen=True)
class Trigger:
    """What a PLC asks for."""

    trigger_id: int
    piece: str = ""
    """The id of the piece; empty for none."""
    part: str = ""
    """A name of the part to inspect; empty for the one that is selected."""


@dataclass(frozen=True)
class HandshakeView:
    """All that a PLC sees, at one moment."""

    step: HandshakeStep = "idle"
    is_ready: bool = False
    """A trigger would be taken now."""
    trigger_id: int = 0
    """Of the trigger that is busy or done; 0 while idle."""
    word: str | None = None
    """The result: pass, fail, unsure, rejected, error, or `place` for a pass of one place of a piece, whose others are
    missing; None until it is done."""
    code: Code = Code.NONE
    """Why the result is an error."""
    refused: Code = Code.NONE
    """Why the newest trigger was refused; none since one was taken."""
    score_ratio: float | None = None
    """Score / threshold of the press; above 1 fails."""
    piece: str = ""
    """The id of its piece; empty for none."""
    press_id: str = ""
    """The press that answered; empty where none did."""
    gel_left_percent: int = 0
    """Presses that the gel has left, of those it is allowed."""
    station: StationView = field(default_factory=StationView)

    @property
    def is_pass(self) -> bool:
        """True for a result that is a pass, and for nothing else."""
        return self.step == "done" and self.word == "pass"


@runtime_checkable
class Handshake(Protocol):
    """What a server asks of the station. Any thread may use it; each call returns at once."""

    def read(self) -> HandshakeView:
        """Return what a PLC sees now, one moment of all values."""

    def trigger(self, trigger: Trigger) -> Refusal | None:
        """Begin a handshake, or return why not; the refusal is recorded."""

    def acknowledge(self) -> None:
        """End the handshake: a result was read, or is not wanted any more."""

    def beat(self) -> None:
        """Take a sign of life of the PLC."""

    def refuse(self, what: str, sentence: str) -> None:
        """Record what the server itself refuses. what: was asked for, as `read`, `write` or `trigger`; the code of a
        trigger is shown."""


@runtime_checkable
class HandshakeServer(Protocol):
    """A server for a PLC, with its port taken and not yet serving."""

    @property
    def name(self) -> str:
        """Such as `Modbus TCP at 192.168.0.5:502`."""

    @property
    def has_ended(self) -> bool:
        """Tell whether it served, and its thread has ended."""

    def start(self, handshake: Handshake) -> None:
        """Serve in the background until `close`."""

    def close(self) -> None:
        """Free the port, and end every connection. May be called again, and without `start`."""


def check_trigger(trigger: Trigger) -> Refusal | None:
    """Return why a trigger can never be taken, None where it can."""
    if not 1 <= trigger.trigger_id <= _LARGEST_ID:
        return Refusal(
            Code.BAD_VALUE,
            f"the trigger id is {trigger.trigger_id}, expected 1 to {_LARGEST_ID}; count up with every piece",
        )
    for what, text in (("piece id", trigger.piece), ("part", trigger.part)):
        if not (text.isascii() and (text.isprintable() or not text) and len(text) <= LONGEST_TEXT):
            return Refusal(
                Code.BAD_VALUE,
                f"the {what} {text!r:.60} is not up to {LONGEST_TEXT} printable ASCII characters; correct the PLC",
            )
    return None


@final
class HandshakeMachine:
    """One handshake after another, without a clock. Times are monotonic nanoseconds.

    timeout_ns: from the trigger to the recorded press. watchdog_ns: between two beats of the PLC at most; None where it
    gives none. is_command: a trigger asks for the verdict of the press that is held, not of the next one.

    The loop tells of presses: `reach` after the frames of before a trigger; `look` for each frame; `begin`, `judge` and
    `record` for each press of a part; `show` with each turn. The PLC asks: `read`, `trigger`, `acknowledge`, `beat`.
    """

    def __init__(self, timeout_ns: int, watchdog_ns: int | None, now_ns: int, *, is_command: bool) -> None:
        self._timeout_ns, self._watchdog_ns, self._is_command = timeout_ns, watchdog_ns, is_command
        self._view = HandshakeView()
        self._shown_ns = now_ns
        self._beat_ns, self._has_beaten = now_ns, False
        self._last_id = 0
        self._trigger_ns = 0
        self._part: str | None = None
        self._is_touched = True  # until the gel is seen free
        self._is_reached = False  # every frame of before the trigger was looked at
        self._needs_free = True  # before a press can be the answer
        self._is_pressed = False  # by the press that answers
        self._awaited: tuple[str, str] | None = (
            None  # the press that passes when it is recorded, and its word
        )

    def read(self, now_ns: int) -> HandshakeView:
        """Return what a PLC sees now. Time alone ends what takes too long, also where the loop hangs."""
        fault = self._fault(now_ns)
        if self._view.step == "busy" and fault is None and now_ns - self._trigger_ns >= self._timeout_ns:
            fault = Code.TIMED_OUT
        if fault is not None and (self._view.step == "busy" or self._view.is_pass):
            self._finish("error", fault)
        is_ready = self._view.step == "idle" and self._fault(now_ns) is None
        return replace(self._view, is_ready=is_ready, station=self._station(now_ns))

    def has_beat(self, now_ns: int) -> bool:
        """Tell whether the PLC lives; False where its watchdog stands still."""
        return self._watchdog_ns is None or (self._has_beaten and not self.is_silent(now_ns))

    def is_silent(self, now_ns: int) -> bool:
        """Tell whether a sign of life is overdue, also the first one."""
        return self._watchdog_ns is not None and now_ns - self._beat_ns > self._watchdog_ns

    def is_unread(self, now_ns: int) -> bool:
        """Tell whether a result is not acknowledged twice the time-out after its trigger."""
        return self._view.step == "done" and now_ns - self._trigger_ns > 2 * self._timeout_ns

    def trigger(self, trigger: Trigger, now_ns: int, part: str | None = None) -> Refusal | None:
        """Take it, or return why not. part: the one that must judge the answer; None for any."""
        refusal = check_trigger(trigger) or self._refusal(trigger.trigger_id, now_ns)
        if refusal is not None:
            return self.refuse(refusal)
        self._view = replace(
            self._view, step="busy", trigger_id=trigger.trigger_id, piece=trigger.piece, refused=Code.NONE
        )
        self._last_id, self._trigger_ns, self._part = trigger.trigger_id, now_ns, part
        self._is_reached, self._is_pressed, self._awaited = False, False, None
        return None

    def reach(self, trigger_id: int) -> None:
        """Every frame of before this trigger was looked at: the next press may answer it, by command the one that is
        held."""
        if trigger_id == self._view.trigger_id:
            self._is_reached, self._needs_free, self._is_pressed = True, self._is_touched, self._is_command

    def refuse(self, refusal: Refusal) -> Refusal:
        """Show why a trigger was refused, and return it."""
        self._view = replace(self._view, refused=refusal.code)
        return refusal

    def acknowledge(self, now_ns: int) -> None:
        """End the handshake. A press that was to answer it answers nothing any more."""
        self.read(now_ns)
        self._view = HandshakeView(
            refused=self._view.refused,
            gel_left_percent=self._view.gel_left_percent,
            station=self._view.station,
        )

    def beat(self, now_ns: int) -> None:
        """Take a sign of life of the PLC. What ended without one stays an error."""
        self.read(now_ns)
        self._beat_ns, self._has_beaten = now_ns, True

    def look(self, is_touched: bool) -> None:
        """Take whether a frame shows the gel touched."""
        self._is_touched = is_touched
        self._needs_free &= is_touched

    def begin(self, now_ns: int, frame_ns: int | None = None) -> None:
        """A press of a part begins. It answers a trigger that came while the gel was free.

        frame_ns: of the frame that shows it, which may have been held back until after the trigger; None for one
        without a time of its own.
        """
        if self.read(now_ns).step != "busy" or not self._is_reached or self._is_command:
            return
        if frame_ns is not None and frame_ns < self._trigger_ns:
            return
        if self._is_pressed:  # the one before has ended without a verdict
            self._finish("error", Code.NOT_JUDGED)
        elif not self._needs_free:
            self._is_pressed = True

    def find_asked(self, now_ns: int) -> tuple[int, str | None, str]:
        """Return the trigger that the press answers which is decided now, 0 for none, and what it names: the part that
        must judge the press, None for any; and the piece, empty for none."""
        is_answer = self.read(now_ns).step == "busy" and self._is_pressed and self._awaited is None
        return (self._view.trigger_id, self._part, self._view.piece) if is_answer else (0, None, "")

    def judge(
        self,
        press_id: str,
        word: str,
        now_ns: int,
        *,
        part: str,
        piece: str | None = None,
        score_ratio: float | None = None,
    ) -> bool:
        """A press of a part is judged. Return whether it is the answer. A pass is shown when it is recorded.

        piece: of several places, that the press counts for.
        """
        if self.read(now_ns).step != "busy" or not self._is_pressed or self._awaited is not None:
            return False
        if self._part not in (None, part):
            self._finish("error", Code.OTHER_PART)
            return False
        if piece is not None and self._view.piece not in ("", piece):
            self._finish("error", Code.PIECE)
            return False
        self._view = replace(self._view, press_id=press_id, score_ratio=score_ratio)
        if word in ("pass", "place"):
            self._awaited = (press_id, word)
        else:
            self._finish(word, Code.NOT_JUDGED if word == "error" else Code.NONE)
        return True

    def record(self, press_id: str, now_ns: int) -> None:
        """A press is in the database."""
        if self.read(now_ns).step == "busy" and self._awaited is not None and self._awaited[0] == press_id:
            self._finish(self._awaited[1], Code.NONE)

    def miss(self, code: Code, now_ns: int) -> None:
        """The station cannot answer a trigger that it has taken."""
        if self.read(now_ns).step == "busy" and self._awaited is None:
            self._finish("error", code)

    def show(self, station: StationView, gel_left_percent: int, now_ns: int) -> HandshakeView:
        """Take the state of the station, which is also the sign that its loop is alive; return what a PLC sees."""
        self._shown_ns = now_ns
        self._view = replace(self._view, station=station, gel_left_percent=gel_left_percent)
        return self.read(now_ns)

    def _finish(self, word: str, code: Code) -> None:
        self._view = replace(self._view, step="done", word=word, code=code)

    def _station(self, now_ns: int) -> StationView:
        """Return what is still so of what the loop said last."""
        station, silent_ns = self._view.station, now_ns - self._shown_ns
        if silent_ns > LOOP_S * 1e9 and station.state == "ready":
            station = replace(station, state="halted")
        return station.after(silent_ns)

    def _fault(self, now_ns: int) -> Code | None:
        """Return why no press is judged now, or no one would read it."""
        if self._station(now_ns).state != "ready":
            return Code.HALTED
        return None if self.has_beat(now_ns) else Code.NO_BEAT

    def _refusal(self, trigger_id: int, now_ns: int) -> Refusal | None:
        view = self.read(now_ns)
        if view.step == "busy":
            return Refusal(
                Code.BUSY,
                f"trigger {trigger_id} came while trigger {view.trigger_id} is busy; wait for done, or end it with "
                "acknowledge",
            )
        if view.step == "done":
            return Refusal(
                Code.NOT_ACKNOWLEDGED,
                f"trigger {trigger_id} came before the result of trigger {view.trigger_id} was acknowledged; "
                "acknowledge it first",
            )
        if trigger_id == self._last_id:
            return Refusal(
                Code.ID_TWICE,
                f"trigger {trigger_id} came twice; every trigger has an id of its own, also for the same piece",
            )
        match self._fault(now_ns):
            case None:
                return None
            case Code.NO_BEAT:
                return Refusal(
                    Code.NO_BEAT,
                    f"trigger {trigger_id} came while the PLC's watchdog stands still; change it all the time",
                )
            case _:
                return Refusal(
                    Code.NOT_READY,
                    f"trigger {trigger_id} came while the station is {view.station.state}, expected ready; wait for it",
                )
