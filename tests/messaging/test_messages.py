"""Payloads: strict, complete, and described by a page that always agrees with them."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from pydantic import ValidationError
from recorded_presses import GEL, PRESS_ID, result

from edge.clock import SystemClock
from edge.core.errors import ConfigError
from edge.core.ports import Message
from edge.core.sink_context import Place, Station, topic_level
from edge.gateway.commands import Change, CommandPolicy, Commands
from edge.messaging.alarm_payload import ALARMS, AlarmPayload, alarm_cleared
from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.deviation_payload import DeviationsPayload
from edge.messaging.payload_base import as_replayed, iso_time
from edge.messaging.result_payload import PressFiles, ResultPayload, picture_messages, press_messages
from edge.messaging.status_payloads import availability_message
from edge.messaging.topics import TOPICS
from edge.store.press_store import Store
from edge.store.ulid import is_ulid, new_ulid

FILES = PressFiles(b"\xff\xd8jpeg", b"\x89PNG\r\n\x1a\n")
MEASURED = DeviationsPayload(time_ns=1, press_id=PRESS_ID, calibration="ball", deviations=[])


def test_the_reference_names_every_topic_a_press_publishes() -> None:
    """The page has the QoS and retention of every topic; so have the description and the availability."""
    said = {topic.replace("<press id>", PRESS_ID): (qos, retained) for topic, qos, retained, *_ in TOPICS}

    own = press_messages(result(), GEL, b"\xff\xd8still")
    described = asyncapi_message(DescribedStation.of_root("gelgate/plant/line/station/gel/v1"))
    about_station = described, availability_message(is_online=True)
    pictures = picture_messages(PRESS_ID, FILES._replace(deviations=MEASURED), is_last=True)
    for message in (*own, *pictures, *about_station):
        assert said[message.topic] == (message.qos, message.retain)


def test_the_reference_has_the_delivery_of_every_payload() -> None:
    """`stats` alone are sent at most once, and with `piece_result` not kept."""
    own = [topic for topic in TOPICS if getattr(topic.payload, "topic", None) == topic.name]
    delivery = {topic.name: (topic.qos, topic.is_retained) for topic in own}

    assert {name for name, how in delivery.items() if how != (1, True)} == {
        "contact",
        "stats",
        "piece_result",
    }
    assert delivery["stats"] == (0, False)


def test_the_time_is_given_three_times_and_agrees() -> None:
    """ISO 8601 UTC in microseconds, nanoseconds, and milliseconds below 2^53, where a double is exact."""
    payload = json.loads(result().encode())

    assert payload["time"] == iso_time(1_769_860_800_000_250_999) == "2026-01-31T12:00:00.000250Z"
    assert payload["time_ms"] == 1_769_860_800_000 < 2**53
    for wrong, words in (
        ({"time": "2026-01-31T12:00:00.000251Z"}, "time_ns says"),
        ({"time_ms": 1}, "time_ms is 1"),
        ({"time_ns": "1"}, "valid integer"),
    ):
        with pytest.raises(ValidationError, match=words):
            result(**wrong)


def test_a_payload_survives_the_wire() -> None:
    """Encoded and read back it is the same value, with its verdict."""
    assert ResultPayload.model_validate_json(result().encode()) == result()


@pytest.mark.parametrize(
    "changes",
    [
        {"verdict": None},
        {"error": "the map has a NaN"},
        {"score": None},
        {"score": float("nan")},
        {"press_id": "1"},
        {"gel_presses": "801"},
        {"colour": "red"},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_result_refuses_nonsense(changes: Mapping[str, object]) -> None:
    """Neither or both of verdict and error, a pass without a score, NaN, a bad id, wrong types, unknown fields."""
    with pytest.raises(ValidationError):
        result(**changes)


def test_a_press_publishes_result_last_and_gel_and_then_its_pictures() -> None:
    """`last` and `last/press` repeat the result byte for byte; the gel has the numbers of its record. Each picture says
    what it is."""
    messages = [*press_messages(result(), GEL), *picture_messages(PRESS_ID, FILES, is_last=True)]

    assert [(m.topic, m.retain, m.content_type.partition("/")[2]) for m in messages] == [
        ("result", False, "json"),
        ("last", True, "json"),
        ("last/press", True, "json"),
        ("gel", True, "json"),
        (f"scoremap/{PRESS_ID}", False, "png"),
        (f"heatmap/{PRESS_ID}", False, "jpeg"),
        ("last/heatmap", True, "jpeg"),
    ]
    assert messages[0].payload == messages[1].payload == messages[2].payload
    assert [message.payload for message in messages[4:]] == [FILES.score_map, FILES.sheet, FILES.sheet]
    assert json.loads(messages[3].payload)["state"] == "due"


@pytest.mark.parametrize(
    ("heatmap_topic", "keeps_heatmap", "is_emptied"),
    [(None, True, True), (f"heatmap/{PRESS_ID}", True, False), (None, False, False)],
)
def test_a_press_without_a_picture_empties_the_retained_one(
    heatmap_topic: str | None, keeps_heatmap: bool, is_emptied: bool
) -> None:
    """Before its own retained result, so that it never shows that of another press; where none is retained, and where
    a picture follows, no message does."""
    said = press_messages(result(heatmap_topic=heatmap_topic), GEL, keeps_heatmap=keeps_heatmap)
    topics = [(m.topic, m.retain and not m.payload) for m in said]

    assert (("last/heatmap", True) in topics[: topics.index(("last/press", False))]) is is_emptied
    assert len(topics) == 4 + is_emptied


def test_being_late_changes_the_mark_alone() -> None:
    """Every other field stays; a payload without the mark stays the same, byte for byte."""
    message = press_messages(result(), GEL)[0]

    late = json.loads(as_replayed(message).payload)

    assert late == {**json.loads(message.payload), "is_replayed": True}
    assert ResultPayload.model_validate_json(as_replayed(message).payload).is_replayed
    for other in (
        *picture_messages(PRESS_ID, FILES),
        Message("state", b'{"state":"ready"}'),
        alarm_cleared("gel"),
    ):
        assert as_replayed(other) == other


def test_alarms_are_known_by_name() -> None:
    """An unknown alarm would never be cleared at the next start, so it cannot be raised."""
    alarm = AlarmPayload(time_ns=0, alarm="gel", text="the gel is due")
    assert "overload" in ALARMS
    assert alarm.message().topic == "alarm/gel"
    assert alarm_cleared("gel").payload == b""
    with pytest.raises(ValueError, match="'gle' is not known"):
        alarm.model_copy(update={"alarm": "gle"}).message()


@pytest.mark.parametrize("level", ["", "two words", "a/b", "a+", "#", "$SYS", "x" * 65, "tab\t", "null\x00"])
def test_topic_levels_are_checked(level: str) -> None:
    """Empty, blank, separators, wildcards, broker-internal names and overlong levels are refused."""
    with pytest.raises(ValueError, match="a topic level has 1 to 64 characters"):
        topic_level(level)


def test_the_root_is_the_four_levels_and_the_version() -> None:
    """As subscribers write it in their filters."""
    root = Place("Werk-Süd", "line_1", "press2").root

    assert root == "gelgate/Werk-Süd/line_1/press2/gel/v1"
    assert Station(root, "x").topic(Message("result", b"")) == f"{root}/result"


def test_ulids_sort_by_time_and_are_canonical() -> None:
    """The specification's example time, and ids that sort as their presses do."""
    assert new_ulid(1469922850259 * 10**6, bytes).startswith("01ARZ3NDEK")
    assert new_ulid(0, bytes) == "0" * 26
    ids = [new_ulid(t * 10**6) for t in range(1000, 2000, 7)]
    assert ids == sorted(ids)
    assert all(map(is_ulid, ids))
    assert not any(
        map(is_ulid, ("", "01ARZ3NDEKTSV4RRFFQ69G5FA", "8" * 26, PRESS_ID.lower(), PRESS_ID[:-1] + "U"))
    )
    with pytest.raises(ValueError, match="48 bits"):
        new_ulid(-1)


