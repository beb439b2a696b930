"""Presses and their messages, as the gateway records them."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from edge.core.ports import Message
from edge.core.verdict import Kind
from edge.messaging.result_payload import PressFiles, ResultPayload, picture_messages, press_messages
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import MakeMessages, PressRecord, Recorded, Store
from edge.store.ulid import new_ulid

SERIAL = "2BNN4ZE7"
T0 = 1_780_000_000 * 10**9  # 2026, a plausible clock
PRESS_ID = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
GEL = GelRecord(SERIAL, f"{SERIAL}-1", 801, 1000, 0.8, 0)


def result(**changes: Any) -> ResultPayload:
    """Return the result of a press that passed, with changes."""
    numbers = {"time_ns": 1_769_860_800_000_250_999, "score": 0.5, "threshold": 1.0}
    gel = {"sensor_serial": SERIAL, "gel_id": GEL.gel_id, "gel_presses": 801, "gel_limit_presses": 1000}
    passed = {"press_id": PRESS_ID, "part": "bolt", "verdict": Kind.PASS}
    return ResultPayload(**{**numbers, **gel, **passed, **changes})


def unscored() -> ResultPayload:
    """Return the result of a press that could not be scored."""
    return result(verdict=None, score=None, threshold=None, error="saturated")


def make_press(n: int, verdict: str = "pass", serial: str = SERIAL, **fields: object) -> PressRecord:
    """Make the n-th press, one second after the one before; its id is a function of n."""
    time_ns = T0 + n * 10**9
    press_id = new_ulid(time_ns, lambda k: n.to_bytes(k, "big"))
    numbers = {"score": 0.5, "threshold": 1.0} if verdict in ("pass", "fail", "unsure") else {}
    return PressRecord(press_id, time_ns, serial, "bolt", verdict, **{**numbers, **fields})  # type: ignore[arg-type]


def messages_of(press: PressRecord, heatmap_bytes: int = 100) -> MakeMessages:
    """Return what makes the messages that the gateway publishes for a press, with a heatmap of that size."""

    def make(recorded: Recorded) -> Iterable[Message]:
        gel = recorded.gel
        is_error = press.verdict == "error"
        result = ResultPayload(
            time_ns=press.time_ns,
            press_id=press.press_id,
            part=press.part,
            verdict=None if is_error else Kind(press.verdict),
            error="broken" if is_error else None,
            score=press.score,
            threshold=press.threshold,
            sensor_serial=gel.serial,
            gel_id=gel.gel_id,
            gel_presses=gel.presses,
            gel_limit_presses=gel.limit_presses,
        )
        first, *others = press_messages(result, gel)
        files = PressFiles(b"\xff\xd8" + bytes(heatmap_bytes - 2))
        return [first, picture_messages(press.press_id, files)[-1], *others]

    return make


def record(store: Store, *presses: PressRecord) -> Recorded:
    """Record presses with their messages; return what is known of the last one."""
    last = [store.record_press(press, messages_of(press)) for press in presses][-1]
    store.keep_count(last.gel)
    return last


def count(store: Store, *presses: PressRecord) -> Recorded:
    """Record presses without messages; return what is known of the last one."""
    last = [store.record_press(press, lambda recorded: []) for press in presses][-1]
    store.keep_count(last.gel)
    return last


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "gelgate.db"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    with Store(path) as opened:
        yield opened
