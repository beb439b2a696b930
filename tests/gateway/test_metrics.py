"""Counters for Prometheus: every number of the stats, every alarm, on this machine alone."""

import socket
from contextlib import ExitStack, closing

import pytest
from page_messages import ask
from ports import free_port
from station import Configure
from stepped_station import SteppedStation

from edge.core.errors import ConfigError
from edge.features.metrics import METRICS, Metrics
from edge.messaging.alarm_payload import ALARMS, AlarmPayload, alarm_cleared
from edge.messaging.payload_base import Payload
from edge.messaging.status_payloads import StatePayload, StatsPayload
from edge.page.http_server import MOST_OF_ONE

T0 = 1_780_000_000 * 10**9


@pytest.fixture
def port() -> int:
    return free_port()


def read(port: int) -> dict[str, float]:
    """Metric with its label, as a scrape reads it."""
    status, answer = ask(port, "/metrics")
    assert status == 200
    lines = (line.rpartition(" ") for line in answer.decode().splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in lines}


def samples(seen: Metrics) -> dict[tuple[str, ...], float]:
    return {
        (one.name, *one.labels.values()): one.value for family in seen.collect() for one in family.samples
    }


def test_every_number_of_the_stats_is_a_metric() -> None:
    """A new field of the payload needs its row. Each alarm is a metric of its own, from its topic. The ledger's
    head is no number."""
    without = {*Payload.model_fields, "alarms", "ledger_head"}
    assert set(METRICS) == set(StatsPayload.model_fields) - without


def test_the_values_are_those_of_the_report() -> None:
    """Counters end in _total; parts have a label; what is not known is left out."""
    seen = Metrics()
    report = StatsPayload(
        time_ns=T0,
        uptime_s=5.0,
        frames=100,
        frames_corrupt=2,
        delivered_fps=18.5,
        presses=3,
        verdicts={"pass": 2, "fail": 1},
        dropped={"heatmap": 4},
        receivers={"mqtt:a": "up, MQTT 5", "mqtt:b": "connection refused"},
    )
    seen.note(report.message())
    found = samples(seen)

    assert found["gelgate_frames_total",] == 100
    assert found["gelgate_verdicts_total", "fail"] == 1
    assert found["gelgate_outbox_dropped_total", "heatmap"] == 4
    assert (found["gelgate_receiver_up", "mqtt:a"], found["gelgate_receiver_up", "mqtt:b"]) == (1, 0)
    assert found["gelgate_report_time_seconds",] == T0 / 1e9
    assert ("gelgate_disk_free_bytes",) not in found


def test_alarms_and_state_are_followed() -> None:
    """Each known alarm is 0 or 1 from the first moment on, so that a rule finds it."""
    seen = Metrics()
    assert {
        key[1]: value for key, value in samples(seen).items() if key[0] == "gelgate_alarm"
    } == dict.fromkeys(ALARMS, 0.0)

    seen.note(AlarmPayload(time_ns=T0, alarm="disk", text="low").message())
    seen.note(StatePayload(time_ns=T0, state="ready").message())
    found = samples(seen)
    assert (found["gelgate_alarm", "disk"], found["gelgate_ready",]) == (1, 1)

    seen.note(alarm_cleared("disk"))
    seen.note(StatePayload(time_ns=T0, state="halted", reason="the disk is full").message())
    found = samples(seen)
    assert (found["gelgate_alarm", "disk"], found["gelgate_ready",]) == (0, 0)


def test_a_station_serves_them_until_it_is_closed(configure: Configure, port: int) -> None:
    """Presses, gel, memory of the process, on one loopback address alone: there is no login, so no other address of the
    machine answers, and 127.0.0.2 stands for them. Afterwards nothing answers."""
    config = configure(tables=f"[metrics]\nport = {port}")
    with SteppedStation(config) as station:
        station.play()
        station.loop.publish_stats()
        found = read(port)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), timeout=10)

    assert found["gelgate_presses_total"] == 3
    assert found['gelgate_verdicts_total{verdict="fail"}'] == 1
    assert (found["gelgate_gel_presses"], found["gelgate_gel_limit_presses"]) == (3, 1000)
    assert found["process_resident_memory_bytes"] > 0
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=10)


def test_a_page_of_others_and_slow_clients_are_no_readers(port: int) -> None:
    """A name server of others may answer with our address. Half requests take no place from a whole one."""
    with closing(Metrics()) as metrics, ExitStack() as opened:
        metrics.serve(port)
        for _ in range(MOST_OF_ONE + 10):
            slow = opened.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10))
            slow.sendall(b"GET /metrics")
        assert ask(port, "/metrics", Host="attacker.example")[0] == 403
        assert ask(port, "/")[0] == 404
        assert "process_open_fds" in ask(port, "/metrics")[1].decode()


def test_without_its_package_it_names_the_extra(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.extras.is_installed", lambda package: package != "prometheus_client")
    with pytest.raises(ConfigError, match=r"metrics.port needs prometheus_client.*'gelgate\[metrics\]'"):
        Metrics().serve(port)
