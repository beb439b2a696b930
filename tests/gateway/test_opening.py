"""A gateway that cannot start leaves no trace outside: no connection, no thread, no lock."""

import random
import socket
import threading
from contextlib import closing
from pathlib import Path
from unittest.mock import Mock

import pytest
from ports import free_port
from station import MQTT, station_config
from stepped_station import SteppedStation

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import ConfigError, StoreError
from edge.core.ports import Sink
from edge.gateway.gateway import Gateway
from edge.messaging.publisher import Publisher, PublisherLock
from edge.messaging.sink_worker import RetainedState
from edge.store.press_store import Store


def test_a_second_gateway_never_reaches_the_broker(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Both have one client id: a connection of the second would disconnect the first from its broker."""
    with socket.create_server(("127.0.0.1", 0)) as broker:
        broker.settimeout(0.3)
        sinks = MQTT % broker.getsockname()[1]
        config = load_config(station_config(tmp_path, recording, bundle, sinks=sinks))
        with closing(PublisherLock(config.store.path)):
            with pytest.raises(StoreError, match="another gelgate process publishes"):
                Gateway.open(config, SystemClock())
            with pytest.raises(TimeoutError):
                broker.accept()


def test_a_sink_that_cannot_be_opened_closes_those_before_it(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """The first sink's threads end, and the database is free again."""
    second = MQTT.replace("port = %d", 'username = "u", password_file = "/nowhere/password"')
    config = load_config(station_config(tmp_path, recording, bundle, sinks=MQTT % free_port() + second))
    before = set(threading.enumerate())
    with pytest.raises(ConfigError, match="password file /nowhere/password cannot be read"):
        Gateway.open(config, SystemClock())

    assert "mqtt-commands" not in {thread.name for thread in set(threading.enumerate()) - before}
    PublisherLock(config.store.path).close()


def test_a_sink_that_breaks_while_it_is_closed_does_not_keep_the_others_open(tmp_path: Path) -> None:
    """Nor the database's lock."""
    path, good = tmp_path / "gelgate.db", Mock(Sink)
    bad = Mock(Sink, close=Mock(side_effect=RuntimeError("a plugin's own fault")))
    with Store(path):
        sinks = {"bad": bad, "good": good}
        running = Publisher(path, sinks, RetainedState(), SystemClock(), random.Random(0))
        running.start()
        running.stop()

    good.close.assert_called_once_with()
    PublisherLock(path).close()


def test_a_store_that_refuses_at_the_first_frame_is_waited_for(station: SteppedStation) -> None:
    """A database that cannot be written when the sensor appears halts the station, and does not end it."""
    with station.refusing("gels"):
        station.play_until(lambda: station.loop.is_halted)
        assert station.said("state")["state"] == "halted"
    station.turn()
    station.play()

    assert station.verdicts == ["pass", "fail", "pass"]
    assert station.said("state")["state"] == "ready"
