"""A study pressed on a station: the gateway with the plan's labels in place of the reference presses."""

import queue
import sys
import threading
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from calibration.gauge_study.live import StudyLabels
from calibration.gauge_study.plan import StudyPlan
from edge.clock import SystemClock
from edge.config import Config
from edge.core.errors import ConfigError, DatasetError
from edge.gateway.gateway import Gateway
from edge.store import study_presses
from edge.store.press_store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["prepared", "run_study"]


def run_study(plan: StudyPlan, config: Config, say: Callable[[str], None]) -> int:
    """Press until the plan is done, Ctrl-C, or the end of a recording; returns the number of presses that are left.

    Errors: those of a gateway; ConfigError for a plan that was changed; DatasetError for another gel, bundle or sensor
    than before.
    """
    stop = threading.Event()
    with Store(config.store.path) as store:
        labels = prepared(plan, store, say, stop.set)
        if not labels.left:
            return 0
        with (
            Gateway.open(config, SystemClock(), labels=labels) as gateway,
            _keys(labels.keys),
        ):
            try:
                gateway.run(stop)
            except KeyboardInterrupt:
                say("stopped with Ctrl-C")
    if labels.fault is not None:
        raise DatasetError(labels.fault)
    return labels.left


def prepared(
    plan: StudyPlan, store: Store, say: Callable[[str], None], stop: Callable[[], None]
) -> StudyLabels:
    """The labels of a new study, or of one to go on with. Errors: ConfigError for a changed plan; StoreError."""
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


@contextmanager
def _keys(typed: "queue.SimpleQueue[str]") -> "Iterator[None]":
    """Lines of a terminal, read by a thread of their own that ends with the process."""
    if sys.stdin is not None and sys.stdin.isatty():
        threading.Thread(target=_read, args=(typed,), name="keys", daemon=True).start()
    yield


def _read(typed: "queue.SimpleQueue[str]") -> None:
    for line in sys.stdin:
        typed.put(line.strip().lower())
