"""What a server asks of the station, on its own threads: the machine behind its lock, and the record of refusals."""

import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final, final

from edge.core.handshake import Code, HandshakeMachine, HandshakeView, Refusal, Trigger, check_trigger
from edge.core.part_position import PartPosition
from edge.core.ports import Clock
from edge.core.rate import Rate
from edge.press_stage import Selection
from edge.store.acts import Act
from edge.store.press_store import Store

__all__ = ["PLC", "Port"]

log = logging.getLogger(__name__)

# Who asked, in the table of acts.
PLC: Final = "plc"

# A PLC repeats a write some fifty times a second: the same refusal within this time is one, and of others so many a
# minute are recorded.
SAME_S: Final = 60.0
PER_MINUTE: Final = 60
_MOST_REMEMBERED: Final = 64
# Letters of a refused text that are recorded: OPC UA sends it in any length.
_LONGEST_NOTED: Final = 64


@final
class Port:
    """A `Handshake`. Any thread may use it.

    on_trigger: called with every trigger that is taken, and the part that it names.
    """

    def __init__(
        self,
        machine: HandshakeMachine,
        selection: Selection,
        store: Store,
        clock: Clock,
        on_trigger: Callable[[Trigger, PartPosition | None], None],
    ) -> None:
        self._machine, self._selection, self._store, self._clock = machine, selection, store, clock
        self._on_trigger = on_trigger
        self._lock = threading.Lock()
        self._rate, self._recent = Rate(PER_MINUTE, clock), OrderedDict[str, int]()
        self._unrecorded: deque[Act] = deque(maxlen=PER_MINUTE)

    @contextmanager
    def machine(self) -> Iterator[tuple[HandshakeMachine, int]]:
        """Give the machine, for this thread alone, and the time."""
        with self._lock:
            yield self._machine, self._clock.monotonic_ns()

    def read(self) -> HandshakeView:
        with self.machine() as (machine, now_ns):
            return machine.read(now_ns)

    def trigger(self, trigger: Trigger) -> Refusal | None:
        part = self._find_part(trigger.part) if trigger.part and check_trigger(trigger) is None else None
        with self.machine() as (machine, now_ns):
            if isinstance(part, Refusal):
                refusal: Refusal | None = machine.refuse(part)
            else:
                refusal = machine.trigger(trigger, now_ns, None if part is None else str(part))
        if refusal is not None:
            texts = {"piece": trigger.piece[:_LONGEST_NOTED], "part": trigger.part[:_LONGEST_NOTED]}
            self._note("trigger", refusal.sentence, {"trigger_id": trigger.trigger_id, **texts})
        elif not isinstance(part, Refusal):
            self._on_trigger(trigger, part)
        return refusal

    def acknowledge(self) -> None:
        with self.machine() as (machine, now_ns):
            machine.acknowledge(now_ns)

    def beat(self) -> None:
        with self.machine() as (machine, now_ns):
            machine.beat(now_ns)

    def refuse(self, what: str, sentence: str) -> None:
        if what == "trigger":
            with self.machine() as (machine, _):
                machine.refuse(Refusal(Code.BAD_VALUE, sentence))
        self._note(what, sentence, {})

    def _find_part(self, name: str) -> PartPosition | Refusal:
        known = self._selection.find_all(name)
        if len(known) == 1:
            return next(iter(known))
        if not known:
            return Refusal(
                Code.UNKNOWN_PART,
                f"this station has no bundle of the part '{name:.64}'; add it to [inspection]",
            )
        positions = ", ".join(sorted(map(str, known)))
        return Refusal(
            Code.UNKNOWN_PART,
            f"the part '{name:.64}' has {len(known)} positions here; name one of {positions}",
        )

    def _note(self, verb: str, sentence: str, arguments: Mapping[str, Any]) -> None:
        """Have it in the log, and in the table of acts with the next turn, once."""
        now_ns = self._clock.monotonic_ns()
        with self._lock:
            noted_ns = self._recent.get(sentence)
            if noted_ns is not None and now_ns - noted_ns < SAME_S * 1e9:
                return
            self._recent[sentence] = now_ns
            self._recent.move_to_end(sentence)
            if len(self._recent) > _MOST_REMEMBERED:
                self._recent.popitem(last=False)
        if not self._rate.take():
            return
        log.warning("the %s of the PLC was refused: %s", verb, sentence)
        time_ns = self._clock.time_ns()
        act = Act(time_ns, PLC, verb, arguments=arguments, outcome="refused", sentence=sentence)
        self._unrecorded.append(act)

    def record(self) -> None:
        """Record what was refused since the last call, for the loop: no PLC waits for the database. Errors: StoreError;
        then it goes on waiting."""
        while self._unrecorded:
            self._store.begin_act(self._unrecorded[0])
            self._unrecorded.popleft()
