"""The publisher: one thread per sink that sends the outbox in order, and never gives up.

A `SinkWorker` does the work of one sink, one step at a time and without a thread; `Publisher` gives each worker its
thread. A sink that is away does not delay the others: a row leaves the outbox when every sink acknowledged it.
"""

import fcntl
import logging
import os
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from edge.core.backoff import Backoff
from edge.core.errors import SinkError, SinkRejected, SinkUnavailable, StoreError
from edge.core.ports import Clock, Message, Sink
from edge.messaging.payloads import as_replayed
from edge.messaging.retained_state import RetainedState
from edge.store.outbox import Outbox, OutboxRow, OutboxStatus

__all__ = ["OnChange", "Publisher", "PublisherLock", "SinkCounters", "SinkWorker"]

log = logging.getLogger(__name__)

# Rows in memory at a time: enough to keep a broker busy, and sixteen heatmaps fit in any gateway.
BATCH_ROWS: Final = 16

# An idle worker checks the outbox this often: other processes (`gelgate gel replace`) cannot wake it.
IDLE_S: Final = 5.0

# The pauses are short: an attempt on a sink that is away costs nothing, because the sink itself connects.
BACKOFF_FIRST_S: Final = 0.1
BACKOFF_CEILING_S: Final = 5.0

# Refused rows are offered again this often: permissions may be corrected, size limits raised.
OFFER_REFUSED_S: Final = 3600.0

# A sink's last send and its `close` return within this time; shipped sinks need less than a second.
CLOSE_S: Final = 5.0

OnChange = Callable[[str, bool, str], None]
"""(sink name, whether it accepts messages now, one sentence). Called on changes only, from the worker's thread."""


@dataclass(frozen=True)
class SinkCounters:
    """sent: acknowledged rows. replayed: those of them marked as late. failed: attempts that ended in an error.
    refused: rows that the sink refuses. is_up: the last attempt succeeded. last_error: its sentence, or empty."""

    sent: int = 0
    replayed: int = 0
    failed: int = 0
    refused: int = 0
    is_up: bool = False
    last_error: str = ""


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
        on_change: OnChange,
    ) -> None:
        self.name = name
        self.counters = SinkCounters()
        self._sink = sink
        self._outbox = outbox
        self._retained_state = retained_state
        self._clock = clock
        self._backoff = backoff
        self._on_change = on_change
        self._has_changed = False  # whether `on_change` was ever called
        self._sent_version = 0  # version of the retained state that this sink has
        self._passed = 0  # every row up to this one is settled with this sink
        self._accepted: int | None = (
            None  # the last row that the sink accepted; the store may not know it yet
        )
        self._is_store_failing = False
        # Rows up to this one waited for the sink, or for this process to start: they are late when they are sent.
        self._late_up_to = outbox.newest()
        self._offered_ns: int | None = None

    def step(self) -> float:
        """Send changed state and at most one batch of rows; returns seconds until the next step, 0 for at once.

        Never raises a SinkError or a StoreError: both are counted and retried. A SinkError is reported by `on_change`.
        While the store refuses, a row that the sink has accepted is not sent again, only acknowledged again.
        """
        has_failed = self._backoff.failures > 0
        try:
            self._say()  # first: the current state needs no store
            if has_failed:
                self._late_up_to = self._outbox.newest()
            self._offer_refused()
            rows = self._outbox.pending(self.name, BATCH_ROWS, after=self._passed)
            for row in rows:
                self._send(row)
                self._passed = row.row_id
        except SinkError as error:
            return self._failed(error)
        except StoreError as error:
            return self._unrecorded(error)
        return 0.0 if len(rows) == BATCH_ROWS else IDLE_S

    def broken(self) -> float:
        """Count an unexpected exception of `step`; returns the seconds to wait, as for any failure."""
        return self._failed(SinkUnavailable(f"sink {self.name} is broken; its traceback is in the log"))

    def _offer_refused(self) -> None:
        now_ns = self._clock.monotonic_ns()
        if self._offered_ns is None or now_ns - self._offered_ns >= OFFER_REFUSED_S * 1e9:
            if self._outbox.offer_refused(self.name):
                self._passed = 0
            self._offered_ns = now_ns

    def _say(self) -> None:
        for version, message in self._retained_state.since(self._sent_version):
            try:
                self._deliver(message)
            except SinkRejected as error:  # nothing to keep: the next change of that topic replaces it
                self._refused(message.topic, error)
            self._sent_version = version

    def _send(self, row: OutboxRow) -> None:
        is_late = row.row_id <= self._late_up_to
        message = as_replayed(row.message) if is_late else row.message
        # An accepted row waits only for its acknowledgement: a full disk is no reason to send it again.
        if row.row_id != self._accepted:
            try:
                self._deliver(message)
            except SinkRejected as error:
                self._outbox.refuse(row.row_id, self.name, str(error))
                self._refused(row.message.topic, error)
                return
            self._accepted = row.row_id
        if message.retain:
            self._retained_state.remember(message, row.row_id)
        self._outbox.acknowledge(row.row_id, self.name)
        self._recorded()
        self.counters = replace(
            self.counters,
            sent=self.counters.sent + 1,
            replayed=self.counters.replayed + int(is_late),
        )

    def _deliver(self, message: Message) -> None:
        self._sink.send(message)
        self._backoff.succeeded()
        if not self.counters.is_up:
            self.counters = replace(self.counters, is_up=True, last_error="")
            self._change(True, f"sink {self.name} accepts messages")

    def _recorded(self) -> None:
        self._backoff.succeeded()
        if self._is_store_failing:
            self._is_store_failing = False
            log.info("the acknowledgements of sink %s are stored again", self.name)

    def _unrecorded(self, error: StoreError) -> float:
        """The database refused, not the sink, so the current state is still sent. Logged once."""
        self.counters = replace(self.counters, failed=self.counters.failed + 1, last_error=str(error))
        if not self._is_store_failing:
            self._is_store_failing = True
            log.error("the acknowledgements of sink %s cannot be stored: %s", self.name, error)
        return self._backoff.failed()

    def _failed(self, error: SinkError) -> float:
        is_news = self.counters.is_up or not self._has_changed
        self.counters = replace(
            self.counters, is_up=False, failed=self.counters.failed + 1, last_error=str(error)
        )
        if is_news:
            self._change(False, str(error))
        return self._backoff.failed()

    def _refused(self, topic: str, error: SinkRejected) -> None:
        self.counters = replace(self.counters, refused=self.counters.refused + 1, last_error=str(error))
        log.warning("sink %s refused a message for %s: %s", self.name, topic, error)

    def _change(self, is_up: bool, sentence: str) -> None:
        self._has_changed = True
        log.log(logging.INFO if is_up else logging.WARNING, "%s", sentence)
        self._on_change(self.name, is_up, sentence)


