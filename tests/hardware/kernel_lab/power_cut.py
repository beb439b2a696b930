"""Power cuts of a real kernel: the station's files on ext4, at hundreds of moments, beside what the simulator says.

The store, the second count, the archive, the files of gels and the file sink work as in a station, and each promise is
marked in the log of the disk. The simulated disk of docs/simulation.md listens to the same run.
"""

import hashlib
import json
import random
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
from logged_disk import COPY, MARK, Entry, cut_power, logging_writes, mark, mounting
from recorded_presses import SERIAL, T0, make_press, messages_of
from simulation import planted_bugs
from simulation.disk import Disk, hear_audits
from simulation.planted_bugs import Bug
from simulation.power import SECTOR, Name, Unsynced, listening

from edge.core.errors import ArchiveError
from edge.store.backup import migrate
from edge.store.database import quick_check, refuse_left_journal
from edge.store.gel_files import GelFiles
from edge.store.integrity import check_database
from edge.store.outbox import Outbox
from edge.store.press_archive import ArchivedPress, ArchiveFolder, PressArchive, read_archived
from edge.store.press_store import PressRecord, Store
from plugins.sinks import jsonl

FOLDER = Path("/run/station")
PICTURE_BYTES = 6000
COLUMNS = ("press_id", "time_ns", "serial", "part", "verdict", "score", "threshold", "evidence")
BUGS = (
    next(bug for bug in planted_bugs.BUGS if bug.name == "fsync left out"),
    Bug(
        "a line is not synced",
        "plugins/sinks/jsonl.py",
        "                os.fsync(file.fileno())\n            except OSError:\n",
        "                pass\n            except OSError:\n",
        "that was sent is lost",
    ),
)
Losable = dict[int, list[bytes]]
Files = dict[str, tuple[bytes, Losable]]
"""Of each file: its content, and the sectors that a loss of power may take, with what they held before."""


