"""A running station: built, run, closed.

One thread reads the sensor and one per sink publishes. The thread that calls `run` does everything between: contact,
score, verdict, and the one transaction that counts a press and queues its messages.
"""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Self

from edge.acquisition import AcquisitionStatus
from edge.config import Config
from edge.core.ports import Clock
from edge.gateway.build import build
from edge.gateway.preflight import Preflight
from edge.gateway.report import Summary
from edge.gateway.service_manager import ServiceManager
from edge.gateway.station_loop import OnPress, Parts, StationLoop
from edge.press_stage import PressStage

__all__ = ["Gateway"]


class Gateway:
    """`open` builds it, `run` inspects until it is stopped, `close` closes it.

    A missing sensor is a fault while running, not an error: it is reported, and the station waits for it.
    """

    def __init__(self, parts: Parts, closing: ExitStack, on_press: OnPress = lambda report: None) -> None:
        self.loop = StationLoop(parts, on_press)
        self._parts = parts
        self._closing = closing
        self._is_reload_wanted = False

    @classmethod
    def open(
        cls,
        config: Config,
        clock: Clock,
        on_press: OnPress = lambda report: None,
        checked: Preflight | None = None,
        read_again: Callable[[], Config] | None = None,
        stages: Mapping[str, PressStage] | None = None,
    ) -> Self:
        """Build every part; a part that cannot work is refused here, before anything is started.

        on_press: called by the loop with every recorded press. checked: the parts opened by the check before the start.
        read_again: reads the configuration at a reload. stages: they take the place of the features of these names.
        Errors: ConfigError, BundleError, StoreError.
        """
        with ExitStack() as closing:
            parts = build(config, clock, closing, checked, read_again, stages)
            return cls(parts, closing.pop_all(), on_press)

    def run(self, stop: threading.Event, *, presses: int | None = None) -> Summary:
        """Inspect until `stop` is set, a recording ends, or that number of presses was recorded."""
        self._parts.publisher.start()
        for stage in self._parts.stages:
            stage.start()
        self._parts.acquisition.start()
        self._parts.selection.start()
        manager = ServiceManager(self._parts.clock)
        manager.ready()

        def on_turn() -> None:
            manager.alive()
            if self._is_reload_wanted:
                self._is_reload_wanted = False
                self._parts.selection.reload()

        self.loop.run(stop, presses, on_turn)
        manager.stopping()
        return self.loop.summary

    def reload(self) -> None:
        """Open the bundles again with the next turn. A handler of a signal may call it: no lock is taken."""
        self._is_reload_wanted = True

    @property
    def summary(self) -> Summary:
        """The counts of the run so far."""
        return self.loop.summary

    @property
    def status(self) -> AcquisitionStatus:
        """The status of the sensor."""
        return self._parts.acquisition.status

    def close(self) -> None:
        """Close the parts in reverse; unsent messages stay in the outbox. May be called again."""
        self._closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
