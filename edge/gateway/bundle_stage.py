"""New bundles are opened here while the station inspects: the loop takes them when they are ready.

A thread of its own, because a first run takes seconds and a press must not wait for it.
"""

import logging
import threading
from collections.abc import Callable
from typing import Final

from edge.core.errors import GelgateError
from edge.gateway.bundle_set import BundleSet
from edge.gateway.opening import Opened

__all__ = ["BundleStage", "OpenBundles"]

# A first run may take two minutes; nothing is lost when it is left.
CLOSE_S: Final = 3.0

log = logging.getLogger(__name__)

OpenBundles = Callable[[BundleSet], Opened | GelgateError]
"""From the bundles in use to the new ones; an error where no bundle could be opened at all."""


class BundleStage:
    """`request` by any thread; `take` by the loop; `step` is one turn of the own thread, which a test may call."""

    def __init__(self, open_bundles: OpenBundles) -> None:
        self._open = open_bundles
        self._asked = threading.Event()
        self._is_closing = False
        self._in_use = BundleSet()
        self._ready: Opened | GelgateError | None = None
        self._thread = threading.Thread(target=self._run, name="bundles", daemon=True)

    def start(self) -> None:
        """Begin to wait for requests, in the background."""
        self._thread.start()

    def request(self, in_use: BundleSet) -> None:
        """Open the configured bundles again; those of `in_use` that have not changed are kept as they are."""
        self._in_use = in_use
        self._asked.set()

    def take(self) -> Opened | GelgateError | None:
        """The outcome of the last request, once; None while there is none."""
        ready, self._ready = self._ready, None
        return ready

    def step(self) -> None:
        """Serve a request, if there is one."""
        if not self._asked.is_set():
            return
        self._asked.clear()
        try:
            self._ready = self._open(self._in_use)
        except Exception as error:  # the loop reports it, and the bundles in use stay
            log.exception("the new bundles could not be opened")
            self._ready = GelgateError(f"the new bundles could not be opened ({error!r:.200}); see the log")

    def close(self) -> None:
        """End the thread; one that is opening a bundle is waited for only shortly. May be called again."""
        self._is_closing = True
        self._asked.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while True:
            self._asked.wait()
            if self._is_closing:
                return
            self.step()
