"""Payloads: strict, complete, and described by a page that always agrees with them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from edge.clock import SystemClock
from edge.core.defects import Defect
from edge.core.errors import ConfigError
from edge.core.ports import Message
from edge.core.sink_context import Station, topic_root
from edge.core.verdict import Kind
from edge.gateway.command_policy import CommandPolicy
from edge.gateway.commands import Change, Commands
from edge.messaging.alarm_payload import ALARMS, AlarmPayload, alarm_cleared, alarm_message
from edge.messaging.payload_base import as_replayed, iso_time
from edge.messaging.result_payload import DefectPlace, ResultPayload, heatmap_message, press_messages
from edge.messaging.status_payloads import StatePayload
from edge.messaging.topics import TOPICS
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import Store
from edge.store.ulid import is_ulid, new_ulid

PRESS_ID = "01ARZ3NDEKTSV4RRFFQ69G5FAV"
GEL = GelRecord("2BNN4ZE7", "2BNN4ZE7-1", 801, 1000, 0.8, 0)


def result(**changes: object) -> ResultPayload:
    fields: dict[str, Any] = {
        "time_ns": 1_769_860_800_000_250_999,
        "press_id": PRESS_ID,
        "part": "bolt",
        "verdict": Kind.PASS,
        "score": 0.5,
        "threshold": 1.0,
        "sensor_serial": "2BNN4ZE7",
        "gel_id": "2BNN4ZE7-1",
        "gel_presses": 801,
        "gel_limit_presses": 1000,
    }
    return ResultPayload(**{**fields, **changes})


def test_the_reference_names_every_topic_a_press_publishes() -> None:
    """The page has the QoS and retention of every topic."""
    said = {topic.replace("<press id>", PRESS_ID): (qos, retained) for topic, qos, retained, *_ in TOPICS}

    for message in press_messages(result(), GEL, b"png"):
        assert said[message.topic] == (message.qos, message.retain)


def test_the_time_is_given_twice_and_agrees() -> None:
    """ISO 8601 UTC in microseconds with the nanoseconds; two different times are refused."""
    assert iso_time(1_769_860_800_000_250_999) == "2026-01-31T12:00:00.000250Z"
    assert json.loads(result().encode())["time"] == "2026-01-31T12:00:00.000250Z"
    with pytest.raises(ValidationError, match="time_ns says"):
        result(time="2026-01-31T12:00:00.000251Z")


def test_the_time_is_exact_for_programs_that_round_large_integers() -> None:
    """`time_ms` is below 2^53, where a double is exact; a wrong one is refused."""
    payload = json.loads(result().encode())

    assert payload["time_ms"] == 1_769_860_800_000
    assert float(payload["time_ms"]) == payload["time_ms"] < 2**53
    with pytest.raises(ValidationError, match="time_ms is 1"):
        result(time_ms=1)


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


def test_a_press_without_a_score_is_an_error_and_no_verdict() -> None:
    """The subscriber sees a null verdict and the reason."""
    payload = json.loads(result(verdict=None, score=None, threshold=None, error="saturated").encode())

    assert (payload["verdict"], payload["error"]) == (None, "saturated")


def test_a_press_publishes_result_picture_last_and_gel() -> None:
    """`last` and `last/press` repeat the result byte for byte; the gel has the numbers of its record."""
    messages = press_messages(result(), GEL, b"png")

    assert [(m.topic, m.retain) for m in messages] == [
        ("result", False),
        (f"heatmap/{PRESS_ID}", False),
        ("last/heatmap", True),
        ("last", True),
        ("last/press", True),
        ("gel", True),
    ]
    assert messages[0].payload is messages[3].payload is messages[4].payload  # encoded once
    assert messages[1].payload == messages[2].payload
    assert json.loads(messages[5].payload)["state"] == "due"


def test_a_press_without_a_picture_empties_that_of_the_last() -> None:
    """The retained picture is always that of the retained result, so an older one does not stay."""
    pictures = [m for m in press_messages(result(), GEL) if m.topic == "last/heatmap"]

    assert [(m.payload, m.retain) for m in pictures] == [(b"", True)]


def test_being_late_changes_the_mark_alone() -> None:
    """Every other field stays; a payload without the mark stays the same, byte for byte."""
    message = press_messages(result(), GEL)[0]

    late = json.loads(as_replayed(message).payload)

    assert late == {**json.loads(message.payload), "is_replayed": True}
    assert ResultPayload.model_validate_json(as_replayed(message).payload).is_replayed
    for other in (
        heatmap_message(PRESS_ID, b"\x89PNG"),
        Message("state", b'{"state":"ready"}'),
        alarm_cleared("gel"),
    ):
        assert as_replayed(other) == other


def test_alarms_are_known_by_name() -> None:
    """An unknown alarm would never be cleared at the next start, so it cannot be raised."""
    alarm = AlarmPayload(time_ns=0, alarm="gel", text="the gel is due")
    assert "overload" in ALARMS
    assert alarm_message(alarm).topic == "alarm/gel"
    assert alarm_cleared("gel").payload == b""
    with pytest.raises(ValueError, match="'gle' is not known"):
        alarm_message(alarm.model_copy(update={"alarm": "gle"}))


def test_payloads_are_frozen() -> None:
    """A value that was encoded does not change afterwards."""
    state = StatePayload(time_ns=0, state="ready")
    with pytest.raises(ValidationError, match="frozen"):
        state.state = "lost"  # type: ignore[misc]


@pytest.mark.parametrize("level", ["", "two words", "a/b", "a+", "#", "$SYS", "x" * 65, "tab\t", "null\x00"])
def test_topic_levels_are_checked(level: str) -> None:
    """Empty, blank, separators, wildcards, broker-internal names and overlong levels are refused by name."""
    with pytest.raises(ValueError, match="the topic level 'line'"):
        topic_root("gelgate", "plant", level, "press2")


def test_the_root_is_the_four_levels_and_the_version() -> None:
    """As subscribers write it in their filters."""
    root = topic_root("gelgate", "Werk-Süd", "line_1", "press2")

    assert root == "gelgate/Werk-Süd/line_1/press2/gel/v1"
    assert Station(root, "x").topic(Message("result", b"")) == f"{root}/result"


@pytest.mark.parametrize(("root", "client_id"), [("", "x"), ("/a", "x"), ("a/", "x"), ("a", "")])
def test_a_station_refuses_nonsense(root: str, client_id: str) -> None:
    """A root without slashes at its ends, and an id."""
    with pytest.raises(ValueError, match=r"found|needs"):
        Station(root, client_id)


def test_a_defect_is_placed_in_millimetres_along_both_axes() -> None:
    """Worked by hand, for pixels that are twice as tall as wide."""
    place = DefectPlace.of(Defect((2, 1, 3, 2), (3.5, 2.0), 6, 5.0), 0.1, 0.2)
    assert (place.box_mm, place.centroid_mm, place.area_mm2) == ((0.2, 0.2, 0.3, 0.4), (0.35, 0.4), 0.12)


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
        (
            "pong",
            b'{"transaction":"7"}',
            "7",
            "error",
            "no command is named 'pong'; known: break, ping, refuse",
        ),
        ("refuse", b'{"transaction":"7"}', "7", "error", "no bundle is named 'x'"),
        ("break", b'{"transaction":"7"}', "7", "error", "it failed with an internal error"),
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
