"""Which bundle inspects: the selected position of a part, changed between two presses. Used by the loop alone."""

import logging
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Final

from edge.background import Background
from edge.core.errors import BundleCorrupt, GelgateError, StoreError
from edge.core.part_position import PartPosition
from edge.core.ports import Clock
from edge.core.sentence import Sentence, join_sentences
from edge.gateway.bundle_set import BundleSet
from edge.gateway.opening import Opened
from edge.gateway.status import StationStatus
from edge.model.inspector import Inspector
from edge.store.acts import Act
from edge.store.press_store import Store

__all__ = ["PartSelection"]

log = logging.getLogger(__name__)

# A first run of a bundle may take two minutes; nothing is lost when it is left.
CLOSE_S: Final = 3.0
GOLDEN_EVERY_S: Final = 3600.0
# After a fault they are scored again sooner: it may have been the memory of one moment.
AFTER_FAULT_S: Final = 60.0
# Bundles are opened again so long after the database could not be asked about them.
ASK_AGAIN_S: Final = 5.0


class GoldenWatch:
    """The golden frames of the bundle in use, scored again every hour: a machine that computes differently is found.

    `watch` a bundle from now on, then `step` in every turn in which nothing presses the gel: no press waits for more
    than one frame's score. The bundle's `Inspector.fault` is why its scores cannot be trusted.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._inspector: Inspector | None = None
        self._number = 0
        self._next_ns = 0
        self._asked: list[Future[str | None]] = []

    def watch(self, inspector: Inspector, *, is_checked: bool = False) -> None:
        """Another bundle is in use. is_checked: its frames were scored just now."""
        self._inspector = inspector
        self._number = 0
        self._next_ns = self._clock.monotonic_ns() + (round(GOLDEN_EVERY_S * 1e9) if is_checked else 0)

    def request(self) -> "Future[str | None]":
        """Score all frames with the next turns; the result is the fault after the last one."""
        self._number, self._next_ns = 0, self._clock.monotonic_ns()
        self._asked.append(Future())
        return self._asked[-1]

    def step(self) -> None:
        """Score one golden frame, if it is time."""
        if self._inspector is None or self._clock.monotonic_ns() < self._next_ns:
            return
        fault = None
        try:
            if self._number < len(self._inspector.bundle.golden):
                self._inspector.scorer.check_golden_frame(self._number)
                self._number += 1
                if self._number < len(self._inspector.bundle.golden):
                    return
        except BundleCorrupt as error:
            fault = Sentence(str(error))
        self._number = 0
        self._next_ns = self._clock.monotonic_ns() + round((AFTER_FAULT_S if fault else GOLDEN_EVERY_S) * 1e9)
        self._inspector.fault = fault
        for asked in self._asked:
            if asked.set_running_or_notify_cancel():
                asked.set_result(fault)
        self._asked.clear()

    def close(self) -> None:
        """Score nothing any more: who waits for golden frames is not kept waiting. May be called again."""
        for asked in self._asked:
            asked.cancel()


class PartSelection:
    """The bundles of a station and the one in use, a `Selection`.

    A change that is asked for during a press is made after it: a press is judged by the bundle with which it began.
    New bundles are opened in the background, by `open_bundles` from those in use. Those that fail leave the ones in use
    as they are, with the alarm `bundle`. on_change: called with every other bundle in use, and with new bundles.
    """

    def __init__(
        self,
        bundles: BundleSet,
        part: PartPosition,
        open_bundles: Callable[[BundleSet], Opened],
        store: Store,
        status: StationStatus,
        clock: Clock,
    ) -> None:
        self.bundles = bundles
        self._in_use = bundles[part]
        self._wanted = part
        self._why: Act | None = None
        self.worker: Background[tuple[int, Opened | GelgateError]] = Background("bundles", CLOSE_S)
        self._open = open_bundles
        self._store = store
        self._status = status
        self._clock = clock
        self._is_recorded = False
        self._exchanges = 0
        self._again_ns: int | None = None
        """When bundles are opened again: what the database says of them could not be read."""
        self._unrecorded: deque[Act] = deque()
        self.golden = GoldenWatch(clock)
        self.on_change: Callable[[], None] = lambda: None
        self.golden.watch(self.inspector, is_checked=True)

    @property
    def inspector(self) -> Inspector:
        return self._in_use.inspector

    @property
    def part(self) -> PartPosition:
        return self._in_use.part

    @property
    def selected(self) -> PartPosition:
        """What is inspected, or will be once nothing presses the gel."""
        return self._wanted

    @property
    def path(self) -> Path:
        return self._in_use.path

    @property
    def is_waiting(self) -> bool:
        return self.bundles[self._wanted].inspector is not self.inspector

    @property
    def shadow(self) -> Inspector | None:
        shadow = self.bundles.shadows.get(self.part)
        return None if shadow is None or self.is_waiting else shadow.inspector

    @property
    def shadow_faults(self) -> tuple[str, ...]:
        return self.bundles.shadow_faults

    @property
    def instead_of(self) -> str | None:
        return self._in_use.instead_of

    def exchange(self, why: Act) -> None:
        before = self.bundles
        self.bundles, self._why = before.exchange(self.part), why
        try:
            self._change()
        except StoreError:
            self.bundles, self._why = before, None
            raise
        self._exchanges += 1
        self.on_change()

    def find_all(self, name: str) -> frozenset[PartPosition]:
        return self.bundles.find_all(name)

    def select(self, part: PartPosition, why: Act | None = None, *, is_pressed: bool) -> None:
        """Inspect this from now on, or from the end of this press on. part: one of `bundles`. why: recorded with the
        change. What cannot be recorded is not done later either. Errors: StoreError."""
        before = self._wanted
        self._wanted, self._why = self.bundles[part].part, why
        try:
            if self._wanted != before and not self.is_waiting:
                # What waited is taken back: that is selected now.
                self._change()
            self.step(is_pressed=is_pressed)
        except StoreError:
            # A reload may have taken away what waited before.
            self._wanted, self._why = before if before in self.bundles else self.part, None
            raise

    def start(self) -> None:
        """Begin to wait for requests to open bundles, in the background."""
        self.worker.start()

    def reload(self) -> None:
        self.worker.ask(self._open_again)

    def step(self, *, is_pressed: bool) -> None:
        """Take one turn: new bundles, change the one in use, score a golden frame. Errors: StoreError, and then the one
        in use has not changed; the next turn tries again."""
        inspector, bundles = self.inspector, self.bundles
        if self._again_ns is not None and self._clock.monotonic_ns() >= self._again_ns:
            self._again_ns = None
            self.reload()
        if (outcome := self.worker.take()) is not None:
            exchanges, staged = outcome
            if exchanges == self._exchanges:
                self._take(staged)
            else:  # opened for bundles that have changed places meanwhile
                self.reload()
        try:
            while self._unrecorded:
                self._store.begin_act(self._unrecorded[0])
                self._unrecorded.popleft()
            if not is_pressed and (self.is_waiting or not self._is_recorded):
                self._change()
            elif not is_pressed:
                self.golden.step()
            # While golden frames score otherwise, no press has a verdict.
            if self._status.set_fault("golden", self.inspector.fault):
                log.error("%s", self.inspector.fault)
        finally:  # new bundles are there, recorded or not
            if self.inspector is not inspector or self.bundles is not bundles:
                self.on_change()

    def close(self) -> None:
        """End the work in the background; what is being opened is waited for, but not long. May be called again."""
        self.worker.close()

    def _open_again(self) -> tuple[int, Opened | GelgateError]:
        """Open what is configured now; the bundles in use that have not changed are kept as they are. Return it after
        the number of exchanges that had been made when it began."""
        exchanges = self._exchanges
        try:
            return exchanges, self._open(self.bundles)
        except GelgateError as error:
            return exchanges, error
        except Exception as error:  # the loop reports it, and the bundles in use stay
            log.exception("the new bundles could not be opened")
            why = f"the new bundles could not be opened ({error!r:.200}); see the log"
            return exchanges, GelgateError(why)

    def _change(self) -> None:
        chosen = self.bundles[self._wanted]
        bundle = chosen.bundle
        revision, now_ns = bundle.manifest.revision, self._clock.time_ns()
        self._store.use_bundle(chosen.part, revision, bundle.digest, now_ns, self._why, chosen.instead_of)
        self._is_recorded, self._why = True, None
        before, self._in_use = self.inspector, chosen
        if chosen.inspector is not before:
            log.info("%s is inspected from now on, with bundle %s", chosen.part, bundle.where)
            self.golden.watch(chosen.inspector)

    def _take(self, staged: Opened | GelgateError) -> None:
        """Use the new bundles, unless the selected position would have none."""
        errors = [staged] if isinstance(staged, GelgateError) else list(staged.faults.values())
        is_unread = any(isinstance(error, StoreError) for error in errors)
        self._again_ns = self._clock.monotonic_ns() + round(ASK_AGAIN_S * 1e9) if is_unread else None
        faults = list(map(str, errors))
        if isinstance(staged, Opened):
            if {self.part, self._wanted} <= set(staged.bundles.bundles):
                self.bundles = staged.bundles
                new = staged.bundles[self.part]
                if new.inspector is self.inspector:  # under its new names; another one waits to be changed
                    self._is_recorded &= new.instead_of == self._in_use.instead_of
                    self._in_use = new
            else:
                faults.append(
                    Sentence(
                        f"there is no bundle for the selected {self._wanted} any more, so those in use stay; add one, "
                        "or select another part and reload again"
                    )
                )
        self._report(faults, staged.left if isinstance(staged, Opened) else ())

    def _report(self, faults: list[str], left: Sequence[str]) -> None:
        """Say it in the log and by the alarm; `step` writes it into the table of acts. left: what has changed and is
        not read again."""
        for fault in faults:
            log.error("%s", fault)
        self._status.say("bundle", join_sentences(faults))
        sentences = list(faults)
        if left:
            sentences.append(
                f"changed in the configuration, and read at the next start alone: {', '.join(left)}"
            )
            log.warning("%s", sentences[-1])
        bundles = {str(part): bundle.bundle.digest for part, bundle in self.bundles.bundles.items()}
        self._unrecorded.append(
            Act(
                self._clock.time_ns(),
                "the gateway",
                "open_bundles",
                outcome="failed" if faults else "done",
                sentence=join_sentences(sentences),
                after={"bundles": bundles},
            )
        )
