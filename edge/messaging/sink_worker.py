"""The work of one sink, one step at a time and without a thread: state, rows in order, refusals, pauses.

Each row that a sink refused is offered again in its turn, for permissions and limits may be corrected.
"""

import json
import logging
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from edge.core.backoff import Backoff
from edge.core.errors import SinkError, SinkRejected, SinkUnavailable, StoreError
from edge.core.ports import Clock, Message, Sink
from edge.logs import about_press
from edge.messaging.alarm_payload import alarm_cleared, list_alarms
from edge.messaging.payload_base import as_replayed
from edge.store.outbox import Outbox, OutboxRow

__all__ = ["IDLE_S", "OFFER_REFUSED_S", "RetainedState", "SinkCounters", "SinkWorker"]

# Refused rows are offered again this often, this number of them at a time. When one is accepted, all rows of its kind
# are offered at once.
OFFER_REFUSED_S: Final = 45.0
OFFERED_ROWS: Final = 16

# A row that causes an unexpected error this often in a row is set aside: it may be damaged, and others wait behind it.
BROKEN_ATTEMPTS: Final = 3


# What has waited for an acknowledgement that took longer is late: its receiver was silent, or slow.
LATE_S: Final = 2.0


class RefusedRows:
    """What one sink has refused, or cannot send. Its worker calls it, in one thread."""

    def __init__(self, sink: str, outbox: Outbox, clock: Clock) -> None:
        self._sink, self._outbox, self._clock = sink, outbox, clock
        self._offered_ns: int | None = None
        self._offered_up_to = 0  # the last row of the last offer; the next offer begins after it
        self._offered: set[int] = set()  # rows that were refused once and are in the queue again
        self._accepts_again: set[str] = set()  # kinds of message of which a refused one was accepted
        self._broken = (0, 0)  # the row of the last unexpected error, and the number of its errors
        self._was_broken: set[int] = set()  # rows that were set aside for such errors

    @property
    def is_urgent(self) -> bool:
        """True where a kind of message is accepted again: its rows are offered with the next call."""
        return bool(self._accepts_again)

    def offer(self) -> int | None:
        """Queue the rows again that are due; returns the first of them, None for none. Errors: StoreError."""
        rows: list[int] = []
        for kind in self._accepts_again:
            rows += self._note(self._outbox.offer_refused(self._sink, kind=kind))
        self._accepts_again.clear()
        now_ns = self._clock.monotonic_ns()
        if self._offered_ns is None or now_ns - self._offered_ns >= OFFER_REFUSED_S * 1e9:
            # One of each kind first: many of one kind that is refused for ever do not keep back the others.
            firsts = self._outbox.offer_first_of_kinds(self._sink)
            more = max(1, OFFERED_ROWS - len(firsts))
            again = self._outbox.offer_refused(self._sink, more, after=self._offered_up_to)
            self._offered_up_to = again[-1] if len(again) == more else 0
            self._offered_ns = now_ns
            rows += self._note([*firsts, *again])
        return min(rows, default=None)

    def set_aside(self, row: OutboxRow, why: str) -> None:
        """Keep a row that is not sent until it is offered again. Errors: StoreError."""
        self._outbox.refuse(row.row_id, self._sink, why)
        self._offered.discard(row.row_id)

    def is_offered(self, row: OutboxRow) -> bool:
        """Tell whether it was refused before."""
        return row.row_id in self._offered

    def accept(self, row: OutboxRow) -> None:
        """Take a row that the sink has accepted."""
        if row.row_id in self._offered:
            self._offered.discard(row.row_id)
            self._accepts_again.add(kind_of(row.message))

    def is_damaged(self, row: OutboxRow) -> bool:
        """Count an unexpected error on this row, and say whether it is to be set aside."""
        number = self._broken[1] + 1 if self._broken[0] == row.row_id else 1
        self._broken = (row.row_id, number)
        if number < BROKEN_ATTEMPTS and row.row_id not in self._was_broken:
            return False
        self._was_broken.add(row.row_id)
        return True

    def _note(self, rows: Sequence[int]) -> Sequence[int]:
        self._offered.update(rows)
        return rows


def kind_of(message: Message) -> str:
    """Return the first level of a topic: messages of one kind are allowed or forbidden together."""
    return message.topic.partition("/")[0]


