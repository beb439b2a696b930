"""A gateway that is killed after any of its writes of a press, and started again.

A kill leaves the files as they are: before each COMMIT and each write to the file sink of a first life they are copied,
and a second life goes on with the copy; what was not committed is gone. tests/support/soak.py kills processes.
"""

import json
import shutil
import sqlite3
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from station import JSONL, Motion, press_recording, station_config, two_parts
from stepped_station import SteppedStation

from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database
from edge.store.press_store import Store

# The acknowledgements of the later messages are like those of the first.
KILLS = 8


class Kills:
    """Copies the files of a station before each commit and write once something has pressed. The shared memory of the
    journal is none of them: SQLite makes it again where no other process has the file."""

    def __init__(self, station: Path, copies: Path) -> None:
        self.is_armed = False
        self.folders: list[Path] = []
        self._station, self._copies = station, copies
        self._connect, self._open = sqlite3.connect, Path.open

    def open(self, path: Path, *arguments: Any, **options: Any) -> Any:
        if path.name == "messages.jsonl":
            self.copy()
        return self._open(path, *arguments, **options)

    def connect(self, *arguments: object, **options: object) -> sqlite3.Connection:
        connection: sqlite3.Connection = self._connect(*arguments, **options)  # type: ignore[call-overload]
        connection.set_trace_callback(lambda sql: self.copy() if sql == "COMMIT" else None)
        return connection

    def copy(self) -> None:
        if self.is_armed and len(self.folders) < KILLS:
            folder = self._copies / f"{len(self.folders):02d}"
            shutil.copytree(self._station, folder, ignore=shutil.ignore_patterns("*-shm"))
            self.folders.append(folder)


def live(config: Path, kills: Kills | None = None) -> None:
    """Play the recording to its end, and publish. Kills come from the first press of the second place on."""
    with SteppedStation(config) as station:
        while not station.has_ended:
            station.play(1)
            if kills is not None and station.loop.is_pressed:
                kills.is_armed |= station.parts.selection.part.part == "PZ1"
            station.publish()


def kill(configure: Callable[[Path], Path], folder: Path) -> list[Path]:
    """Kill a station after each write of its second press; the folders in which it was killed."""
    first = configure(folder / "station")
    kills = Kills(first.parent, folder / "killed")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sqlite3, "connect", kills.connect)
        patched.setattr(Path, "open", lambda path, *given, **options: kills.open(path, *given, **options))
        live(first, kills)
    assert len(kills.folders) == KILLS
    return kills.folders


PLAN = """
[piece]
order = "fixed"
places = [{ part = "PZ0", position = "pos1" }, { part = "PZ1", position = "pos1" }]
"""


def test_each_press_and_each_piece_arrives_exactly_once_and_the_ledger_agrees(
    tmp_path: Path, bundle: Path
) -> None:
    """Killed before each commit of the last press of a piece: no press is lost, doubled or counted twice, and the piece
    is over before, or goes on where it was, and the next one is another piece."""
    recording = press_recording(tmp_path / "presses", 2, motion=Motion(free=28, hold=8))
    bundles = two_parts(tmp_path / "bundles", bundle)

    def config(folder: Path) -> Path:
        sinks = f'{JSONL % (folder / "out")}\nname = "line"'
        return station_config(folder, recording, bundles, sinks=sinks, tables=PLAN)

    recorded, ended = [], []
    for folder in kill(config, tmp_path):
        live(config(folder))
        seen: dict[str, set[str]] = defaultdict(set)
        results: dict[str, str] = {}
        for line in map(json.loads, (folder / "out/messages.jsonl").read_text().splitlines()):
            content = line.get("payload", {})
            if line["topic"] == "result":
                seen[content["press_id"]].add(json.dumps(content | {"is_replayed": None}))
            elif line["topic"] == "piece_result":
                results[content["piece_id"]] = content["verdict"]
        with Store(folder / "gelgate.db") as store:
            assert set(seen) == {press.press_id for press in read_history(store.path, HistoryQuery())}
            assert sum(gel.presses for gel in store.gels()) == len(seen)
            query = "SELECT piece_id, verdict FROM pieces"
            rows = store.read("reading", lambda it: it.execute(query).fetchall())  # noqa: B023
        assert all(len(contents) == 1 for contents in seen.values())
        assert results == {piece_id: verdict for piece_id, verdict in rows if verdict is not None}
        assert check_database(folder / "gelgate.db") == []
        recorded.append(len(seen))
        ended.append([verdict for _, verdict in rows])
    assert recorded == sorted(recorded)
    assert set(recorded) == {3, 4}, "killed before its row, and after"
    assert ended[0] == ["pass", None], (
        "its second press was lost, and the first of the next life completed it"
    )
    assert ended[-1] == ["pass", "pass"], "it was over, and the next life made another one"
    assert {str(verdicts) for verdicts in ended} == {str(ended[0]), str(ended[-1])}
