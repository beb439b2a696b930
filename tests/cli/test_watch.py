"""`gelgate watch`: one line per verdict, each press once, heatmaps on disk."""

import json
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from real_brokers import require

from edge.cli.watch import watch as watch_command
from edge.clock import ManualClock
from edge.core.ports import Message
from edge.core.printable import printable
from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from edge.messaging.subscriber import Seen, describe, station_filter, watch

ROOT = "gelgate/plant/line1/press2/gel/v1"
IDS = [f"01ARZ3NDEKTSV4RRFFQ69G5FA{letter}" for letter in "ABCDEF"]


@pytest.fixture
def broker(request: pytest.FixtureRequest) -> Iterator[LocalBroker]:
    """mosquitto, or the one that a test names."""
    kind = getattr(request, "param", "mosquitto")
    require(kind)
    with LocalBroker(kind) as running:
        yield running


each_broker = pytest.mark.parametrize(
    "broker", ["mosquitto", pytest.param("amqtt", marks=pytest.mark.lab)], indirect=True
)


def speaks(broker: LocalBroker, client_id: str) -> Broker:
    return Broker(broker.host, broker.port, client_id, level=broker.level, timeout_s=60.0)


def result(n: int, **changes: object) -> bytes:
    content: dict[str, object] = {
        "press_id": IDS[n],
        "time": "2026-01-31T12:00:00.000250Z",
        "time_ns": 1_769_860_800_000_250_000,
        "part": "bolt",
        "verdict": "fail",
        "score": 2.5,
        "threshold": 1.0,
        "gel_presses": 12,
        "gel_limit_presses": 1000,
        "latency_ms": {"total": 31.26},
        "heatmap_topic": f"heatmap/{IDS[n]}",
        "is_replayed": False,
    }
    return json.dumps({**content, **changes}).encode()


def speak(broker: LocalBroker, *messages: tuple[str, bytes]) -> Callable[[], None]:
    """Publishes the messages as soon as the watcher's subscription is there: its first retained message says so."""
    speaker = Connection.open(speaks(broker, "speaker"))
    speaker.publish(Message(f"{ROOT}/state", b'{"state":"ready"}', retain=True))

    def run() -> None:
        for topic, payload in messages:
            speaker.publish(Message(f"{ROOT}/{topic}", payload))
        speaker.close()

    return run


def listen(
    broker: LocalBroker, run: Callable[[], None], **options: object
) -> list[tuple[str, dict[str, object]]]:
    """What the watcher gives; `run` is called in a thread once the watcher has heard the retained state."""
    address = Broker(broker.host, broker.port, "watcher")
    heard = []
    speaker = threading.Thread(target=run)
    for seen in watch(address, station_filter("gelgate"), timeout_s=60, **options):  # type: ignore[arg-type]
        if seen.kind == "state" and not speaker.ident:
            speaker.start()
        heard.append((seen.kind, dict(seen.content)))
    speaker.join()
    return heard


@each_broker
def test_each_press_is_given_once_and_its_picture_is_saved(broker: LocalBroker, tmp_path: Path) -> None:
    """A repeated result is left out; the watch ends after the last wanted press's picture, which may be empty. No other
    topic is a file."""
    run = speak(
        broker,
        ("heatmap/../../escape", b"x"),
        ("heatmap/escape", b"x"),
        ("result", result(0)),
        (f"heatmap/{IDS[0]}", b"\x89PNG\r\n\x1a\n0"),
        ("result", result(0, is_replayed=True)),
        ("result", result(1)),
        (f"heatmap/{IDS[1]}", b"\xff\xd81"),
        ("result", result(2)),
        ("result", result(3)),
        (f"heatmap/{IDS[2]}", b""),
        ("state", b'{"state":"halted"}'),
    )

    heard = listen(broker, run, save=tmp_path / "maps", count=3)

    assert [content["press_id"] for kind, content in heard if kind == "result"] == IDS[:3]
    assert heard[-1] == ("heatmap", {"press_id": IDS[2], "path": None})
    assert {path.name: path.read_bytes() for path in (tmp_path / "maps").iterdir()} == {
        f"{IDS[0]}.png": b"\x89PNG\r\n\x1a\n0",
        f"{IDS[1]}.jpg": b"\xff\xd81",
    }
    assert not list(tmp_path.rglob("*escape*"))


