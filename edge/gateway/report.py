"""What a station counts and reports regularly: frames and presses, overload, room on the disk, steps of the clock.

Frames that are not processed in time are dropped, and a press in them is missed. This must raise an alarm.
"""

import logging
import shutil
import sqlite3
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from edge.acquisition import Acquisition, AcquisitionStatus
from edge.core.errors import StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.quality import MAX_AGE_S, Reason
from edge.core.ports import Clock
from edge.core.sentence import Sentence, join_sentences
from edge.gateway.inspection_session import InspectionSession
from edge.gateway.recorder import PressReport
from edge.gateway.status import StationStatus
from edge.messaging.publisher import Publisher
from edge.messaging.sink_worker import SinkCounters
from edge.messaging.status_payloads import StatsPayload
from edge.store.acts import Act
from edge.store.outbox import OutboxStatus
from edge.store.pieces import count_ended
from edge.store.press_store import Store

__all__ = [
    "ClockGuard",
    "FrameCounts",
    "FreeSpace",
    "OverloadRule",
    "Report",
    "Summary",
    "free_bytes",
]

log = logging.getLogger(__name__)

# The share of lost frames in one window that raises the alarm: one shortened queue in ten seconds at 18.75 fps is 8 %.
RAISE_SHARE: Final = 0.05
# Below this the machine keeps up again; between the two the alarm stays as it is.
CLEAR_SHARE: Final = 0.01
LATENCIES_KEPT: Final = 1000
# A time server that slews a clock moves it by at most 0.5 ms a second; more than this in 10 s is a step.
STEP_NS: Final = 2 * 10**9
# Steps that wait while the database refuses writes; the newest are kept.
_MOST_STEPS: Final = 64
# The alarm ends when there is this much more room than where it began, so that it does not come and go.
CLEARED_AT: Final = 1.1
# A frame older than this when it is processed cannot be judged any more.
LATE_NS: Final = round(MAX_AGE_S * 1e9)


class FrameCounts(NamedTuple):
    """Since the start."""

    frames: int = 0
    """Delivered by the sensor."""
    dropped: int = 0
    """Delivered frames that were never processed."""
    late: int = 0
    """Processed too late."""
    interrupted: int = 0
    """How often frames were dropped while the gel was pressed."""
    late_presses: int = 0
    """Judged too late, so rejected."""

    def since(self, before: "FrameCounts") -> "FrameCounts":
        """The counts since `before`."""
        return FrameCounts(*(now - then for now, then in zip(self, before, strict=True)))


class OverloadRule:
    """Call `step` once a window, some seconds long, with the counts so far."""

    def __init__(self) -> None:
        self._before = FrameCounts()
        self._sentence: Sentence | None = None

    def skip(self, counts: FrameCounts) -> None:
        """Skip this window: something else delayed the gateway, and has its own alarm."""
        self._before = counts

    def step(self, counts: FrameCounts) -> Sentence | None:
        """The fault and what to do while this machine is too slow, None while it keeps up.

        Raised when more than RAISE_SHARE of the window's frames were dropped or late, or when a press could not be
        followed; cleared by a window without such a press and below CLEAR_SHARE.
        """
        window = counts.since(self._before)
        self._before = counts
        lost = window.dropped + window.late
        missed = window.interrupted + window.late_presses
        if lost > RAISE_SHARE * window.frames or missed:
            self._sentence = _sentence(window)
        elif lost <= CLEAR_SHARE * window.frames:
            self._sentence = None
        return self._sentence


def _sentence(window: FrameCounts) -> Sentence:
    presses = ""
    if window.interrupted:
        presses += Sentence(f", {window.interrupted} times while the gel was pressed")
    if window.late_presses:
        presses += Sentence(
            f", and {window.late_presses} presses were rejected because they were judged too late"
        )
    return Sentence(
        f"this machine is too slow: of the last {window.frames} frames {window.dropped} were dropped and "
        f"{window.late} came too late{presses}; presses may have been missed. End other programs on it, give it "
        "more cores, or use a bundle that scores faster"
    )


