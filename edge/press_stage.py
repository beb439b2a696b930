"""What a press goes through: each feature of a station is one stage, with the verbs that it brings.

Stages enter by the entry points `gelgate.features`, those of gelgate and those of other packages.
"""

import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, Protocol, Self, TypeVar

from pydantic import BaseModel

from edge.config import Config
from edge.core.contact.events import Event, PressSettled
from edge.core.contact.press_detector import Look
from edge.core.contact.reference import View
from edge.core.contact_state import ContactState
from edge.core.digital_io import StationView
from edge.core.imaging.frames import CameraFrame
from edge.core.part_position import PartPosition
from edge.core.ports import Clock, DeviceIdentity, Message
from edge.core.press import Press, PressLabel
from edge.core.sentence import Sentence
from edge.messaging.alarm_payload import Alarm
from edge.messaging.command_payloads import CommandArguments
from edge.messaging.result_payload import ResultPayload
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.store.acts import Act
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import PressRecord, PressTable, Store

__all__ = ["Alarms", "Command", "Data", "Mounted", "OwnTable", "PressStage", "Selection", "StageParts"]

A = TypeVar("A", bound=CommandArguments)
S = TypeVar("S", contravariant=True)

Data = Mapping[str, Any]
"""The data of a response, plain JSON."""


class Alarms(Protocol):
    """The alarms and the state of a station, for its stages. Any thread may use it."""

    def say(
        self, alarm: str, sentence: Sentence | None, severity: Literal["warning", "error"] = "error"
    ) -> None:
        """Raise an alarm for a person, or clear it with None. What is said already is not said again, and one that no
        one declares is not published."""

    def set_fault(self, alarm: str, text: Sentence | None) -> bool:
        """Raise it, and inspect nothing until it is cleared with None. Returns whether it is newly raised."""

    def set_blind(self, reason: Sentence | None) -> None:
        """Say why the sensor's frames show nothing; None while they do."""

    def set_unproven(self, sentence: Sentence | None) -> None:
        """Say why the bundle in use is not yet proven on the mounted gel; None where it is."""

    def show_contact(self, contact: ContactState) -> None:
        """Say what the contact is now."""

    def show_piece(self, piece_id: str | None) -> None:
        """Say which piece of several places is in progress; None where none is."""


class Selection(Protocol):
    """The bundles of a station, and the one in use."""

    @property
    def part(self) -> PartPosition:
        """The part and position inspected now."""

    @property
    def selected(self) -> PartPosition:
        """What is inspected now, or will be once nothing presses the gel."""

    @property
    def inspector(self) -> Inspector:
        """The bundle that judges presses now."""

    @property
    def is_waiting(self) -> bool:
        """Whether another bundle is selected and waits for the end of a press."""

    @property
    def path(self) -> Path:
        """Where the bundle in use was opened from."""

    @property
    def shadow(self) -> Inspector | None:
        """The bundle that is scored beside the one in use, and decides nothing."""

    @property
    def shadow_faults(self) -> tuple[str, ...]:
        """Why configured shadows are not scored, a sentence each."""

    @property
    def instead_of(self) -> str | None:
        """The id of the configured bundle whose place the one in use has taken; None for none."""

    def exchange(self, why: Act) -> None:
        """Inspect with the shadow from now on, and have the other for a shadow. Only while nothing is pressed. Errors:
        StoreError; then nothing has changed."""

    def reload(self) -> None:
        """Open the configured bundles again, while presses are judged as before."""

    def find_all(self, name: str) -> Set[PartPosition]:
        """Return all positions that this name, such as the code on a part, may mean."""

    def select(self, part: PartPosition, why: Act | None = None, *, is_pressed: bool) -> None:
        """Inspect this, unless something is pressed, from now on. Errors: StoreError; then nothing has changed."""


@dataclass(frozen=True)
class StageParts:
    """What stages are made from."""

    config: Config
    clock: Clock
    store: Store
    alarms: Alarms
    selection: Selection
    find_sensor: Callable[[], DeviceIdentity | None]
    """Returns the sensor; None while it is not known."""
    find_low_space: Callable[[], str | None]
    """Returns why nothing more may be written to the disk."""
    post: Callable[[Callable[[], None]], None]
    """Lets the loop call something between two frames; any thread may use it."""
    trigger: Callable[[], None]
    """Asks the loop to score the press that is held now; any thread may use it."""
    do: Callable[[str, Mapping[str, Any]], Data]
    """Does a request of another stage, by its verb and arguments; the loop alone calls it. Errors: GelgateError,
    ValueError."""
    announce: Callable[[Message], object]
    """Publishes what the station says of itself; a retained message is sent again on every connection. Any thread may
    use it."""
    listen: Callable[[Callable[[Message], object]], None]
    """Lets a stage hear what the station says of itself: state, alarms, stats. Any thread calls it then."""
    options: Any = None
    """Of the stage that is made, an instance of its `Options`; None where it has none."""


