"""Messages of stations against their own documents, in the order in which a broker sends them."""

import json
from typing import Any

import pytest

from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.mqtt_broker import Received
from edge.messaging.validation import DocumentCheck, StationsCheck

ROOT = "gelgate/plant/line1/press2/gel/v1"
DOCUMENT = asyncapi_message(DescribedStation.of_root(ROOT)).payload


def received(topic: str, payload: bytes) -> Received:
    return Received(f"{ROOT}/{topic}", payload, 1, retain=True)


def test_messages_wait_for_the_document() -> None:
    """Retained messages arrive in any order: those before the document are checked when it comes."""
    check = StationsCheck()

    assert [
        *check.see(received("availability", b"online")),
        *check.see(received("availability", b"on")),
    ] == []
    assert (check.checked, check.undescribed) == (0, {"gelgate/plant/line1/press2": 2})
    assert check.see(received("asyncapi", DOCUMENT)) == [
        f"{ROOT}/availability: $: 'on' is not one of ['online', 'offline']"
    ]
    assert (check.checked, check.undescribed) == (3, {})


def test_what_waits_for_a_document_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first ones wait, of each station; the others cost no memory, and are counted."""
    monkeypatch.setattr("edge.messaging.validation.MOST_WAITING", 2)
    check = StationsCheck()
    for payload in (b"on", b"online", b"off"):
        check.see(received("availability", payload))
    check.see(Received("gelgate/a/b/c/gel/v1/state", b"", 1, retain=True))

    assert check.undescribed == {"gelgate/plant/line1/press2": 3, "gelgate/a/b/c": 1}
    assert check.left_out == {}
    assert ["'on' is not" in fault for fault in check.see(received("asyncapi", DOCUMENT))] == [True]
    assert check.checked == 3
    assert check.left_out == {"gelgate/plant/line1/press2": 1}


def test_requests_and_other_topics_are_not_the_stations() -> None:
    """Anybody may ask nonsense; only what the station says is checked."""
    check = StationsCheck()
    check.see(received("asyncapi", DOCUMENT))

    assert check.see(received("cmd/trigger", b"nonsense")) == []
    assert check.see(Received("homeassistant/status", b"online", 0, retain=False)) == []
    assert check.checked == 1


def station(**changes: Any) -> bytes:
    return json.dumps({**json.loads(DOCUMENT), **changes}).encode()


LOOP = {"a": {"$ref": "#/channels/b"}, "b": {"$ref": "#/channels/a"}}


@pytest.mark.parametrize(
    "document",
    [
        b"",
        b"[1]",
        b"null",
        b"{}",
        b"[" * 100_000,
        station(operations={"send": {"action": "send", "channel": {"$ref": "#/channels/gone"}}}),
        station(operations=[]),
        station(channels=LOOP, operations={"send": {"action": "send", "channel": {"$ref": "#/channels/a"}}}),
        station(components={"messages": {"StatePayload": {"payload": {"type": "no type"}}}}),
    ],
)
def test_a_document_that_cannot_be_used_is_a_fault_and_ends_nothing(document: bytes) -> None:
    """Nonsense from anybody: the sentence names the topic, and the one in use stays."""
    check = StationsCheck()
    check.see(received("asyncapi", DOCUMENT))

    assert check.see(received("asyncapi", document))[0].startswith(f"{ROOT}/asyncapi: ")
    assert check.see(received("availability", b"online")) == []


def test_a_schema_that_refers_to_nothing_is_a_fault_of_the_message() -> None:
    """The rest of the document can still be used."""
    document = json.loads(DOCUMENT)
    document["components"]["messages"]["StatePayload"]["payload"] = {"$ref": "#/components/schemas/Gone"}
    check = DocumentCheck(document)

    assert "cannot be read" in (check.fault(f"{ROOT}/state", b"{}") or "")
    assert check.fault(f"{ROOT}/availability", b"online") is None