def test_the_latest_presses_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of more presses than are remembered the oldest is forgotten, and given again."""
    heard = [Received(f"{ROOT}/result", result(n), 1, retain=False) for n in (0, 1, 1, 0, 2, 2, 1, 0)]
    monkeypatch.setattr("edge.messaging.subscriber.REMEMBERED", 2)
    monkeypatch.setattr("edge.messaging.subscriber._receive", lambda *arguments: iter(heard))

    given = [seen.content["press_id"] for seen in watch(Broker("", 0, ""), "")]

    assert given == [IDS[n] for n in (0, 1, 2, 0)]


def test_results_that_did_not_come_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a connection that was lost: a station numbers its results. What comes late, again, or of a station that
    gives no number is no gap."""
    numbers = [7, 8, 8, 10, 9, 10, 14, None, True, "x", 15]
    ids = [f"01ARZ3NDEKTSV4RRFFQ69G5F{n:02}" for n in range(len(numbers))]
    heard = [
        Received(f"{ROOT}/result", result(0, press_id=one, sequence=n), 1, retain=False)
        for one, n in zip(ids, numbers, strict=True)
    ]
    told = list[str]()
    monkeypatch.setattr("edge.messaging.subscriber._receive", lambda *arguments: iter(heard))
    assert len(list(watch(Broker("", 0, ""), "", tell=told.append))) == len(numbers)
    assert [sentence.partition(": ")[2] for sentence in told] == [
        "1 result between 8 and 10 did not come here; its `gelgate history` has them",
        "3 results between 10 and 14 did not come here; its `gelgate history` has them",
    ]


def test_what_cannot_be_read_is_told_and_left_out(broker: LocalBroker) -> None:
    """Anybody in the plant may publish garbage: it ends nothing. A cleared alarm is no news."""
    bad = [
        {"press_id": [1]}, {"press_id": {}}, {"press_id": None}, {"press_id": "x"},
        {"score": "high", "threshold": 1.0}, {"score": 1.0, "threshold": [1]}, {"score": 10**400, "threshold": 1.0},
        {"latency_ms": [1]}, {"latency_ms": {"total": "fast"}}, {"latency_ms": "fast"},
    ]  # fmt: skip
    payloads = [b"\xff", b"[]", b"{}", b"[" * 100_000, *(result(0, **fields) for fields in bad)]
    messages: list[str] = []
    run = speak(
        broker,
        *(("result", payload) for payload in payloads),
        ("alarm/gel", b""),
        ("alarm/gel", b'{"alarm":"gel","text":"due"}'),
        ("result", result(3)),
    )

    heard = listen(broker, run, count=1, tell=messages.append)

    assert [kind for kind, _ in heard] == ["state", "alarm", "result"]
    assert heard[-1][1]["press_id"] == IDS[3]
    assert len([sentence for sentence in messages if "cannot be read" in sentence]) == len(payloads)


@each_broker
def test_a_broker_that_goes_away_is_waited_for(broker: LocalBroker) -> None:
    """The watch reports it, reconnects and continues; a press received before is not repeated."""
    messages: list[str] = []
    address = speaks(broker, "watcher")
    speak(broker)()
    heard = []
    for seen in watch(address, station_filter("gelgate"), count=1, timeout_s=60, tell=messages.append):
        heard.append(seen.kind)
        if heard == ["state"]:
            broker.stop(signal.SIGKILL)
            broker.start()
            speak(broker)()
        elif heard == ["state", "state"]:  # of the second broker, or twice of the first
            # Retained: it may be said before the watcher listens again.
            speaker = Connection.open(speaks(broker, "speaker"))
            speaker.publish(Message(f"{ROOT}/result", result(0, heatmap_topic=None), retain=True))
            speaker.close()

    assert heard[-1] == "result"
    assert any("is lost" in sentence for sentence in messages)
    assert any("again" in sentence for sentence in messages)