@dataclass(frozen=True)
class Command(Generic[S, A]):
    """One verb that a station serves."""

    verb: str
    arguments: type[A]
    """The model of its arguments."""
    do: Callable[[S, A], Data | Callable[[], Data]]
    """Called by the loop, with the stage. Returns the data of the response, or what makes them on the requester's
    thread while the loop goes on. Errors of both: GelgateError, ValueError."""
    help: str
    """What it does, for the manual."""
    changes: str = ""
    """What it changes for good, for the manual; empty for nothing."""


class OwnTable(PressTable, Protocol):
    """Where presses of one label are kept, and what is published of them."""

    @property
    def has_picture(self) -> bool:
        """Whether the picture of such a press is published."""

    def publish(self, result: ResultPayload, sequence: int) -> tuple[Sequence[Message], Sequence[str]]:
        """Return the messages of the press that was inserted, and sentences for the person at the station."""


@dataclass(frozen=True)
class Mounted:
    """What a press would be made with now."""

    serial: str
    gel_id: str
    part: PartPosition
    bundle_id: str
    has_contact: bool
    """Whether something presses the gel."""


class PressStage:
    """One concern of a press. Each method does nothing here: a stage has those that it needs. The loop alone calls it.

    The calls of a press come in this order: `begin`, `expect` for each frame that is scored ahead, `admit`, the score,
    `judge`, `keep`, `fields` and `table`, `write`, `record`. The others are about what is mounted, what is seen, and
    time.
    """

    commands: ClassVar[Sequence[Command[Any, Any]]] = ()
    """The verbs that it serves."""

    alarms: ClassVar[Mapping[str, Alarm]] = {}
    """The alarms that a feature of another package raises, by id; gelgate's own are in `alarm_payload.ALARMS`."""

    words: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    """What the page says of a feature of another package in other languages: language to English to its text. English
    is the title of an alarm, what to do, and each `Sentence` with its values in braces: `{shift} has its parts`."""

    foreign_name: str | None = None
    """The name of a feature of another package, set after `open`; None of gelgate's own."""

    Options: ClassVar[type[BaseModel] | None] = None
    """What the table `[feature.NAME]` of a feature of another package may have; None for no such table."""

    is_awaited: ClassVar[bool] = False
    """Whether a person or a machine waits for what it shows: it takes a recorded press, and closes, before the others.
    """

    @classmethod
    def open(cls, parts: StageParts) -> Self | None:
        """Make the stage of a station; None where it is not configured. Errors: ConfigError."""
        return cls()

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        """Yield what the check before a start tries: the name of a part, and what says how it was found. Errors of
        the latter: GelgateError."""
        yield from ()

    def start(self) -> None:
        """Begin to work in the background."""

    def close(self) -> None:
        """End it; may be called again, and without `start`."""

    def take(self, frame: CameraFrame) -> None:
        """Take a frame of the sensor as it arrives."""

    def mount(self, gel: GelRecord) -> None:
        """Take the gel that is pressed from now on."""

    def use(self, inspector: Inspector) -> None:
        """Take the bundle that judges from now on."""

    def see(self, event: Event) -> None:
        """Take a contact event."""

    def look(self, look: Look) -> None:
        """Take what a frame shows, after its events."""

    def learn(self, first: View | None) -> None:
        """Take the first picture of this gel, float32 (h, w, 3): the free gel was just learnt, or followed."""

    def relearn(self) -> None:
        """Forget what was seen of the free gel: it is learnt again."""

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        """Return what the press that begins is for, None for a part; `label` is the word of the stages before."""
        return label

    def expect(self, frame: CameraFrame, examined: Press) -> None:
        """Take the frame that the present press will most likely be judged by, and what it shows: what takes long may
        be done now."""

    def admit(self, press: Press) -> Press:
        """Return the press before its score, rejected where it may not be judged."""
        return press

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Return the press after its score. settled: None for one that gave no frame."""
        return press

    def keep(self, press: Press, inspector: Inspector) -> Press:
        """Return the judged press with what is kept of it. It is the last call that has its frame and maps."""
        return press

    def draw_again(self, press: Press, bundle: Bundle) -> Press:
        """Return a press of the archive, whose picture was not drawn, with what its picture shows besides."""
        return press

    def fields(self, press: Press) -> Mapping[str, Any]:
        """Return what this stage has to say in the press's result: fields of `ResultPayload`; those of a feature of
        another package, plain JSON, stand under its name in the field `feature`."""
        return {}

    def table(self, press: Press, row: PressRecord) -> OwnTable | None:
        """Return the table of this press; None for the history of parts."""
        return None

    def write(self, connection: sqlite3.Connection, press: Press) -> None:
        """Write what the press of a part means beyond itself, inside the transaction that records it: quick, and only
        what is undone with it."""

    def record(self, press: Press, gel: GelRecord) -> None:
        """Take a press that is in the database, with its gel, this press counted. Errors: StoreError."""

    def acknowledge(self, alarm: str) -> None:
        """Take it that a person has seen an alarm that stays until then."""

    def show(self, view: StationView) -> None:
        """Take the state of the station, at the end of every turn of the loop."""

    def turn(self, mounted: Mounted | None) -> None:
        """Take one turn of a loop whose store does not refuse; None before the sensor is known. Errors: StoreError."""
