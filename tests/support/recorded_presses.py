"""Presses and their messages, as the gateway records them."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from edge.core.verdict import Kind
from edge.messaging.result_payload import ResultPayload, press_messages
from edge.store.press_store import MakeMessages, PressRecord, Recorded, Store
from edge.store.ulid import new_ulid

SERIAL = "2BNN4ZE7"
T0 = 1_780_000_000 * 10**9  # 2026, a plausible clock


@pytest.fixture
def make_press() -> Callable[..., PressRecord]:
    """The n-th press, one second apart; the id is a function of n."""

    def make(n: int, verdict: str = "pass", serial: str = SERIAL, **fields: object) -> PressRecord:
        time_ns = T0 + n * 10**9
        press_id = new_ulid(time_ns, lambda k: n.to_bytes(k, "big"))
        numbers = {"score": 0.5, "threshold": 1.0} if verdict in ("pass", "fail", "unsure") else {}
        return PressRecord(press_id, time_ns, serial, "bolt", verdict, **{**numbers, **fields})  # type: ignore[arg-type]

    return make


@pytest.fixture
def messages_of() -> Callable[..., MakeMessages]:
    """What the gateway publishes for a press, with a heatmap of the given size."""

    def of(press: PressRecord, heatmap_bytes: int = 100) -> MakeMessages:
        def make(recorded: Recorded) -> object:
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
            return press_messages(result, gel, bytes(heatmap_bytes))

        return make  # type: ignore[return-value]

    return of


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "gelgate.db"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    with Store(path) as opened:
        yield opened
