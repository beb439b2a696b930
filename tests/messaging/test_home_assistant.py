"""The discovery message of Home Assistant: its templates are rendered on what a station really sends.

`make test-subscribers` checks it against the schemas of Home Assistant itself.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jinja2
import pytest
from recorded_presses import GEL, result, unscored

from edge.core.gel_life import GelState
from edge.core.part_position import PartPosition
from edge.core.piece import Piece
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.core.verdict import Cause, Kind
from edge.messaging.descriptions.dashboards import discovery, discovery_topic
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.local_broker import LocalBroker
from edge.messaging.piece_payloads import PiecePayload
from edge.messaging.result_payload import press_messages
from edge.messaging.status_payloads import (
    GelPayload,
    StatePayload,
    StatsPayload,
)
from edge.messaging.topics import TOPICS
from plugins.sinks.mqtt import plugin
from plugins.sinks.mqtt_options import MqttOptions

from .conftest import PATIENCE_S, ROOT, Listen

STATION = DescribedStation.of_root(ROOT)
DEVICE = discovery(replace(STATION, keeps_heatmap=True))


AT = {"time_ns": 10**18}
FAILED = press_messages(
    result(**AT, verdict=Kind.FAIL, score=2.5, score_ratio=2.5, cause=Cause.GEL, blind_share=0.02), GEL
)
PASSED = press_messages(result(**AT, score_ratio=0.5), GEL)
NO_SCORE = press_messages(unscored(), GEL)
USED = {"sensor_serial": "S", "gel_id": "S-1", "presses": 1003, "limit_presses": 1000}
WORN = [GelPayload(time_ns=1, **USED, state=GelState.REPLACE).message()]
HALTED = [StatePayload(time_ns=1, state="halted", reason="no sensor").message()]
LOST = [StatePayload(time_ns=1, state="lost").message()]


def piece(**given: Any) -> Message:
    place = PartPosition("PZ0", "left")
    return PiecePayload.of(Piece("P2", 0, (place,), "fixed"), 1, **given).message()


def stats(**more: Any) -> list[Message]:
    numbers = {"uptime_s": 1.0, "frames": 1, "frames_corrupt": 0, "delivered_fps": 18.0, "presses": 1}
    return [StatsPayload(time_ns=1, **numbers, **more).message()]


@pytest.mark.parametrize(
    ("component", "messages", "shown"),
    [
        ("verdict", FAILED, "fail"),
        ("verdict", NO_SCORE, "error"),
        ("failed", FAILED, "ON"),
        ("failed", NO_SCORE, "ON"),
        ("failed", PASSED, "OFF"),
        ("score_ratio", FAILED, "2.5"),
        ("score_ratio", NO_SCORE, "None"),
        ("cause", FAILED, "gel"),
        ("cause", PASSED, "none"),
        ("blind_share", FAILED, "0.02"),
        ("piece", [piece(is_begun=True, last=("P1", "pass"))], "in progress"),
        ("piece", [piece(is_begun=False, last=("P1", "pass"))], "pass"),
        ("piece", [piece(is_begun=False, last=None)], "none"),
        ("time", FAILED, "2001-09-09T01:46:40.000000Z"),
        ("state", HALTED, "halted"),
        ("gel_state", WORN, "replace"),
        ("gel_presses", WORN, "1003"),
        ("gel_left", WORN, "0"),
        ("gel_left", FAILED, "199"),
        ("alarm", stats(), "OFF"),
        ("alarm", stats(alarms=("gel",)), "ON"),
        ("latency", stats(latency_ms_p50=31.5), "31.5"),
        ("latency", stats(), "None"),
        ("unsent", stats(outbox_rows=3), "3"),
    ],
)
def test_entities_show_what_a_station_says(component: str, messages: Sequence[Message], shown: str) -> None:
    """From the topic that it names. Home Assistant reads `None` as "unknown"."""
    entity = DEVICE["components"][component]
    by_topic = {
        f"{ROOT}/{message.topic}": json.loads(message.payload) for message in messages if message.payload
    }

    text = rendered(entity["value_template"], by_topic[entity["state_topic"]])

    assert text == shown
    assert shown in entity.get("options", [shown])


def rendered(template: str, value: dict[str, Any]) -> str:
    return jinja2.Environment(undefined=jinja2.StrictUndefined).from_string(template).render(value_json=value)


def test_a_station_is_one_device_with_its_own_topics_and_words() -> None:
    """Ids are the same at every start and of one site; no word that a station says is unknown; gone, it is offline."""
    own = {f"{ROOT}/{topic.name}" for topic in TOPICS}
    entities = DEVICE["components"]
    named = {value for one in entities.values() for key, value in one.items() if key.endswith("_topic")}
    other = DescribedStation.of_root(ROOT.replace("plant", "site2"))

    assert named <= own
    assert f"{ROOT}/last/heatmap" in named
    assert len({one["unique_id"] for one in entities.values()}) == len(entities)
    assert discovery(STATION)["components"].keys() == entities.keys() - {"picture"}
    assert discovery_topic(other, "ha") != discovery_topic(STATION, "ha")
    assert discovery(other)["device"]["identifiers"] != DEVICE["device"]["identifiers"]
    for component, words in (("verdict", Kind), ("cause", Cause), ("gel_state", GelState)):
        assert {word.value for word in words} <= {*entities[component]["options"]}
    assert DEVICE["availability_topic"] == f"{ROOT}/state"
    for messages, shown in ((HALTED, "online"), (LOST, "offline")):
        assert rendered(DEVICE["availability_template"], json.loads(messages[0].payload)) == shown


def test_the_sink_announces_the_station_where_it_is_asked_to(mosquitto: LocalBroker, listen: Listen) -> None:
    """Retained, on Home Assistant's topic and not below the station's; by default nothing is announced."""
    listener = listen(mosquitto, "#")
    for more in ({}, {"home_assistant": "ha"}):
        options = MqttOptions.model_validate(
            {"host": "127.0.0.1", "port": mosquitto.port, "acknowledge_s": PATIENCE_S, **more}
        )
        sink = plugin.open(options, Station(ROOT, "press2"))
        sink.send(Message("stats", b"{}", qos=1))
        sink.close()

    listener.wait_for(lambda heard: len(heard.heard) == 3)
    late = listen(mosquitto, "#", client_id="late")
    late.wait_for(lambda heard: len(heard.heard) == 1)

    assert [message.topic for message in late.heard] == [discovery_topic(STATION, "ha")]
    assert json.loads(late.heard[0].payload) == DEVICE
