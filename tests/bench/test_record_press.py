"""What a recorded press costs: one transaction, flushed to disk."""

import sqlite3
import statistics
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from edge.core.verdict import Kind
from edge.messaging.result_payload import ResultPayload, press_messages
from edge.store import ledger_chain
from edge.store.press_store import PressRecord, Recorded, Store
from edge.store.ulid import new_ulid

PRESSES = 300


def median_ms(do: Callable[[int], None]) -> float:
    times = []
    for n in range(PRESSES):
        start = time.perf_counter()
        do(n)
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times)


@pytest.mark.bench
@pytest.mark.parametrize("heatmap_kb", [0, 60, 300])
def test_recording_a_press(tmp_path: Path, heatmap_kb: int) -> None:
    """Prints the median of `record_press`, and its ratio to one bare durable insert of the same bytes."""
    picture = bytes(heatmap_kb * 1000) or None

    def record(n: int) -> None:
        time_ns = time.time_ns()
        press_id = new_ulid(time_ns)

        def messages(recorded: Recorded) -> object:
            gel = recorded.gel
            result = ResultPayload(
                time_ns=time_ns,
                press_id=press_id,
                part="bolt",
                verdict=Kind.PASS,
                score=0.5,
                threshold=1.0,
                sensor_serial=gel.serial,
                gel_id=gel.gel_id,
                gel_presses=gel.presses,
                gel_limit_presses=gel.limit_presses,
            )
            return press_messages(result, gel, picture)

        store.record_press(
            PressRecord(press_id, time_ns, "2BNN4ZE7", "bolt", "pass", None, 0.5, 1.0), messages
        )  # type: ignore[arg-type]

    with Store(tmp_path / "gelgate.db") as store:
        press_ms = median_ms(record)
    bare = sqlite3.connect(tmp_path / "bare.db", isolation_level=None)
    bare.execute("PRAGMA journal_mode = WAL")
    bare.execute("PRAGMA synchronous = FULL")
    bare.execute("CREATE TABLE rows (payload BLOB)")
    bare_ms = median_ms(
        lambda n: bare.execute("INSERT INTO rows VALUES (?)", (picture or bytes(700),)) and None
    )
    bare.close()

    print(
        f"\nrecord_press with a heatmap of {heatmap_kb} kB: median {press_ms:.2f} ms, "
        f"bare durable insert {bare_ms:.2f} ms, ratio {press_ms / bare_ms:.1f}"
    )


@pytest.mark.bench
def test_the_share_of_the_chain(tmp_path: Path) -> None:
    """Prints what the link of one press costs, and its ratio to `record_press`, with its flush to the disk."""

    def record(n: int) -> None:
        time_ns = time.time_ns()
        press = PressRecord(new_ulid(time_ns), time_ns, "2BNN4ZE7", "bolt", "pass", None, 0.5, 1.0)
        store.record_press(press, lambda recorded: [])

    with Store(tmp_path / "gelgate.db") as store:
        press_ms = median_ms(record)
    with closing(sqlite3.connect(tmp_path / "gelgate.db", isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        link_ms = median_ms(lambda n: ledger_chain.append(connection, "press", n + 1) and None)
        connection.execute("ROLLBACK")

    print(f"\nlink {link_ms:.3f} ms, record_press {press_ms:.2f} ms, share {link_ms / press_ms:.1%}")
