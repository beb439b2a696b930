"""A gateway that is killed between any two writes of a press, and started again."""

import json
import multiprocessing
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import killed_gateway
from station import Motion, press_recording, station_config

from edge.store.history import HistoryQuery, read_history
from edge.store.press_store import Store

# Every process is forked from one that has done the imports: they cost more than a press.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["killed_gateway"])


def live(config: Path, deadly: int) -> tuple[int | None, int]:
    """Let one process live; return its exit code, and how many presses are recorded since the first life."""
    process = PROCESSES.Process(target=killed_gateway.main, args=(config, deadly))
    process.start()
    process.join(300)
    with Store(config.parent / "gelgate.db") as store:
        return process.exitcode, len(list(read_history(store.path, HistoryQuery())))


def test_each_press_arrives_exactly_once_by_id_and_the_ledger_agrees(tmp_path: Path, bundle: Path) -> None:
    """Killed at each of its writes in turn, then left to finish: no press is lost, doubled or counted twice."""
    recording = press_recording(tmp_path / "presses", 1, motion=Motion(free=28, hold=8, idle=2))
    config = station_config(tmp_path / "station", recording, bundle)
    assert live(config, 0) == (0, 1)
    # The acknowledgements of the later messages are like those of the first.
    writes = min(int((config.parent / "writes").read_text()), 19)
    assert writes >= 10
    # A run that lives has made fewer writes than the one that they were counted in: rows of the first life are settled.
    ends = [(0, 1), *(live(config, write) for write in range(1, writes + 1)), live(config, 0)]

    seen: dict[str, set[str]] = defaultdict(set)
    for line in map(json.loads, (config.parent / "out/messages.jsonl").read_text().splitlines()):
        if line["topic"] == "result":
            content = line["payload"] | {"is_replayed": None}
            seen[content["press_id"]].add(json.dumps(content))
    with Store(config.parent / "gelgate.db") as store:
        assert set(seen) == {press.press_id for press in read_history(store.path, HistoryQuery())}
        assert sum(gel.presses for gel in store.gels()) == len(seen)
    assert all(len(contents) == 1 for contents in seen.values())
    codes, recorded = zip(*ends, strict=True)
    assert set(codes) == {0, killed_gateway.KILLED}
    assert codes.count(killed_gateway.KILLED) >= writes - 4
    assert codes[-1] == 0
    assert {later - earlier for earlier, later in pairwise(recorded)} == {0, 1}, (
        "killed before its row, and after"
    )
