"""The AsyncAPI document: it meets the published schema, and describes what the station really sends."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import page_messages
import pytest
from recorded_presses import GEL, PRESS_ID, result, unscored

from edge.core.gel_life import GelState
from edge.core.verdict import Kind
from edge.gateway.command_table import every_command
from edge.messaging.alarm_payload import AlarmPayload, alarm_cleared, list_alarms
from edge.messaging.command_payloads import CommandResponse
from edge.messaging.descriptions.asyncapi import asyncapi_message, document
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.result_payload import DefectPlace, PressFiles, picture_messages, press_messages
from edge.messaging.status_payloads import (
    GelPayload,
    InfoPayload,
    StatePayload,
    StatsPayload,
    availability_message,
)
from edge.messaging.topics import TOPICS
from edge.messaging.validation import DocumentCheck

PUBLISHED = json.loads(
    (Path(__file__).parent / "published" / "asyncapi-3.0.0.json").read_text(encoding="utf-8")
)
ROOT = "gelgate/plant/line1/press2/gel/v1"
STATION = DescribedStation(
    ROOT,
    "plant/line1/press2",
    "0.2.0",
    every_command(),
    ["relearn"],
    keeps_heatmap=True,
)


@pytest.fixture(scope="module")
def described() -> dict[str, Any]:
    return json.loads(asyncapi_message(STATION).payload)


@pytest.fixture(scope="module")
def check(described: dict[str, Any]) -> DocumentCheck:
    return DocumentCheck(described)


@pytest.mark.parametrize("served", [0, 1, len(every_command())])
def test_the_document_meets_the_published_schema(served: int) -> None:
    """That of AsyncAPI 3.0.0, whether or not commands are served."""
    station = DescribedStation(ROOT, STATION.place, STATION.version, STATION.commands[:served])

    faults = [error.message for error in jsonschema.Draft7Validator(PUBLISHED).iter_errors(document(station))]

    assert faults == []


def test_the_published_schema_finds_faults() -> None:
    wrong = document(STATION)
    wrong["channels"]["state"]["colour"] = "red"

    assert not jsonschema.Draft7Validator(PUBLISHED).is_valid(wrong)


def test_every_reference_leads_somewhere(described: dict[str, Any]) -> None:
    for place in references(described):
        found: Any = described
        for level in place.removeprefix("#/").split("/"):
            found = found[level]


def references(value: Any) -> list[str]:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    own = [value["$ref"]] if isinstance(value, dict) and "$ref" in value else []
    return own + [reference for one in inner for reference in references(one)]


def test_every_message_of_fields_is_summed_up_in_a_line(described: dict[str, Any]) -> None:
    """That of its class."""
    messages = described["components"]["messages"]
    lines = [one["summary"] for one in messages.values() if "$ref" in one["payload"]]
    assert all(line.strip() and "\n" not in line for line in lines)


def test_every_topic_has_a_channel_with_its_delivery(described: dict[str, Any]) -> None:
    """QoS and retention are those of the manual; verbs that are served have a channel each. Alarms are named."""
    delivery = {}
    parameters = {
        name: given
        for one in described["channels"].values()
        for name, given in one.get("parameters", {}).items()
    }
    assert parameters["alarm"]["enum"] == list(list_alarms())
    assert "enum" not in parameters["press_id"]
    for one in described["operations"].values():
        channel = described["channels"][one["channel"]["$ref"].rpartition("/")[2]]
        mqtt = one["bindings"]["mqtt"]
        delivery[channel["address"].removeprefix(f"{ROOT}/")] = (one["action"], mqtt["qos"], mqtt["retain"])

    for topic in TOPICS:
        if not topic.name.startswith("cmd/"):
            address = topic.name.replace("<press id>", "{press_id}").replace("<alarm>", "{alarm}")
            assert delivery.pop(address) == ("send", topic.qos, topic.is_retained)
    assert delivery == {f"cmd/{one.verb}": ("receive", 1, False) for one in every_command()}


MESSAGES = [
    StatePayload(time_ns=1, state="halted", reason="no sensor").message(),
    availability_message(is_online=True),
    InfoPayload(time_ns=1, gelgate_version="0.2.0", warnings=("an outlier",)).message(),
    GelPayload(time_ns=1, sensor_serial="a", gel_id="b", presses=1, limit_presses=2, state=GelState.DUE).message(),
    page_messages.reference(),
    AlarmPayload(time_ns=1, alarm="gel", text="due").message(),
    alarm_cleared("disk"),
    StatsPayload(
            time_ns=1, uptime_s=1.5, frames=1, frames_corrupt=0, delivered_fps=18.7, presses=1, verdicts={"pass": 1},
            receivers={"mqtt": "up"}, alarms=("gel",),
        ).message(),
    asyncapi_message(STATION),
    *press_messages(
        result(
            verdict=Kind.FAIL, score=2.5, threshold=1.0, mm_per_pixel=(0.06, 0.06), latency_ms={"total": 1.5},
            defects=[DefectPlace(box_px=(1, 2, 3, 4), box_mm=(0.1, 0.2, 0.3, 0.4), centroid_px=(1.5, 2.5),
                                 centroid_mm=(0.1, 0.2), area_mm2=0.5, score=2.5)],
        ),
        GEL,
        b"\xff\xd8\xff...",
    ),
    *picture_messages(PRESS_ID, PressFiles(b"\xff\xd8\xff...", b"\x89PNG\r\n\x1a\n..."), is_last=True),
    *picture_messages(PRESS_ID, PressFiles()),
    *press_messages(unscored(), GEL),
]  # fmt: skip


def test_what_the_station_sends_is_as_described(check: DocumentCheck) -> None:
    """Full and empty, with a verdict and without; answers too; a later version may add a field."""
    for message in MESSAGES:
        assert check.fault(f"{ROOT}/{message.topic}", message.payload) is None, message.topic
    answer = CommandResponse(time_ns=1, transaction="17", verb="dance", status="error", error="unknown")
    assert check.fault(f"{ROOT}/cmd/dance/response", answer.encode()) is None
    assert check.fault(f"{ROOT}/result", changed(colour="red")) is None


def test_what_is_over_is_described_as_empty(described: dict[str, Any], check: DocumentCheck) -> None:
    """An alarm too: nothing follows in its message. So are the piece in progress and the picture that is kept."""
    for topic in ("alarm/gel", "piece", "last/heatmap"):
        assert check.fault(f"{ROOT}/{topic}", b"") is None
    empty = described["components"]["messages"]["Empty"]["payload"]
    assert jsonschema.Draft7Validator(empty).is_valid("")
    assert not jsonschema.Draft7Validator(empty).is_valid("x")


def changed(**changes: Any) -> bytes:
    content = json.loads(result().encode())
    content.update(changes)
    return json.dumps({key: value for key, value in content.items() if value != "MISSING"}).encode()


@pytest.mark.parametrize(
    ("topic", "payload", "fault"),
    [
        ("result", changed(press_id="1"), "press_id"),
        ("result", changed(gel_presses="801"), "gel_presses"),
        ("result", changed(sequence="MISSING"), "'sequence' is a required property"),
        ("result", changed(verdict="good"), "verdict"),
        ("result", changed(verdict=None), "None is not of type 'string'"),
        ("result", changed(error="both"), "is not of type 'null'"),
        ("result", changed(mm_per_pixel=[0.06]), "mm_per_pixel"),
        ("result", changed(mm_per_pixel=["0.06", "0.06"]), "mm_per_pixel[0]"),
        ("result", b"", "cannot be read"),
        ("result", b"\xff", "cannot be read"),
        ("result", b"[" * 100_000, "cannot be read"),
        ("availability", b"on", "'on' is not one of"),
        ("state", b"", "cannot be read"),
        ("heatmap/1", b"GIF89a", "no image/jpeg"),
        ("last/heatmap", b"GIF89a", "no image/jpeg"),
        ("weather", b"{}", "no channel"),
        ("alarm/gel/more", b"", "no channel"),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else "",
)
def test_what_is_wrong_is_seen(check: DocumentCheck, topic: str, payload: bytes, fault: str) -> None:
    """A missing field, a wrong type, two outcomes at once, what is no JSON, no picture, or no topic of the station."""
    assert fault in (check.fault(f"{ROOT}/{topic}", payload) or "nothing is wrong")


@pytest.mark.parametrize(
    ("content", "is_valid"),
    [
        ({"transaction": "17"}, True),
        ({"transaction": "17", "arguments": {"gel_id": "b", "limit_presses": 5}}, True),
        ({"transaction": "17", "arguments": {"colour": "red"}}, False),
        ({"transaction": "17", "arguments": {"limit_presses": 0}}, False),
        ({"transaction": "17", "colour": "red"}, False),
        ({}, False),
    ],
)
def test_a_request_is_described_as_the_station_reads_it(
    described: dict[str, Any], content: dict[str, Any], is_valid: bool
) -> None:
    """With the arguments of its verb; what the station refuses is not valid."""
    schema = described["components"]["schemas"]["replace_gel_request"]

    assert jsonschema.Draft7Validator(schema).is_valid(content) == is_valid
