"""The pictures of presses: drawn when their results have left, on a thread of its own, in order."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from edge.background import Background
from edge.core.errors import StoreError
from edge.messaging.result_payload import PressFiles, picture_messages
from edge.store.press_store import Store

__all__ = ["Pictures", "PressDrawing"]

log = logging.getLogger(__name__)

# Pictures that wait, 2 MB each at most: those of all presses that waited for a store that refused, and some more. The
# next start draws those beyond.
MOST_WAITING: Final = 320
CLOSE_S: Final = 3.0


@dataclass(frozen=True)
class PressDrawing:
    """The picture of a press that is recorded."""

    press_id: str
    draw: Callable[[], PressFiles]
    """Returns its pictures. Where it raises, empty ones are published."""

    def draw_now(self) -> "PressDrawing":
        """Draw it now: what waits long then takes the room of a file. Empty where it cannot be drawn."""
        try:
            files = self.draw()
        except Exception as error:  # noqa: BLE001 - whatever it is, those that wait are drawn, and the end is orderly
            log.error("the picture of press %s cannot be drawn: %s", self.press_id, error)
            files = PressFiles()
        return replace(self, draw=lambda: files)


class Pictures:
    """Draws and queues the pictures that are owed. Any thread may add; `step` is a turn of the own thread.

    wake: called when a picture waits to be published. draw_again: draws a press that a stop has left without its
    pictures. keeps_last: that of the newest press of a part is retained.
    """

    def __init__(
        self,
        store: Store,
        wake: Callable[[], None],
        draw_again: Callable[[str], PressFiles] = lambda press_id: PressFiles(),
        *,
        keeps_last: bool = False,
    ) -> None:
        self._store, self._wake, self._draw_again, self._keeps_last = store, wake, draw_again, keeps_last
        self._waiting: deque[PressDrawing] = deque()
        self._drawn: deque[PressDrawing] = deque()
        self._named = ""  # the press whose picture was last said to wait
        self._thread = Background[None]("pictures", CLOSE_S)
        self._turn = threading.Lock()  # of the thread, and of `close` where the thread is still busy

    def start(self) -> None:
        """Begin to draw in the background. Errors: StoreError."""
        self.recall()
        self._thread.start()
        self._thread.ask(self.step)

    def recall(self) -> None:
        """Before others come the pictures that the last stop has prevented, or empty ones. Errors: StoreError."""
        for press_id in self._store.owed_pictures():
            log.warning("the picture of press %s was not drawn before the last stop", press_id)
            self._waiting.append(PressDrawing(press_id, partial(self._draw_again, press_id)))

    def add(self, drawing: PressDrawing) -> None:
        """Draw this after those that wait."""
        if len(self._waiting) + len(self._drawn) >= MOST_WAITING:
            log.error("the picture of press %s is not drawn: %d others wait", drawing.press_id, MOST_WAITING)
            return
        self._waiting.append(drawing)
        self._thread.ask(self.step)

    def retry(self) -> None:
        """Try again what the store has refused: after the last press of a shift no other one would."""
        if self._drawn:
            self._thread.ask(self.step)

    def step(self) -> None:
        """Draw what waits, and queue each at once. What the store refuses goes on waiting, drawn, until the next one,
        a retry or the end."""
        with self._turn:
            is_refused = False
            while self._waiting or (self._drawn and not is_refused):
                if self._waiting:
                    self._drawn.append(self._waiting.popleft().draw_now())
                is_refused = is_refused or not self._queue_oldest()

    def close(self) -> None:
        """Draw what waits, and end the thread. May be called again."""
        self._thread.close()
        self.step()

    def _queue_oldest(self) -> bool:
        """Queue the oldest that is drawn; returns whether others may follow: not where the store refuses it."""
        press_id, files = self._drawn[0].press_id, self._drawn[0].draw()
        try:
            self._store.queue_picture(
                press_id,
                lambda is_newest: picture_messages(press_id, files, is_last=self._keeps_last and is_newest),
                files.deviations.first.model_dump(exclude={"remark"}) if files.deviations else {},
            )
        except StoreError as error:
            if press_id != self._named:
                log.warning("the picture of press %s waits: %s", press_id, error)
            self._named = press_id
            return False
        except Exception as error:  # it stays owed, and keeps no other one waiting
            log.exception("the picture of press %s cannot be queued: %s", press_id, error)
        self._drawn.popleft()
        self._wake()
        return True
