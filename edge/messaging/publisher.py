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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from edge.core.backoff import Backoff
from edge.core.errors import StoreError
from edge.core.ports import Clock, Message, ReportsFaults, Sink
from edge.core.printable import write_count
from edge.messaging.sink_worker import RetainedState, SinkCounters, SinkWorker
from edge.store.outbox import Outbox, OutboxStatus

__all__ = ["Publisher", "PublisherLock"]


class PublisherLock:
    """Held by one process at a time and lost with it. database: its file, made already.

    A database in use whose name differs by its ending alone, as left.db and left.sqlite, is refused: archive,
    references and snapshots would be those of both. A symbolic link is followed, so both names have one lock. A second
    hard link is refused: the database's journal has the name of the file, so two names of one file have two journals,
    and SQLite would damage it.
    Ref: https://www.sqlite.org/howtocorrupt.html, 2.2.
    Errors: StoreError if another process has the lock, or the file has another name.
    """

    def __init__(self, database: Path) -> None:
        _refuse_second_name(database)
        real = database.resolve()
        path = real.with_name(real.name + ".publisher")
        try:
            self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
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
        for other in real.parent.glob("*.publisher"):
            if other != path and Path(other.stem).stem == real.stem and _is_held(other):
                self.close()
                raise StoreError(
                    f"database {other.stem} in the same folder is in use, and {database.name} would have the same "
                    "archive and references; give it a name that differs by more than its ending"
                )

    def close(self) -> None:
        """Release it. May be called again."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)


def _is_held(lock: Path) -> bool:
    try:
        with lock.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # of another user: it is not known
        pass
    return False


def _refuse_second_name(database: Path) -> None:
    try:
        names = database.stat().st_nlink
    except FileNotFoundError:
        return
    if names > 1:
        raise StoreError(
            f"database {database} has {names} names (hard links), and each would have its own journal; "
            "remove the others, or use a copy"
        )


log = logging.getLogger(__name__)

# A sink's last send and its `close` return within this time; shipped sinks need less than a second.
CLOSE_S: Final = 5.0

# The pauses are short: an attempt on a sink that is away costs nothing, because the sink itself connects. It then says
# the state of that moment, and a halt that follows must not wait long for the next attempt.
BACKOFF_FIRST_S: Final = 0.1
BACKOFF_CEILING_S: Final = 0.5


class Publisher:
    """All workers over one database, each in its own thread.

    database: the store's file. sinks: name to sink, already open; the publisher closes them.
    lock: that of the database, if it was taken before the sinks were opened; the publisher releases it. before: see
    `Outbox.register`.
    Errors: StoreError if another process publishes from this database: two would mix the order.
    """

    def __init__(
        self,
        database: Path,
        sinks: Mapping[str, Sink],
        retained_state: RetainedState,
        clock: Clock,
        rng: random.Random,
        lock: PublisherLock | None = None,
        before: Mapping[str, str] | None = None,
    ) -> None:
        self._lock = lock or PublisherLock(database)
        self._sinks = dict(sinks)
        self.retained_state = retained_state
        self._outbox = Outbox(database)
        try:
            self._outbox.register(self._sinks, before)
        except BaseException:
            self._outbox.close()
            raise
        self._stopping = threading.Event()
        self._wakes = {name: threading.Event() for name in self._sinks}
        self.workers = {
            name: SinkWorker(
                name,
                sink,
                self._outbox,
                retained_state,
                clock,
                Backoff(rng, BACKOFF_FIRST_S, BACKOFF_CEILING_S),
            )
            for name, sink in self._sinks.items()
        }
        self._threads = [
            threading.Thread(target=self._run, args=(worker,), name=f"publish-{name}", daemon=True)
            for name, worker in self.workers.items()
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
        if self.retained_state.announce(message):
            self.wake()

    def counters(self) -> Mapping[str, SinkCounters]:
        """Give the counters of every sink, with the faults that it reports now."""
        counters = {}
        for name, worker in self.workers.items():
            sink = self._sinks[name]
            faults = tuple(sink.faults) if isinstance(sink, ReportsFaults) else ()
            counters[name] = replace(worker.counters, faults=faults, level=getattr(sink, "level", None))
        return counters

    def outbox_status(self) -> OutboxStatus:
        return self._outbox.status()

    def acknowledge_drops(self, status: OutboxStatus) -> None:
        """A person has seen the drops that this status has. Errors: StoreError."""
        self._outbox.acknowledge_drops(status)

    def stop(self, drain_s: float = 2.0) -> None:
        """Send as much as possible in that time, then close the sinks; the rest stays in the outbox.

        May be called again.
        """
        self._stopping.set()
        self.wake()
        _join(self._started_threads(), drain_s)
        # A send that still waits ends with SinkUnavailable when its sink is closed. Each is closed in its own thread:
        # one that never returns must not keep the others open.
        closers = [
            threading.Thread(target=self._close, args=(name,), name=f"close-{name}", daemon=True)
            for name in self._sinks
        ]
        for closer in closers:
            closer.start()
        _join([*closers, *self._started_threads()], CLOSE_S)
        stuck = [thread.name for thread in (*closers, *self._started_threads()) if thread.is_alive()]
        if stuck:
            # They keep the lock until the process ends: another publisher would mix the order.
            log.error(
                "%s did not return within %g s, a fault in the plugin; its unsent messages stay in the outbox",
                ", ".join(stuck),
                CLOSE_S,
            )
            return
        with suppress(StoreError):  # closed before, or a disk that fails
            if self._sinks and (rows := self._outbox.status().rows):
                log.info("%s in the outbox: sent when the gateway runs again", write_count(rows, "message"))
        self._outbox.close()
        self._lock.close()

    def _close(self, name: str) -> None:
        try:
            self._sinks[name].close()
        except Exception:
            log.exception("sink %s: a fault in its plugin while it was closed", name)

    def _started_threads(self) -> list[threading.Thread]:
        return [thread for thread in self._threads if thread.ident is not None]

    def _run(self, worker: SinkWorker) -> None:
        while True:
            self._wakes[worker.name].clear()
            is_last = self._stopping.is_set()  # only a step that starts after `stop` has seen all messages
            try:
                pause_s = worker.step()
            except Exception:
                log.exception("sink %s: a fault in its plugin", worker.name)
                pause_s = worker.count_exception()
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