@cache
def archive_nth(number: int) -> tuple[PressRecord, ArchivedPress, dict[str, bytes]]:
    """Make a press with its record and objects; all have one machine, ten in a row one picture of the gel."""
    objects = [random.Random(seed).randbytes(3000) for seed in (number, -1 - number // 10, 0)]
    frame, reference, machine = digests = [hashlib.sha256(data).hexdigest() for data in objects]
    press = make_press(number)
    record = ArchivedPress(
        **{name: getattr(press, name) for name in COLUMNS[:-1]},
        **dict.fromkeys(("position", "revision", "reason", "error", "score_map", "map_shape")),
        station="a/b/c",
        bundle_id="0" * 64,
        threads=1,
        touch=(1.0, 2.0, 3.0),
        machine=machine,
        frame=frame,
        reference=reference,
    )
    return make_press(number, evidence=record.sha256()), record, dict(zip(digests, objects, strict=True))


class StationFiles:
    """The files of a station, opened as `gelgate run` does. Errors: StoreError."""

    def __init__(self, folder: Path) -> None:
        path = folder / "gelgate.db"
        refuse_left_journal(path)
        if path.is_file():
            assert (damage := quick_check(path, lambda: False)) is None, damage
            migrate(path)
        self.store, self.outbox = Store(path), Outbox(path)
        self.outbox._database._connection.execute(
            "PRAGMA wal_autocheckpoint = 60"
        )  # not one in a thousand pages
        self.outbox.register(["file"])
        self.gel = self.store.gel(SERIAL, T0)
        self.archive = PressArchive(folder / "gelgate.archive", 8, 1 << 30)
        self.archive.open(self.store.read("", lambda connection: read_archived(connection, 8)))
        self.gels = GelFiles(folder / "gelgate.references")
        self.sink = jsonl.JsonlSink(folder / "messages", "a/b/c")

    def record(self, number: int) -> None:
        press, _, _ = archive_nth(number)
        self.gel = self.store.record_press(press, messages_of(press, PICTURE_BYTES)).gel

    def keep(self, number: int) -> None:
        """Keep what follows a press that is recorded."""
        self.store.keep_count(self.gel)
        self.archive.keep(*archive_nth(number)[1:])
        self.gels.save(SERIAL, self.gel.gel_id, "scars", np.full((40, 40), number % 251, np.uint8))

    def send(self) -> Iterator[int]:
        """Send what waits; yields the number of each message when the sink has it."""
        for row in self.outbox.pending("file", 1000):
            self.sink.send(row.message)
            yield row.row_id
            self.outbox.acknowledge([row.row_id], "file")

    def close(self) -> None:
        self.outbox.close()
        self.store.close()


class Run:
    """A run of the station on a logged disk. promises: the marks, in order."""

    def __init__(self, presses: int) -> None:
        self.promises: list[str] = []
        self.log: list[Entry] = []
        self.shown: list[tuple[int, Files, list[Name]]] = []
        """What the simulated disk held before each sync and at each mark: the number of marks before, its files, and
        the changes of names that it may lose."""
        self._known: dict[str, tuple[object, tuple[bytes, Losable]]] = {}
        with logging_writes(FOLDER, self.log) as self.first, listening(FOLDER) as unsynced:
            self._disk = Disk(FOLDER)
            self._disk.unsynced, unsynced.at_sync = unsynced, lambda: self._note(unsynced)
            hear_audits(self._disk)
            try:
                self._work(presses, unsynced)
            finally:
                hear_audits(None)

    def _work(self, presses: int, unsynced: Unsynced) -> None:
        station = StationFiles(FOLDER)
        self._promise("opened", unsynced)
        for number in range(1, presses + 1):
            station.record(number)
            self._promise("press", unsynced)
            station.keep(number)
            if number % 3 == 0:
                for _ in station.send():
                    self._promise("sent", unsynced)
        self._promise("end", unsynced)
        station.close()

    def _promise(self, name: str, unsynced: Unsynced) -> None:
        self._note(unsynced)
        mark(name)
        self.promises.append(name)
        self._note(unsynced)

    def _note(self, unsynced: Unsynced) -> None:
        files: Files = {}
        for path in find_files(unsynced.folder):
            name, status = str(path.relative_to(FOLDER)), path.stat()
            synced = unsynced.sectors.get(str(path)) or unsynced.synced.get(status.st_ino)
            state = (status.st_ino, status.st_size, status.st_mtime_ns, id(synced))
            if name.startswith("gelgate.db") or self._known.get(name, (None,))[0] != state:
                data = path.read_bytes()
                before = self._known[name][1][0] if name in self._known else b""
                self._known[name] = state, (before if before == data else data, unsynced.find_losable(path))
            files[name] = self._known[name][1]
        self.shown.append((len(self.promises), files, list(unsynced.names)))


def find_files(folder: Path) -> Iterator[Path]:
    """Find the files of a station that outlive a power cut."""
    return (path for path in folder.rglob("*") if path.is_file() and not path.name.endswith("-shm"))


def audit(folder: Path, promises: Counter[str]) -> Iterator[str]:
    """What must hold after a power cut, in the words of the simulator. promises: how many of each were made before."""
    station = StationFiles(folder)
    try:
        query = f"SELECT {', '.join(COLUMNS)} FROM presses ORDER BY number"
        rows = station.store.read("", lambda connection: connection.execute(query).fetchall())
        made = [archive_nth(number)[0] for number in range(1, len(rows) + 2)]
        if len(rows) < promises["press"]:
            yield f"press {promises['press']} is lost"
        if rows != [tuple(getattr(press, name) for name in COLUMNS) for press in made[:-1]]:
            yield "a press is torn, doubled, or in the place of another one"
        if station.gel.presses != len(rows):
            yield f"the gel has {station.gel.presses} presses, and {len(rows)} rows"
        yield from station.store.findings()
        yield from _audit_messages(
            folder / "messages", station, [press.press_id for press in made[:-1]], promises
        )
        scars = station.gels.load(SERIAL, station.gel.gel_id, "scars", lambda array: array)
        if scars is not None and len({*scars.flat}) != 1:
            yield "the scars are torn"
        station.record(len(made))  # the station goes on
        station.keep(len(made))
        list(station.send())
        archive = ArchiveFolder(folder / "gelgate.archive")
        for digest in archive.press(made[-1].press_id, made[-1].evidence).objects:
            archive.read(digest, "what a press after it was made from")
    except ArchiveError as error:
        yield str(error)
    finally:
        station.close()
    yield from (f.text for f in check_database(folder / "gelgate.db") if f.is_fault)


def _audit_messages(
    folder: Path, station: StationFiles, ids: Sequence[str], promises: Counter[str]
) -> Iterator[str]:
    """What was sent is there, with its picture; what was not sent waits."""
    path = folder / "messages.jsonl"
    whole, _, _ = (path.read_text(errors="replace") if path.exists() else "").rpartition("\n")
    try:
        lines = [json.loads(line) for line in whole.splitlines()]
    except ValueError:
        yield "a line of the file is not JSON"
        return
    pictures = [folder / line["file"] for line in lines if "file" in line]
    if len(lines) < promises["sent"]:
        yield f"a message that was sent is lost: {len(lines)} of {promises['sent']} are there"
    if any(not picture.exists() or picture.stat().st_size != PICTURE_BYTES for picture in pictures):
        yield "a picture that was sent is lost"
    waiting = [row.message for row in station.outbox.pending("file", 1000)]
    results = whole + "".join(message.payload.decode() for message in waiting if message.topic == "result")
    yield from (
        f"the result of press {number} is lost" for number, one in enumerate(ids, 1) if one not in results
    )


def compare(folder: Path, shown: Sequence[tuple[Files, list[Name]]]) -> list[str]:
    """Name the files that are as the simulated disk never has them at these moments."""
    real = {str(path.relative_to(folder)): path.read_bytes() for path in find_files(folder)}
    unlike = ["a name"]
    for files, names in shown:
        files = dict(files)
        for name in (None, *reversed(names)):
            if name is not None:
                _undo(name, files)
            if real.keys() == files.keys():
                wrong = sorted(one for one in real if not _may_be(real[one], *files[one]))
                if not wrong:
                    return []
                unlike = wrong if unlike == ["a name"] else min(unlike, wrong, key=len)
    return unlike


def _undo(name: Name, files: Files) -> None:
    path, new = (str(one.relative_to(FOLDER)) for one in (name.path, name.new))
    if name.event == "os.rename":
        files[path] = files.pop(new)
    elif name.event == "open":
        files.pop(path)
    if name.old is not None:
        files[new] = name.old, name.losable


def _may_be(real: bytes, now: bytes, losable: Losable) -> bool:
    """Tell whether a file may be so: each sector as it was last, or before. A file that is shorter ends in zeros."""
    if len(real) > len(now):
        return False
    real = real.ljust(len(now), b"\0")
    return real == now or all(
        real[start : start + SECTOR].ljust(SECTOR, b"\0")
        in [one.ljust(SECTOR, b"\0") for one in (now[start : start + SECTOR], *losable.get(start, ()))]
        for start in range(0, len(now), SECTOR)
    )


@contextmanager
def planting(bug: Bug) -> Iterator[None]:
    """Plant a bug in a module that is loaded."""
    module = import_module(bug.file.removesuffix(".py").replace("/", "."))
    text = Path(str(module.__file__)).read_text(encoding="utf-8")
    assert text.count(bug.old) == 1, bug.name
    exec(compile(text.replace(bug.old, bug.new), bug.file, "exec"), module.__dict__)
    try:
        yield
    finally:
        exec(compile(text, bug.file, "exec"), module.__dict__)


def _cut(run: Run, cuts: int) -> tuple[Counter[str], Counter[str]]:
    """Cut the power at so many moments; returns what must not be, and the files that the simulator never has so."""
    rng, said, unlike = random.Random(1), Counter[str](), Counter[str]()
    marks = [place for place, entry in enumerate(run.log) if entry.flags & MARK][: len(run.promises)]
    for place in cut_power(run.first, run.log, rng.sample(range(1, marks[-1]), cuts), rng):
        before = sum(one < place for one in marks)
        with mounting(COPY, FOLDER):
            if before:
                unlike.update(compare(FOLDER, [shown for number, *shown in run.shown if number == before]))
            said.update({*audit(FOLDER, Counter(run.promises[:before]))})
    print(f"  {marks[-1]} writes, {len(run.promises)} promises, {cuts} power cuts", flush=True)
    return said, unlike


def check_power_cuts() -> None:
    """After each of 160 power cuts all that was promised is there, and the simulated disk may leave it so."""
    said, unlike = _cut(Run(30), 160)
    assert not said, said
    assert not unlike, f"the simulated disk never leaves so: {unlike}"


def find_planted(bug: Bug) -> None:
    """A bug that the simulated disk shows is found here too."""
    with planting(bug):
        run = Run(9)
    said, _ = _cut(run, 25)
    print(f"  {bug.name}: {dict(said)}")
    assert any(re.search(bug.sentence, sentence) for sentence in said), f"{bug.name}: not found"
