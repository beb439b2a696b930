"""A study on a running station: each press is the next step of the plan."""

import queue
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from calibration.experiments.gauge.plan import ORIGIN, SCORED, StudyPlan
from edge.clock import SystemClock
from edge.config import Config
from edge.core.errors import ConfigError, DatasetError
from edge.core.press import Press, PressLabel, StudyLabel
from edge.gateway.build import open_station
from edge.press_stage import Mounted, PressStage
from edge.store import study_presses
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import PressRecord, Store
from edge.store.study_presses import StudyPress, StudyTable

__all__ = ["StudyLabels", "prepare_labels", "run_study"]


@dataclass
class StudyLabels(PressStage):
    """Names each press after the plan of a study."""

    plan: StudyPlan
    rows: Sequence[StudyPress]
    """Its presses so far."""
    say: Callable[[str], None]
    """Lines for the person."""
    stop: Callable[[], None]
    """Ends the run."""
    void: Callable[[str], object]
    """Makes the press with this id count no more."""
    keys: "queue.SimpleQueue[str]" = field(default_factory=queue.SimpleQueue)
    """What a person has typed, `r` or `s`, from any thread."""
    fault: str | None = None
    """Why the study cannot go on."""

    def __post_init__(self) -> None:
        counted = [row for row in self.rows if not row.is_void]
        done = {press.step for press in counted if press.verdict in SCORED}
        # Places in the plan's order, from 0, that have no counted press with a score.
        self._open = [number for number in range(len(self.plan.order)) if number not in done]
        self._skipped: list[int] = []
        self._last: tuple[int, str] | None = None
        self._before = [str(getattr(press, name)) for press in counted[:1] for name in ORIGIN.values()]
        self._has_asked = False

    @property
    def left(self) -> int:
        """Presses of the plan that are still to be made."""
        return len(self._open) + len(self._skipped)

    def turn(self, mounted: Mounted | None) -> None:
        if mounted is None:
            return
        now = [mounted.serial, mounted.gel_id, mounted.part.part, mounted.part.position, mounted.bundle_id]
        self._before = self._before or now
        if now != self._before:
            self.fault = _describe_change(self._before, now)
            self.stop()
            return
        while not self.keys.empty():
            self._obey(self.keys.get())
        if not self._open:
            self.stop()
        elif not self._has_asked:
            self._ask()

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        if self.fault is not None or not self._open:
            return label
        number = self._open[0]
        step = self.plan.order[number]
        return StudyLabel(self.plan.study_id, number, step.piece, step.operator, step.repeat)

    def table(self, press: Press, row: PressRecord) -> StudyTable | None:
        if not isinstance(label := press.label, StudyLabel):
            return None
        return StudyTable(label, press.bundle_id, press.reason or press.error)

    def record(self, press: Press, gel: GelRecord) -> None:
        if not isinstance(label := press.label, StudyLabel):
            return
        if press.word not in SCORED:
            self.say(f"no score: {press.error or press.reason}; press {label.piece} again")
            return
        if press.is_at_rest is False:
            self.say(
                "it was lifted before it rested, and its deepest frame was judged: r and Enter repeats it"
            )
        self._last = (label.step, press.press_id)
        for steps in (self._open, self._skipped):
            if label.step in steps:
                steps.remove(label.step)
        if not self._open:
            self.stop()
            return
        self._ask()

    def _ask(self) -> None:
        self._has_asked = True
        number = self._open[0]
        step = self.plan.order[number]
        self.say(
            f"press {number + 1} of {len(self.plan.order)}: operator {step.operator}, piece {step.piece}, repeat "
            f"{step.repeat}"
        )

    def _obey(self, key: str) -> None:
        match key:
            case "r" if self._last is not None:
                number, press_id = self._last
                self.void(press_id)
                self._open.insert(0, number)
                self._last = None
                self._ask()
            case "r":
                self.say("there is no press of this run to repeat")
            case "s" if self._open:
                self._skipped.append(self._open.pop(0))
                self.say("skipped: it is asked for again at the next run")
                if self._open:
                    self._ask()
            case _:
                self.say(f"'{key}' is no key: r and Enter repeats the last press, s and Enter skips this one")


def _describe_change(before: Sequence[str], now: Sequence[str]) -> str:
    """Say what is not as it was."""
    words = [
        f"{name} {old[:16]} before and {new[:16]} now"
        for name, old, new in zip(ORIGIN, before, now, strict=True)
        if old != new
    ]
    return (
        f"the study was begun with another {' and '.join(words)}: its scores cannot be compared; put that back, or "
        "make a new plan"
    )


def run_study(plan: StudyPlan, config: Config, say: Callable[[str], None]) -> int:
    """Press until the plan is done, Ctrl-C, or the end of a recording; returns the number of presses that are left.

    Errors: those of a gateway; ConfigError for a plan that was changed; DatasetError for another gel, bundle or sensor
    than before.
    """
    stop = threading.Event()
    with Store(config.store.path) as store:
        labels = prepare_labels(plan, store, say, stop.set)
        if not labels.left:
            return 0
        alone = config.model_copy(update={"piece": None})  # a piece in progress waits until the study is over
        with open_station(alone, SystemClock(), stages={"reference_press": labels}) as station:
            if sys.stdin is not None and sys.stdin.isatty():  # the thread ends with the process
                threading.Thread(target=_read_keys, args=(labels.keys,), name="keys", daemon=True).start()
            try:
                station.run(stop)
            except KeyboardInterrupt:
                say("stopped with Ctrl-C")
    if labels.fault is not None:
        raise DatasetError(labels.fault)
    return labels.left


def prepare_labels(
    plan: StudyPlan, store: Store, say: Callable[[str], None], stop: Callable[[], None]
) -> StudyLabels:
    """Prepare a new study, or one to go on with. Errors: ConfigError for a changed plan; StoreError."""
    begin = partial(
        study_presses.begin_study,
        study_id=plan.study_id,
        plan=plan.text(),
        time_ns=SystemClock().time_ns(),
    )
    if store.write("beginning a gauge study", begin) != plan.text():
        raise ConfigError(
            f"the plan of study {plan.study_id} was changed since it was begun; use the file as it was, or make a new "
            "plan with `gelgate lab msa plan`"
        )
    rows = store.read("reading a gauge study", partial(study_presses.of_study, study_id=plan.study_id))

    def void(press_id: str) -> bool:
        return store.write("repeating a press", partial(study_presses.void, press_id=press_id))

    return StudyLabels(plan, rows, say, stop, void)


def _read_keys(typed: "queue.SimpleQueue[str]") -> None:
    for line in sys.stdin:
        typed.put(line.strip().lower())