@dataclass
class Summary:
    """The counts of a run."""

    presses: int = 0
    has_ended: bool = False
    """A recording was played to its end."""
    pieces: Counter[str] = field(default_factory=Counter)
    """Verdict to number of the pieces of several places that are over."""
    verdicts: Counter[str] = field(default_factory=Counter)
    """Word to number, `error` for a press without a verdict, `reference` and `study` for presses of master pieces and
    studies."""
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES_KEPT))
    """Frame to verdict of the newest presses that were scored; rejected presses and errors are faster, so they do not
    count."""
    frames: FrameCounts = field(default_factory=FrameCounts)
    """The fate of the sensor's frames."""
    frames_corrupt: int = 0
    """Not delivered, or delivered and not decodable."""
    frames_stale: int = 0
    """Came twice."""

    def add(self, report: PressReport) -> None:
        """Count one more press."""
        result = report.result
        self.presses += 1
        self.verdicts[report.word] += 1
        if result.score is not None and "total" in result.latency_ms:
            self.latencies_ms.append(result.latency_ms["total"])
        if (result.reason or "").startswith(f"{Reason.STALE}:"):
            self.frames = self.frames._replace(late_presses=self.frames.late_presses + 1)

    def add_lost(self, *, is_late: bool, was_interrupted: bool) -> None:
        """Count a frame for which this machine was too slow (see FrameCounts)."""
        self.frames = self.frames._replace(
            late=self.frames.late + is_late,
            interrupted=self.frames.interrupted + was_interrupted,
        )

    def see(self, sensor: AcquisitionStatus, undecodable: int) -> None:
        """Add the reader thread's counts. undecodable: frames that arrived and could not be decoded."""
        self.frames = self.frames._replace(frames=sensor.frames, dropped=sensor.dropped)
        self.frames_corrupt = sensor.corrupt + undecodable
        self.frames_stale = sensor.stale

    def fields(self) -> dict[str, Any]:
        """Return what `stats` says of frames and presses."""
        return {
            "frames": self.frames.frames,
            "frames_corrupt": self.frames_corrupt,
            "frames_stale": self.frames_stale,
            "frames_dropped": self.frames.dropped,
            "frames_late": self.frames.late,
            "presses": self.presses,
            "presses_interrupted": self.frames.interrupted,
            "verdicts": dict(self.verdicts),
            "pieces": dict(self.pieces),
            "latency_ms_p50": median(self.latencies_ms) if self.latencies_ms else None,
            "latency_ms_max": max(self.latencies_ms, default=None),
        }


class ClockGuard:
    """Call `step` now and then."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._apart_ns = self._now_apart_ns()

    def step(self) -> float | None:
        """The seconds by which the wall clock was set since the last call, None if it was not."""
        apart_ns = self._now_apart_ns()
        step_ns, self._apart_ns = apart_ns - self._apart_ns, apart_ns
        return step_ns / 1e9 if abs(step_ns) > STEP_NS else None

    def _now_apart_ns(self) -> int:
        return self._clock.time_ns() - self._clock.monotonic_ns()


def free_bytes(path: Path) -> int | None:
    """Room for the gateway's user on the disk of this file; None where it cannot be asked."""
    try:
        return shutil.disk_usage(path.parent).free
    except OSError:
        return None


class FreeSpace:
    """The room on the disk of the database. warn_bytes: less is an alarm. ask: how much there is.

    bytes: as last asked.
    """

    def __init__(
        self, database: Path, warn_bytes: int, ask: Callable[[Path], int | None] = free_bytes
    ) -> None:
        self.bytes: int | None = None
        self._database = database
        self._warn_bytes = warn_bytes
        self._ask = ask
        self._is_low = False

    def check(self) -> Sentence | None:
        """Ask again; the sentence of the alarm, None while there is room."""
        self.bytes = self._ask(self._database)
        if self.bytes is not None:
            self._is_low = self.bytes < self._warn_bytes * (CLEARED_AT if self._is_low else 1)
        if not self._is_low or self.bytes is None:
            return None
        return Sentence(
            f"the disk of {self._database} has {self.bytes / 1e6:.1f} MB free, fewer than {self._warn_bytes / 1e6:.1f} "
            "(store.free_mb); free space before it is full: then inspection halts"
        )


