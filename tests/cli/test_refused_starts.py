"""`gelgate run` and `gelgate check` with one part broken: a sentence, the documented exit code, no traceback.

Each sentence names the thing, what was found, what was expected, and what to do.
"""

import socket
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
import tiny
from breakable_station import JSONL, Bench
from command_line import gelgate
from small_recordings import write_recording
from sql import execute

from edge.store.database import APPLICATION_ID
from plugins.devices.uvc.lock import SensorLock


def nothing(bench: Bench) -> Path:
    return bench.folder / "absent.toml"


def broken_toml(bench: Bench) -> Path:
    path = bench.config()
    path.write_text("version = 1\n[device\n")
    return path


def two_slips(bench: Bench) -> Path:
    path = bench.config()
    path.write_text(
        path.read_text().replace("threads = 1", "thread = 1").replace("version = 1", "version = 7")
    )
    return path


def changed_head(bench: Bench) -> Path:
    head = bench.bundle("changed") / "head.onnx"
    head.write_bytes(head.read_bytes()[:-1] + b"?")
    return bench.config(bundle="changed")


def another_sensor(bench: Bench) -> Path:
    bench.bundle("wide", (96, 40))
    return bench.config(bundle="wide")


def cut_recording(bench: Bench) -> Path:
    write_recording(bench.folder / "cut", 3, size=tiny.PROFILE.size)
    (bench.folder / "cut/frames/000001.jpg").unlink()
    return bench.config(recording="cut")


def garbage(bench: Bench) -> Path:
    (bench.folder / "garbage.db").write_bytes(b"not a database at all" * 400)
    return bench.config(database="garbage.db")


def newer(bench: Bench) -> Path:
    database(bench.folder / "newer.db", APPLICATION_ID, 99)
    return bench.config(database="newer.db")


def foreign(bench: Bench) -> Path:
    database(bench.folder / "foreign.db", 0, 0)
    return bench.config(database="foreign.db")


def damaged(bench: Bench) -> Path:
    """A database of ours in which the page of presses was overwritten."""
    from edge.store.press_store import Store

    path = bench.folder / "damaged.db"
    Store(path).close()
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'presses'").fetchone()
    content = bytearray(path.read_bytes())
    content[(page - 1) * 4096 : page * 4096] = b"\xa5" * 4096
    path.write_bytes(content)
    return bench.config(database="damaged.db")


def database(path: Path, application: int, version: int) -> None:
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE things (name TEXT)")
    connection.execute(f"PRAGMA application_id = {application}")
    connection.execute(f"PRAGMA user_version = {version}")
    connection.close()


def impossible_count(bench: Bench) -> Path:
    """The row of the mounted gel was changed by hand."""
    from edge.store.press_store import Store

    path = bench.folder / "edited.db"
    with Store(path) as store:
        store.gel("TEST0001", 10**18)
    execute(path, "UPDATE gels SET presses = -5, limit_presses = 0")
    return bench.config(database="edited.db")


def mqtt(options: str) -> Callable[[Bench], Path]:
    return lambda bench: bench.config(sink=f'plugin = "mqtt"\noptions = {{ {options} }}')


REFUSED: dict[str, tuple[Callable[[Bench], Path], int, tuple[str, ...]]] = {
    "no configuration": (nothing, 3, ("absent.toml", "does not exist", "gelgate check --example")),
    "broken TOML": (broken_toml, 3, ("gelgate.toml", "cannot be read", "at line 2", "gelgate check --example")),
    "two slips": (two_slips, 3, ("2 fault(s)", "'version' is 7", "did you mean 'threads'?")),
    "unknown device": (
        lambda bench: bench.config(device="usb_moc"), 3, ("'device.plugin'", "did you mean 'usb_mock'?"),
    ),
    "unknown sink": (
        lambda bench: bench.config(sink=JSONL.replace('"jsonl"', '"jsnl"')),
        3, ("'sinks.0.plugin'", "did you mean 'jsonl'?"),
    ),
    "no bundle": (
        lambda bench: bench.config(bundle="absent"), 3, ("no bundle at", "absent", "make one with `gelgate fit`"),
    ),
    "wrong hash": (changed_head, 3, ("head.onnx has SHA-256", "copy the complete bundle again")),
    "another sensor's bundle": (
        another_sensor, 3, ("sends 48x40", "made from 96x40", "use a bundle made for this sensor's mode"),
    ),
    "no sensor": (
        lambda bench: bench.config(device="recorded", recording="absent"), 4,
        ("no sensor for device 'recorded'", "absent does not exist", "gelgate record"),
    ),
    "no recording behind the virtual sensor": (
        lambda bench: bench.config(recording="absent"), 3, ("absent does not exist", "gelgate record"),
    ),
    "a recording that lacks a frame": (cut_recording, 3, ("cut lacks 1 of its 3 frame files", "000001.jpg")),
    "no folder for the database": (
        lambda bench: bench.config(database="absent/gelgate.db"), 3, ("store.path", "absent does not exist; make it"),
    ),
    "a folder in the database's place": (
        lambda bench: bench.config(database="presses"), 3, ("store.path", "presses is a folder; name a file"),
    ),
    "no database": (garbage, 1, ("garbage.db", "file is not a database", "name another file")),
    "a damaged database": (damaged, 1, ("damaged.db is damaged (", "move it away with its -wal")),
    "a newer database": (newer, 1, ("newer.db has schema version 99", "knows up to", "use the newer gelgate")),
    "another program's database": (foreign, 1, ("foreign.db belongs to another program", "name another file")),
    "a gel that was pressed less than never": (
        impossible_count, 1, ("TEST0001-1 of sensor TEST0001 has -5 of 0 presses", "gelgate gel replace"),
    ),
    "no such host": (
        mqtt('host = "broker.invalid"'), 3, ("'broker.invalid' is not known", "correct sinks.0.options.host"),
    ),
    "no password file": (
        mqtt('host = "localhost", username = "u", password_file = "absent"'), 3, ("password file", "absent"),
    ),
    "no TLS files": (mqtt('host = "localhost", tls = { ca = "absent.pem" }'), 3, ("TLS files", "absent.pem")),
    "a port beyond all ports": (mqtt("port = 70000"), 3, ("'sinks.0.options.port' is 70000", "65535")),
}  # fmt: skip