def test_a_broker_that_stays_away_is_waited_for_until_the_end(
    broker: LocalBroker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watch ends when its time is over, and says each failed attempt."""
    clock, told = ManualClock(), list[str]()
    passing = SimpleNamespace(monotonic=lambda: clock.monotonic_ns() / 1e9, sleep=lambda _: clock.sleep(25))
    monkeypatch.setattr("edge.messaging.subscriber.time", passing)

    def tell(sentence: str) -> None:
        told.append(sentence)
        assert len(told) < 9

    speak(broker)()
    for _ in watch(speaks(broker, "watcher"), station_filter("gelgate"), timeout_s=60, tell=tell):
        broker.stop(signal.SIGKILL)

    assert ["trying again" in sentence for sentence in told] == [False, True, True, True, True]


@pytest.mark.usefixtures("tokyo")
def test_a_line_says_what_a_person_wants_to_know() -> None:
    """When, where, what, by how much, the gel, the time it took, and whether it is late."""
    line = describe(json.loads(result(0, is_replayed=True, position="top")), "gelgate/plant/line1/press2")

    assert line == (
        "2026-01-31 21:00:00+09:00  gelgate/plant/line1/press2  bolt  top  FAIL  score 2.5 > 1"
        "  gel 12/1000  31.3 ms  (late)"
    )
    assert describe({"time_ns": 1 << 70}, "s") == "?  s  ?  ERROR  gel ?/?"


@pytest.mark.parametrize(
    ("changes", "has", "has_not"),
    [
        (
            {"verdict": None, "score": None, "error": "saturated", "latency_ms": {}},
            "ERROR  saturated  gel 12/1000",
            "ms",
        ),
        (
            {"cause": "gel", "cause_text": "the free gel shows a mark"},
            "cause gel: the free gel shows a mark",
            "late",
        ),
        ({}, "FAIL", "cause"),
        # A reason that clears the screen or sets the title is shown and not obeyed.
        ({"reason": "\x1b]0;owned\x07\x1b[2J\u009b"}, "\\x1b]0;owned\\x07", "\x1b"),
        ({"reason": "\u009b2J"}, "2J", "\u009b"),
    ],
)
def test_a_line_is_complete_and_harmless(changes: dict[str, object], has: str, has_not: str) -> None:
    """What there is no value for is left out."""
    line = printable(describe(json.loads(result(0, **changes)), "s"))

    assert has in line
    assert has_not not in line


def test_the_command_prints_json_and_counts(broker: LocalBroker, capsys: pytest.CaptureFixture[str]) -> None:
    """`--json` prints each result as it came, and nothing else on stdout."""
    retained = Connection.open(speaks(broker, "keeper"))
    retained.publish(Message(f"{ROOT}/result", result(0), retain=True))
    retained.close()

    watch_command(host=broker.host, port=broker.port, as_json=True, count=1, timeout=60)

    assert json.loads(capsys.readouterr().out)["press_id"] == IDS[0]


def test_too_few_verdicts_in_time_fail(broker: LocalBroker, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 1 and a sentence with both numbers."""
    with pytest.raises(typer.Exit) as ended:
        watch_command(host=broker.host, port=broker.port, count=3, timeout=0.2)

    assert ended.value.exit_code == 1
    said = capsys.readouterr().err
    assert f", topics {station_filter('gelgate')}" in said
    assert "no station is heard; check the names" in said
    assert "0 verdict(s) arrived in 0.2 s, expected 3" in said


def test_pictures_that_a_broker_denies_are_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once some are missing, and at the end; an empty one has come."""
    came = [*range(12), "heatmap", *range(3)]
    heard = [
        Seen("heatmap", "press2", {"press_id": IDS[0], "path": None})
        if what == "heatmap"
        else Seen("result", "press2", json.loads(result(0, sequence=what)))
        for what in came
    ]
    monkeypatch.setattr("edge.cli.watch.listen", lambda *_: iter(heard))

    watch_command(save=tmp_path)
    watch_command()

    said = [line for line in capsys.readouterr().err.splitlines() if "did not come" in line]
    assert said == [
        f"gelgate: {number} heatmaps did not come; the broker's rules must let this user read heatmap/+"
        for number in (8, 14)
    ]


def validated(broker: LocalBroker, count: int, *messages: tuple[str, bytes]) -> None:
    """Run `gelgate watch --validate` on these retained messages."""
    speaker = Connection.open(speaks(broker, "speaker"))
    for topic, payload in messages:
        speaker.publish(Message(f"{ROOT}/{topic}", payload, retain=True))
    speaker.close()
    watch_command(host=broker.host, port=broker.port, count=count, timeout=60, validate=True)


DOCUMENT = asyncapi_message(DescribedStation.of_root(ROOT)).payload


def test_messages_are_checked_as_described(broker: LocalBroker, capsys: pytest.CaptureFixture[str]) -> None:
    """What is wrong is named by its topic and not shown raw; the exit code says so too."""
    validated(broker, 2, ("asyncapi", DOCUMENT), ("availability", b"online"))
    assert capsys.readouterr().out == "2 messages checked, 0 not as described\n"
    with pytest.raises(typer.Exit) as end:
        validated(broker, 2, ("availability", b"\x1b[31mred"))

    said = capsys.readouterr().out
    assert end.value.exit_code == 1
    assert f"{ROOT}/availability: $:" in said
    assert "\x1b[31m" not in said
    assert said.endswith("2 messages checked, 1 not as described\n")


def test_an_undescribed_station_is_named(broker: LocalBroker, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing was checked, and the sentence says why."""
    speaker = Connection.open(speaks(broker, "speaker"))
    speaker.publish(Message(f"{ROOT}/availability", b"online", retain=True))
    speaker.close()

    said, timeout = "", 0.3
    while "not checked" not in said and timeout < 60:  # a busy machine hears nothing in a short time
        with pytest.raises(typer.Exit):
            watch_command(host=broker.host, port=broker.port, timeout=timeout, validate=True)
        said, timeout = capsys.readouterr().out, 3 * timeout

    assert "gelgate/plant/line1/press2: 1 message not checked, its topic asyncapi is empty" in said
