"""The rows that one sink refused: each is offered again in its turn, for permissions and limits may be corrected."""

from collections.abc import Sequence
from typing import Final

from edge.core.ports import Clock, Message
from edge.store.outbox import Outbox, OutboxRow

__all__ = ["OFFER_REFUSED_S", "RefusedRows", "kind_of"]

# Refused rows are offered again this often, this number of them at a time. When one is accepted, all rows of its kind
# are offered at once.
OFFER_REFUSED_S: Final = 45.0
OFFERED_ROWS: Final = 16

# A row that causes an unexpected error this often in a row is set aside: it may be damaged, and others wait behind it.
BROKEN_ATTEMPTS: Final = 3


class RefusedRows:
    """What one sink has refused, or cannot send. Its worker calls it, in one thread."""

    def __init__(self, sink: str, outbox: Outbox, clock: Clock) -> None:
        self._sink, self._outbox, self._clock = sink, outbox, clock
        self._offered_ns: int | None = None
        self._offered_up_to = 0  # the last row of the last offer; the next offer begins after it
        self._offered: set[int] = set()  # rows that were refused once and are in the queue again
        self._accepts_again: set[str] = set()  # kinds of message of which a refused one was accepted
        self._broken = (0, 0)  # the row of the last unexpected error, and the number of its errors
        self._was_broken: set[int] = set()  # rows that were set aside for such errors

    @property
    def is_urgent(self) -> bool:
        """True where a kind of message is accepted again: its rows are offered with the next call."""
        return bool(self._accepts_again)

    def offer(self) -> int | None:
        """Queue the rows again that are due; returns the first of them, None for none. Errors: StoreError."""
        rows: list[int] = []
        for kind in self._accepts_again:
            rows += self._note(self._outbox.offer_refused(self._sink, kind=kind))
        self._accepts_again.clear()
        now_ns = self._clock.monotonic_ns()
        if self._offered_ns is None or now_ns - self._offered_ns >= OFFER_REFUSED_S * 1e9:
            again = self._outbox.offer_refused(self._sink, OFFERED_ROWS, after=self._offered_up_to)
            self._offered_up_to = again[-1] if len(again) == OFFERED_ROWS else 0
            self._offered_ns = now_ns
            rows += self._note(again)
        return min(rows, default=None)

    def set_aside(self, row: OutboxRow, why: str) -> None:
        """Keep a row that is not sent until it is offered again. Errors: StoreError."""
        self._outbox.refuse(row.row_id, self._sink, why)
        self._offered.discard(row.row_id)

    def accept(self, row: OutboxRow) -> None:
        """Take a row that the sink has accepted."""
        if row.row_id in self._offered:
            self._offered.discard(row.row_id)
            self._accepts_again.add(kind_of(row.message))

    def is_damaged(self, row: OutboxRow) -> bool:
        """Count an unexpected error on this row, and say whether it is to be set aside."""
        number = self._broken[1] + 1 if self._broken[0] == row.row_id else 1
        self._broken = (row.row_id, number)
        if number < BROKEN_ATTEMPTS and row.row_id not in self._was_broken:
            return False
        self._was_broken.add(row.row_id)
        return True

    def _note(self, rows: Sequence[int]) -> Sequence[int]:
        self._offered.update(rows)
        return rows


def kind_of(message: Message) -> str:
    """Return the first level of a topic: messages of one kind are allowed or forbidden together."""
    return message.topic.partition("/")[0]