class Publisher:
    """All workers over one database, each in its own thread.

    database: the store's file. sinks: name to sink, already open; the publisher closes them. on_change: see OnChange.
    lock: that of the database, if it was taken before the sinks were opened; the publisher releases it.
    Errors: StoreError if another process publishes from this database: two would mix the order.
    """

    def __init__(
        self,
        database: Path,
        sinks: Mapping[str, Sink],
        retained_state: RetainedState,
        clock: Clock,
        rng: random.Random,
        on_change: OnChange = lambda name, is_up, sentence: None,
        lock: "PublisherLock | None" = None,
    ) -> None:
        self._lock = lock or PublisherLock(database)
        self._sinks = dict(sinks)
        self._retained_state = retained_state
        self._outbox = Outbox(database)
        self._outbox.register(self._sinks)
        self._stopping = threading.Event()
        self._wakes = {name: threading.Event() for name in self._sinks}
        self._workers = {
            name: SinkWorker(
                name,
                sink,
                self._outbox,
                retained_state,
                clock,
                Backoff(rng, BACKOFF_FIRST_S, BACKOFF_CEILING_S),
                on_change,
            )
            for name, sink in self._sinks.items()
        }
        self._threads = [
            threading.Thread(target=self._run, args=(worker,), name=f"publish-{name}", daemon=True)
            for name, worker in self._workers.items()
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def wake(self) -> None:
        """There is something new in the outbox. A worker that waits after a failure keeps waiting."""
        for wake in self._wakes.values():
            wake.set()

    def announce(self, message: Message) -> None:
        """Publish the current state, info, alarm or stats. It is sent again on every connection until it changes."""
        if self._retained_state.announce(message):
            self.wake()

    def counters(self) -> Mapping[str, SinkCounters]:
        return {name: worker.counters for name, worker in self._workers.items()}

    def outbox_status(self) -> OutboxStatus:
        return self._outbox.status()

    def stop(self, drain_s: float = 2.0) -> None:
        """Send as much as possible in that time, then close the sinks; the rest stays in the outbox.

        May be called again.
        """
        self._stopping.set()
        self.wake()
        _join(self._started(), drain_s)
        # A send that still waits ends with SinkUnavailable when its sink is closed. Each is closed in its own thread:
        # one that never returns must not keep the others open.
        closers = [
            threading.Thread(target=self._close, args=(name,), name=f"close-{name}", daemon=True)
            for name in self._sinks
        ]
        for closer in closers:
            closer.start()
        _join([*closers, *self._started()], CLOSE_S)
        stuck = [thread.name for thread in (*closers, *self._started()) if thread.is_alive()]
        if stuck:
            # They keep the lock until the process ends: another publisher would mix the order.
            log.error(
                "%s did not return within %g s, a fault in the plugin; its unsent messages stay in the outbox",
                ", ".join(stuck),
                CLOSE_S,
            )
            return
        self._outbox.close()
        self._lock.close()

    def _close(self, name: str) -> None:
        try:
            self._sinks[name].close()
        except Exception:
            log.exception("sink %s: a fault in its plugin while it was closed", name)

    def _started(self) -> list[threading.Thread]:
        return [thread for thread in self._threads if thread.ident is not None]

    def _run(self, worker: SinkWorker) -> None:
        while True:
            self._wakes[worker.name].clear()
            is_last = self._stopping.is_set()  # only a step that starts after `stop` has seen all messages
            try:
                pause_s = worker.step()
            except Exception:
                log.exception("sink %s: a fault in its plugin", worker.name)
                pause_s = worker.broken()
            if is_last and pause_s > 0:
                return
            if worker.counters.is_up:
                self._wakes[worker.name].wait(pause_s)
            else:
                self._stopping.wait(pause_s)


def _join(threads: Sequence[threading.Thread], seconds: float) -> None:
    """Wait for all of them, together at most this long."""
    deadline = time.monotonic() + seconds
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))


class PublisherLock:
    """The right to publish from a database, held by one process at a time and lost with it.

    Errors: StoreError if another process has it.
    """

    def __init__(self, database: Path) -> None:
        path = database.with_name(database.name + ".publisher")
        try:
            self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise StoreError(
                f"the lock {path} cannot be made: {error.strerror}; give the gateway's user the right"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.close()
            raise StoreError(
                f"another gelgate process publishes from database {database}; end it, or name another database"
            ) from error

    def close(self) -> None:
        """Release it. May be called again."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)