class RetainedState:
    """The current state, info, alarms and stats: the latest message per topic. Any thread may use it.

    They are sent again on every connection and bypass the outbox: an old state is useless, a late one would be wrong.
    At first every known alarm is cleared, so that an alarm retained from a killed process does not stay.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[int, Message]] = {}
        self._version = 0
        self._rows: dict[str, int] = {}
        for alarm in list_alarms():
            self.announce(alarm_cleared(alarm))

    def announce(self, message: Message) -> bool:
        """Set the message of its topic; returns whether it is a change."""
        with self._lock:
            known = self._latest.get(message.topic)
            if known is not None and known[1] == message:
                return False
            self._version += 1
            self._latest[message.topic] = (self._version, message)
            return True

    def remember(self, message: Message, row_id: int) -> None:
        """A retained message from the outbox was delivered: from now on it is sent again on every connection.

        This corrects a broker that restarts without its retained messages, or with an older one. Sinks are at
        different rows; an older row never replaces a newer one.
        """
        with self._lock:
            if row_id > self._rows.get(message.topic, 0):
                self._rows[message.topic] = row_id
                version = self._latest.get(message.topic, (0, message))[0]
                self._latest[message.topic] = (version, message)

    def doubt(self, topic: str, row_id: int) -> None:
        """A message of the outbox is being sent: until it is delivered a new connection hears no older one.

        The receiver may have it although its acknowledgement is lost, and its topic would go back.
        """
        with self._lock:
            if row_id > self._rows.get(topic, 0):
                self._latest.pop(topic, None)

    def all(self) -> Sequence[Message]:
        """The first messages of a new connection: the retained ones, oldest change first."""
        return [message for _, message in self.since(-1) if message.retain]

    def since(self, version: int) -> list[tuple[int, Message]]:
        """The changes after that version, oldest first, each with its own version."""
        with self._lock:
            return sorted(
                (entry for entry in self._latest.values() if entry[0] > version), key=lambda entry: entry[0]
            )


log = logging.getLogger(__name__)

# Rows in memory at a time: enough to keep a broker busy, and sixteen heatmaps fit in any gateway.
BATCH_ROWS: Final = 16

# An idle worker checks the outbox this often: other processes (`gelgate gel replace`) cannot wake it.
IDLE_S: Final = 5.0


@dataclass(frozen=True)
class SinkCounters:
    """What one sink did so far."""

    sent: int = 0
    """Acknowledged rows."""
    failed: int = 0
    """Attempts that ended in an error."""
    refused: int = 0
    is_up: bool = False
    """The last attempt succeeded."""
    last_error: str = ""
    """The sentence of the last error, or empty."""
    last_refusal: str = ""
    """The sentence of the last refusal, or empty."""
    faults: tuple[str, ...] = ()
    """What the sink itself reports."""
    level: str | None = None
    """The level of its protocol, if it has several."""


class SinkWorker:
    """Sends the outbox to one sink. `step` does one batch and returns how long to wait before the next."""

    def __init__(
        self,
        name: str,
        sink: Sink,
        outbox: Outbox,
        retained_state: RetainedState,
        clock: Clock,
        backoff: Backoff,
    ) -> None:
        self.name = name
        self.counters = SinkCounters()
        self._sink = sink
        self._outbox = outbox
        self._retained_state = retained_state
        self._backoff = backoff
        self._has_said = False  # whether the log has a line on this sink
        self._sent_version = 0  # version of the retained state that this sink has
        self._unsaid: set[str] = set()  # topics of the retained state that this sink has refused
        self._unsaid_ns = 0  # when they were said again, or the first of them was refused
        self._clock = clock
        self._passed = 0  # every row up to this one is settled with this sink
        self._accepted: list[int] = []  # rows that the sink accepted; the store does not know it yet
        self._is_store_failing = False
        # Rows up to this one waited for the sink, or for this process to start: they are late when they are sent.
        self._late_up_to = outbox.newest()
        self._was_slow = False  # an acknowledgement took so long that the rows of now are late
        self._refused = RefusedRows(name, outbox, clock)
        self._refuses: set[str] = set()  # kinds that are refused now; each is logged once

    def step(self) -> float:
        """Send changed state and at most one batch of rows; returns seconds until the next step, 0 for at once.

        Never raises a SinkError or a StoreError: both are counted and retried. A SinkError is logged once.
        A batch is acknowledged in one transaction: most of the cost is that of a commit. While the store refuses it,
        nothing that the sink has accepted is sent again, and no row after it is sent.
        """
        has_failed = self._backoff.failures > 0
        try:
            self._say()  # first: the current state needs no store
            self._acknowledge()
            if has_failed:
                self._late_up_to = self._outbox.newest()
            if (first := self._refused.offer()) is not None:
                self._passed = min(self._passed, first - 1)
            rows = self._outbox.pending(self.name, BATCH_ROWS, after=self._passed)
            try:
                for row in rows:
                    self._say()  # `stopped` waits for no picture: the end of a station leaves it two seconds
                    with about_press(_press_id(row.message)):
                        self._send(row)
                    self._passed = row.row_id
            finally:
                self._acknowledge()
        except SinkError as error:
            return self._note_failure(error)
        except StoreError as error:
            return self._note_unstored(error)
        return 0.0 if len(rows) == BATCH_ROWS or self._refused.is_urgent else IDLE_S

    def count_exception(self) -> float:
        """Count an unexpected exception of `step`; returns the seconds to wait, as for any failure."""
        return self._note_failure(SinkUnavailable(f"sink {self.name} is broken; its traceback is in the log"))

    def _say(self) -> None:
        """Say what has changed, and again what was refused: else the receiver retains what is not so any more."""
        now_ns = self._clock.monotonic_ns()
        if not self._unsaid:
            self._unsaid_ns = now_ns
        again = set(self._unsaid) if now_ns - self._unsaid_ns >= OFFER_REFUSED_S * 1e9 else set()
        for version, message in self._retained_state.since(-1 if again else self._sent_version):
            if version <= self._sent_version and message.topic not in again:
                continue
            try:
                self._deliver(message)
                self._unsaid.discard(message.topic)
            except SinkRejected as error:
                self._unsaid.add(message.topic)
                self._note_refused(message, str(error))
            self._sent_version = max(version, self._sent_version)
        if again:
            self._unsaid_ns = now_ns

    def _send(self, row: OutboxRow) -> None:
        if self._was_slow:
            self._late_up_to, self._was_slow = self._outbox.newest(), False
        if row.message.retain:
            self._retained_state.doubt(row.message.topic, row.row_id)
        try:
            is_late = row.row_id <= self._late_up_to or self._refused.is_offered(row)
            self._deliver(as_replayed(row.message) if is_late else row.message)
        except SinkRejected as error:
            self._set_aside(row, str(error))
            return
        except (SinkError, StoreError):
            raise
        except Exception as error:
            if not self._refused.is_damaged(row):
                raise
            self._set_aside(row, f"it cannot be sent ({type(error).__name__}: {error}); it may be damaged")
            return
        self._accepted.append(row.row_id)
        if row.message.retain:
            self._retained_state.remember(row.message, row.row_id)
        self._refuses.discard(kind_of(row.message))
        self._refused.accept(row)

    def _acknowledge(self) -> None:
        """Acknowledge what the sink has accepted. Errors: StoreError; then it waits for the next step."""
        if not self._accepted:
            return
        self._outbox.acknowledge(self._accepted, self.name)
        self.counters = replace(self.counters, sent=self.counters.sent + len(self._accepted))
        self._accepted.clear()
        self._note_stored()

    def _set_aside(self, row: OutboxRow, why: str) -> None:
        self._refused.set_aside(row, why)
        self._note_refused(row.message, why)

    def _deliver(self, message: Message) -> None:
        began_ns = self._clock.monotonic_ns()
        self._sink.send(message)
        log.debug("sink %s has taken %s", self.name, message.topic)
        self._was_slow |= self._clock.monotonic_ns() - began_ns > LATE_S * 1e9
        self._backoff.succeeded()
        if not self.counters.is_up:
            self.counters = replace(self.counters, is_up=True, last_error="")
            self._log_change(True, f"sink {self.name} accepts messages")

    def _note_stored(self) -> None:
        self._backoff.succeeded()
        if self._is_store_failing:
            self._is_store_failing = False
            log.info("the acknowledgements of sink %s are stored again", self.name)

    def _note_unstored(self, error: StoreError) -> float:
        """Count a failure of the database, not of the sink: the current state is still sent. Logged once."""
        self.counters = replace(self.counters, failed=self.counters.failed + 1, last_error=str(error))
        if not self._is_store_failing:
            self._is_store_failing = True
            log.error("the acknowledgements of sink %s cannot be stored: %s", self.name, error)
        return self._backoff.failed()

    def _note_failure(self, error: SinkError) -> float:
        is_news = self.counters.is_up or not self._has_said
        self.counters = replace(
            self.counters, is_up=False, failed=self.counters.failed + 1, last_error=str(error)
        )
        if is_news:
            self._log_change(False, str(error))
        return self._backoff.failed()

    def _note_refused(self, message: Message, why: str) -> None:
        self.counters = replace(self.counters, refused=self.counters.refused + 1, last_refusal=why)
        if kind_of(message) not in self._refuses:
            log.warning("sink %s refused a message on %s: %s", self.name, message.topic, why)
        self._refuses.add(kind_of(message))

    def _log_change(self, is_up: bool, sentence: str) -> None:
        self._has_said = True
        log.log(logging.INFO if is_up else logging.WARNING, "%s", sentence)


def _press_id(message: Message) -> str | None:
    """The press that a message is about, for the log."""
    kind, _, name = message.topic.partition("/")
    if kind in ("heatmap", "scoremap", "deviations"):
        return name
    if kind not in ("result", "last"):
        return None
    try:
        press_id = json.loads(message.payload).get("press_id")
    except (ValueError, AttributeError):  # a picture, or a damaged row
        return None
    return press_id if isinstance(press_id, str) else None
