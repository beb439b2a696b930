"""The Sparkplug node at a real broker: birth, data, death, rebirth.

`make test-subscribers` reads its messages with the decoder of Eclipse Tahu.
"""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from recorded_presses import GEL, result

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.part_position import PartPosition
from edge.core.piece import Piece
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.core.verdict import Kind
from edge.messaging.alarm_payload import AlarmPayload, alarm_cleared
from edge.messaging.local_broker import LocalBroker
from edge.messaging.payload_base import as_replayed
from edge.messaging.piece_payloads import PiecePayload, PieceResultPayload
from edge.messaging.result_payload import press_messages
from edge.messaging.status_payloads import (
    InfoPayload,
    StatePayload,
    StatsPayload,
)
from edge.messaging.topics import TOPICS
from plugins.sinks.sparkplug import SparkplugOptions, SparkplugSink, plugin
from plugins.sinks.sparkplug_metrics import (
    _FIELDS,
    DataType,
    Metric,
    decode,
    encode,
    initial_metrics,
    metrics_of,
)

from .conftest import PATIENCE_S, ROOT, Listen, Listener

NODE = "line1-press2"
STATE = StatePayload(time_ns=10**18, state="ready").message()
FAILED = press_messages(result(time_ns=10**18, verdict=Kind.FAIL, score=2.5, score_ratio=2.5), GEL)
PIECE = Piece("P1", 0, (PartPosition("PZ0", "left"),), "free")
Open = Callable[[LocalBroker], SparkplugSink]


def test_a_payload_is_that_of_the_specification() -> None:
    """Worked by hand from the field numbers: timestamp 2, one metric (name, timestamp, datatype, boolean), seq 3."""
    payload = encode([Metric("a", DataType.BOOLEAN, True, 1)], 2, 3)

    assert payload.hex() == "0802" + "1209" + "0a0161" + "1801" + "200b" + "7001" + "1803"


@pytest.mark.parametrize(
    ("kind", "value", "read"),
    [
        (DataType.INT64, 0, 0),
        (DataType.INT64, 2**63 - 1, 2**63 - 1),
        (DataType.INT64, -1, 2**64 - 1),  # the field is unsigned in the specification
        (DataType.DOUBLE, -2.5, -2.5),
        (DataType.BOOLEAN, False, False),
        (DataType.STRING, "Bügel", "Bügel"),
        (DataType.STRING, "", ""),
        (DataType.STRING, None, None),
    ],
)
def test_a_value_survives_the_wire(kind: DataType, value: Any, read: Any) -> None:
    """Also those that are 0, false or empty, which are not null."""
    assert decode(encode([Metric("x", kind, value, 1)], 1, 0)) == [("x", read)]


def test_every_metric_is_a_field_of_a_payload() -> None:
    """By the models, so that no metric stays null for a misspelt name; and each has one meaning."""
    models = {topic.name: topic.payload for topic in TOPICS}
    names = [metric.name for metric in initial_metrics(0)]

    for topic, rows in _FIELDS.items():
        model = models[topic]
        assert not isinstance(model, str)
        assert {field for _, _, field in rows} <= set(model.model_fields)
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    "message",
    [
        STATE,
        *FAILED,
        AlarmPayload(time_ns=1, alarm="gel", text="due").message(),
        PiecePayload.of(PIECE, 1, is_begun=True, last=None).message(),
        Message(PiecePayload.topic, b"", retain=True),
        PieceResultPayload.of(PIECE, "next piece", 1).message(),
        InfoPayload(time_ns=1, gelgate_version="1").message(),
        StatsPayload(time_ns=1, uptime_s=1, frames=1, frames_corrupt=0, delivered_fps=1, presses=1).message(),
    ],
    ids=lambda message: message.topic,
)  # fmt: skip
def test_data_has_only_metrics_of_the_birth(message: Message) -> None:
    """With the same types: a host knows no others."""
    born = {metric.name: metric.kind for metric in initial_metrics(0)}

    assert {metric.name: metric.kind for metric in metrics_of(message, 1)}.items() <= born.items()


def test_a_result_that_is_late_is_historical() -> None:
    """With the time of its press; a value that there is not is null."""
    metrics = {metric.name: metric for metric in metrics_of(as_replayed(FAILED[0]), 1)}

    assert metrics["Press/Verdict"] == Metric(
        "Press/Verdict", DataType.STRING, "fail", 10**12, is_historical=True
    )
    assert metrics["Press/Error"].value is None