class Report:
    """Counts while a station runs, and publishes it all now and then. The loop uses it."""

    def __init__(
        self,
        store: Store,
        publisher: Publisher,
        status: StationStatus,
        acquisition: Acquisition,
        free_space: FreeSpace,
        clock: Clock,
    ) -> None:
        self.summary = Summary()
        self.clock_guard = ClockGuard(clock)
        self._steps: deque[Act] = deque(maxlen=_MOST_STEPS)
        self._last_press_ns = store.read("reading the newest press", _read_last_press_ns)
        self._store, self._publisher, self._status, self._acquisition = store, publisher, status, acquisition
        self._free_space, self._clock = free_space, clock
        self._overload = OverloadRule()
        self._dropped_before = 0
        self._was_held_up = False
        self._started_ns = clock.monotonic_ns()
        self._outbox = publisher.outbox_status()
        self._last_piece = 0
        self._count_pieces()
        self.summary.pieces.clear()  # of earlier runs

    def count_frame(self, frame: CameraFrame, *, has_contact: bool) -> None:
        """Count a frame for which this machine was too slow."""
        dropped, now_ns = self._acquisition.status.dropped, self._clock.monotonic_ns()
        self.summary.add_lost(
            is_late=not frame.is_on_demand and now_ns - frame.timestamp_ns > LATE_NS,
            was_interrupted=dropped > self._dropped_before and has_contact,
        )
        self._dropped_before = dropped

    def note_store_fault(self, error: StoreError) -> None:
        """Raise the fault; frames lost because the store refuses writes are no overload."""
        self._was_held_up = True
        if self._status.set_fault("store", Sentence(str(error))):
            log.error("%s", error)

    def publish(self, session: InspectionSession | None, *, is_halted: bool) -> None:
        """Publish the counts so far, and check whether another process replaced the gel."""
        status, sensor = self._status, self._acquisition.status
        self.summary.see(sensor, session.corrupt if session else 0)
        self._say_load()
        status.say("disk", self._free_space.check(), "warning")
        try:
            self._count_pieces()
            if session is not None:
                session.see_gel(self._store.gel(session.gel.serial, self._clock.time_ns()))
            outbox, head = self._publisher.outbox_status(), str(self._store.ledger_head())
            findings = self._store.findings()
            self.note_drops(outbox)  # also where nothing can be written
            self._note_clock_step()
        except StoreError as error:
            self.note_store_fault(error)
            return
        if not is_halted:
            status.set_fault("store", None)
        counters = self._publisher.counters()
        receivers = {name: _describe(sink) for name, sink in counters.items()}
        gel = session.gel if session else None
        payload = StatsPayload(
            time_ns=self._clock.time_ns(),
            uptime_s=(self._clock.monotonic_ns() - self._started_ns) / 1e9,
            **self.summary.fields(),
            delivered_fps=sensor.fps,
            reconnects=sensor.reconnects,
            outbox_rows=outbox.rows,
            outbox_bytes=outbox.bytes,
            outbox_refused=outbox.refused,
            dropped=dict(outbox.dropped),
            disk_free_bytes=self._free_space.bytes,
            gel_presses=gel.presses if gel else None,
            gel_limit_presses=gel.limit_presses if gel else None,
            alarms=tuple(sorted(status.view().alarms)),
            receivers=receivers,
            ledger_head=head,
        )
        status.announce(payload.message())
        refusals = "; ".join(sink.last_refusal for sink in counters.values() if sink.last_refusal)
        refused = Sentence(f"{outbox.refused} messages were refused and are kept: {refusals}")
        if outbox.refused == 1:
            refused = Sentence(f"1 message was refused and is kept: {refusals}")
        status.say("refused", refused if outbox.refused else None)
        faults = [f"{name}: {fault}" for name, sink in counters.items() for fault in sink.faults]
        status.say("receiver", join_sentences(faults), "warning")
        status.counts(findings)

    def note_drops(self, outbox: OutboxStatus) -> None:
        """Raise an alarm for dropped messages until a person acknowledges them, over a restart too."""
        self._outbox = outbox
        crowded = {kind: number - outbox.aged.get(kind, 0) for kind, number in outbox.unseen.items()}
        words = [
            Sentence(f"{number} of kind {kind} ({why})")
            for counts, why in ((outbox.aged, Sentence("too old")), (crowded, Sentence("no room")))
            for kind, number in counts.items()
            if number
        ]
        if words:
            self._status.say("outbox_full", Sentence(f"unsent messages were dropped: {'; '.join(words)}"))

    def acknowledge_drops(self) -> None:
        """A person has seen the alarm `outbox_full`: it is raised again by the next drop. Errors: StoreError."""
        self._publisher.acknowledge_drops(self._outbox)

    def _say_load(self) -> None:
        """Frames lost because the store refuses writes have their own alarm."""
        if self._was_held_up:
            self._overload.skip(self.summary.frames)
            self._was_held_up = False
        self._status.say("overload", self._overload.step(self.summary.frames))

    def _count_pieces(self) -> None:
        """Count the pieces that are over since the last call. Errors: StoreError."""
        count = partial(count_ended, after=self._last_piece)
        ended, self._last_piece = self._store.read("counting pieces", count)
        self.summary.pieces.update(ended)

    def _note_clock_step(self) -> None:
        """Write it into the log and the table of acts, also one between the last run and this. Errors: StoreError; then
        it is an act with a later report."""
        now_ns, seconds = self._clock.time_ns(), self.clock_guard.step()
        if seconds is None and now_ns < self._last_press_ns - STEP_NS:
            seconds = (now_ns - self._last_press_ns) / 1e9
        self._last_press_ns = 0
        if seconds is not None:
            log.warning("the clock of this machine was set by %+.0f s", seconds)
            step = {"seconds": round(seconds, 3)}
            self._steps.append(Act(now_ns, "the gateway", "clock_step", arguments=step, outcome="done"))
        while self._steps:
            self._store.begin_act(self._steps[0])
            self._steps.popleft()


def _read_last_press_ns(connection: sqlite3.Connection) -> int:
    """Read when the newest press of earlier runs was made; 0 where there is none."""
    row = connection.execute("SELECT time_ns FROM presses ORDER BY number DESC LIMIT 1").fetchone()
    return int(row[0]) if row else 0


def _describe(sink: SinkCounters) -> str:
    """Return a receiver's state in `stats`; errors are English."""
    state = Sentence("up") if sink.is_up else sink.last_error or Sentence("not yet tried")
    return Sentence(f"{state}, MQTT {sink.level}") if sink.level else state