HANDLERS = {
    "ping": lambda arguments: Change({"echo": arguments.get("text")}),
    "refuse": lambda arguments: (_ for _ in ()).throw(ConfigError("no bundle is named 'x'")),
    "break": lambda arguments: Change({"number": 1 / 0}),
}


@pytest.mark.parametrize(
    ("verb", "payload", "transaction", "status", "words"),
    [
        ("ping", b'{"transaction":"7","arguments":{"text":"hi"}}', "7", "ok", ""),
        ("ping", b'{"transaction":"7"}', "7", "ok", ""),
        ("pong", b'{"transaction":"7"}', "7", "error", "the command 'pong' is off at this station"),
        ("refuse", b'{"transaction":"7"}', "7", "error", "no bundle is named 'x'"),
        ("break", b'{"transaction":"7"}', "7", "error", "it failed with an internal error"),
        (
            "ping",
            b'{"transaction":"7","arguments":null,"by":1}',
            "7",
            "error",
            "arguments: Input should be an object",
        ),
        (
            "ping",
            b'{"transaction":"7","time_ns":"1"}',
            "7",
            "error",
            "time_ns: Input should be a valid integer",
        ),
        ("ping", b"not json", None, "error", "docs/mqtt.md"),
        ("ping", b'{"arguments":{}}', None, "error", "transaction: Field required"),
        ("ping", b'{"transaction":7}', None, "error", "transaction"),
        ("ping", b"\xff\xfe", None, "error", "docs/mqtt.md"),
        ("ping", b"[" * 100_000, None, "error", "docs/mqtt.md"),
    ],
)
def test_every_request_has_an_answer(
    tmp_path: Path, verb: str, payload: bytes, transaction: str | None, status: str, words: str
) -> None:
    """The transaction comes back; a fault is a sentence in the answer, never an exception."""
    policy = CommandPolicy("root", frozenset(HANDLERS))
    with Store(tmp_path / "gelgate.db") as store:
        answer = json.loads(Commands(HANDLERS, policy, store, SystemClock())(verb, payload))

    assert (answer["transaction"], answer["verb"], answer["status"]) == (transaction, verb, status)
    assert words in (answer["error"] or "")