@pytest.fixture
def open_sink() -> Iterator[Open]:
    opened: list[SparkplugSink] = []

    def make(broker: LocalBroker) -> SparkplugSink:
        station = Station(ROOT, "press2", birth=lambda: [STATE, alarm_cleared("gel")])
        options = SparkplugOptions.model_validate(
            {"host": broker.host, "port": broker.port, "protocol": "5", "acknowledge_s": PATIENCE_S}
        )
        opened.append(plugin.open(options, station))
        return opened[-1]

    yield make
    for sink in opened:
        sink.close()


def heard(listener: Listener) -> list[tuple[str, dict[str, Any]]]:
    """(verb, metrics) of the node, in order."""
    return [
        (message.topic.split("/")[2], dict(decode(message.payload)))
        for message in listener.heard
        if message.topic.startswith("spBv1.0/plant/") and "/NCMD/" not in message.topic
    ]


def seq(payload: bytes) -> int:
    """Return the field 3 at the end of a payload; it has 1 byte up to 127."""
    assert payload[-2] == 0x18
    return payload[-1]


def test_a_session_from_birth_to_death(mosquitto: LocalBroker, open_sink: Open, listen: Listen) -> None:
    """The birth has every metric with what is known; numbers have no gap; nonsense of a host is left out."""
    listener = listen(mosquitto, "spBv1.0/#")
    sink = open_sink(mosquitto)
    for _ in range(3):
        sink.send(FAILED[0])

    listener.wait_for(lambda one: len(heard(one)) == 4)
    (birth, known), (data, changed) = heard(listener)[:2]
    assert (birth, data) == ("NBIRTH", "NDATA")
    assert set(known) == {metric.name for metric in initial_metrics(0)} | {"bdSeq", "Node Control/Rebirth"}
    shown = [known[name] for name in ("Station/State", "Press/Verdict", "Node Control/Rebirth")]
    assert shown == ["ready", None, False]
    assert (changed["Press/Verdict"], changed["Press/Score Ratio"]) == ("fail", 2.5)
    assert [(message.qos, message.retain) for message in listener.heard] == [(0, False)] * 4
    assert [seq(message.payload) for message in listener.heard] == [0, 1, 2, 3]

    for payload in (
        b"\xff\xff",
        encode([Metric("other", DataType.BOOLEAN, True, 1)], 1, None),
        encode([Metric("Node Control/Rebirth", DataType.BOOLEAN, True, 1)], 1, None),
    ):
        listener._connection.publish(Message(f"spBv1.0/plant/NCMD/{NODE}", payload))
    listener.wait_for(lambda one: [verb for verb, _ in heard(one)].count("NBIRTH") == 2)
    births = [metrics for verb, metrics in heard(listener) if verb == "NBIRTH"]
    assert births[0]["bdSeq"] == births[1]["bdSeq"]
    assert births[1]["Press/Verdict"] == "fail"
    assert [seq(message.payload) for message in listener.heard if "/NBIRTH/" in message.topic] == [0, 0]

    sink.close()
    sink.close()
    listener.wait_for(lambda one: [verb for verb, _ in heard(one)][-1] == "NDEATH")


def test_a_lost_connection_is_a_death_and_the_next_birth_is_another(
    mosquitto: LocalBroker, open_sink: Open, listen: Listen
) -> None:
    """The broker publishes the death of the session that it belongs to, by its bdSeq."""
    listener = listen(mosquitto, "spBv1.0/#")
    sink = open_sink(mosquitto)
    sink.send(FAILED[0])

    assert sink._connection is not None
    sink._connection.abandon("the cable is pulled")
    listener.wait_for(lambda one: "NDEATH" in [verb for verb, _ in heard(one)])
    sink.send(FAILED[0])

    listener.wait_for(lambda one: [verb for verb, _ in heard(one)][-2:] == ["NBIRTH", "NDATA"])
    first, _, death, second, _ = [metrics for _, metrics in heard(listener)]
    assert death == {"bdSeq": first["bdSeq"]}
    assert second["bdSeq"] == (first["bdSeq"] + 1) % 256
    assert second["Press/Verdict"] == "fail"  # known from before


def test_without_a_broker_every_message_waits() -> None:
    """Also what has no metric: were it done, the sink would count as one that works. What is no message of a station is
    refused."""
    sink = plugin.open(SparkplugOptions(host="127.0.0.1", port=1), Station(ROOT, "press2"))

    for message in FAILED:
        with pytest.raises(SinkUnavailable, match="no broker answers"):
            sink.send(message)
    with pytest.raises(SinkRejected, match="has no metrics"):
        sink.send(Message("result", b"["))
    sink.close()