@pytest.fixture
def no_such_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name server without `.invalid` names (RFC 6761), also on a machine that has none."""
    look_up = socket.getaddrinfo

    def answered(host: object, *rest: object, **more: object) -> object:
        if str(host).endswith(".invalid"):
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        if str(host).endswith(".test"):
            raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")
        return look_up(host, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(socket, "getaddrinfo", answered)


@pytest.mark.usefixtures("no_such_host")
@pytest.mark.parametrize(("break_part", "code", "words"), REFUSED.values(), ids=REFUSED)
def test_a_start_is_refused_in_a_sentence(
    bench: Bench, break_part: Callable[[Bench], Path], code: int, words: tuple[str, ...]
) -> None:
    """One fault, one sentence that says what to do, one exit code, and nothing was inspected."""
    ended = gelgate("run", "--config", break_part(bench))

    assert ended.code == code, ended.err
    sentence = ended.sentence()
    assert [word for word in words if word not in sentence] == [], sentence
    assert ended.out == ""


@pytest.mark.usefixtures("no_such_host")
def test_check_tells_every_fault_at_once(bench: Bench) -> None:
    """Bundle, sensor, database and broker are wrong together: four lines, and the first one's exit code."""
    config = bench.config(
        device="recorded", recording="absent", bundle="absent", database="absent/x.db",
        sink='plugin = "mqtt"\noptions = { host = "broker.invalid" }',
    )  # fmt: skip
    ended = gelgate("check", "--config", config)

    assert ended.code == 3
    assert [line.split(":")[0] for line in ended.out.splitlines()] == [
        "ok     configuration",
        *("FAULT  bundle", "FAULT  sensor", "FAULT  database", "ok     commands", "ok     pictures"),
        "FAULT  sink mqtt",
    ]
    assert ended.sentence() == "4 of 6 checks failed; see above"


@pytest.mark.usefixtures("no_such_host")
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ('host = "broker.test"', "broker.test cannot be looked up now"),
        ('host = "127.0.0.1", port = 1', "127.0.0.1:1 does not answer"),
    ],
)
def test_a_broker_that_is_away_is_no_fault(bench: Bench, options: str, words: str) -> None:
    """A plant that comes up has neither name server nor broker at first: the gateway starts, results wait."""
    ended = gelgate("check", "--config", mqtt(options)(bench))

    assert ended.code == 0, ended.out
    assert words in ended.out
    assert "results will wait in the outbox" in ended.out


def test_a_sound_station_passes(bench: Bench) -> None:
    """The station of these tests works before a part is broken."""
    ended = gelgate("check", "--config", bench.config())

    assert (ended.code, ended.err) == (0, "")
    assert "FAULT" not in ended.out


def test_two_gateways_on_one_sensor(bench: Bench) -> None:
    """The second one is refused with the number of the process that has the sensor."""
    held = SensorLock(f"virtual-{(bench.folder / 'presses').resolve()}"[-200:])
    try:
        ended = gelgate("run", "--config", bench.config())
    finally:
        held.close()

    assert ended.code == 4
    assert "in use by process" in ended.sentence()
    assert "stop it, or choose another sensor" in ended.sentence()
