"""A gateway that cannot start leaves no trace outside: no connection, no thread, no lock."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from station import JSONL, MQTT, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import ConfigError, StoreError
from edge.gateway.gateway import Gateway
from edge.messaging.publisher_lock import PublisherLock


@pytest.fixture
def broker() -> Iterator[socket.socket]:
    """A listener that detects a connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.3)
        yield server


def test_a_second_gateway_never_reaches_the_broker(
    tmp_path: Path, recording: Path, bundle: Path, broker: socket.socket
) -> None:
    """Both have one client id: a connection of the second would disconnect the first from its broker."""
    config = load_config(station_config(tmp_path, recording, bundle, sinks=MQTT % broker.getsockname()[1]))
    first = PublisherLock(config.store.path)
    try:
        with pytest.raises(StoreError, match="another gelgate process publishes"):
            Gateway.open(config, SystemClock())
        with pytest.raises(TimeoutError):
            broker.accept()
    finally:
        first.close()


def test_a_sink_that_cannot_be_opened_closes_those_before_it(
    tmp_path: Path, recording: Path, bundle: Path, broker: socket.socket
) -> None:
    """The first sink's threads end, and the database is free again."""
    second = MQTT.replace("port = %d", 'username = "u", password_file = "/nowhere/password"')
    config = load_config(
        station_config(tmp_path, recording, bundle, sinks=MQTT % broker.getsockname()[1] + second)
    )
    before = set(threading.enumerate())
    with pytest.raises(ConfigError, match="password file /nowhere/password cannot be read"):
        Gateway.open(config, SystemClock())

    assert "mqtt-commands" not in {thread.name for thread in set(threading.enumerate()) - before}
    PublisherLock(config.store.path).close()


def test_a_sink_that_breaks_while_it_is_closed_does_not_keep_the_others_open(tmp_path: Path) -> None:
    """Nor the database's lock."""
    import random

    from edge.core.ports import Message
    from edge.messaging.publisher import Publisher
    from edge.messaging.retained_state import RetainedState
    from edge.store.press_store import Store

    class Plain:
        is_closed = False

        def send(self, message: Message) -> None: ...

        def close(self) -> None:
            self.is_closed = True

    class Broken(Plain):
        def close(self) -> None:
            raise RuntimeError("a plugin's own fault")

    path, good = tmp_path / "gelgate.db", Plain()
    with Store(path):
        running = Publisher(
            path, {"bad": Broken(), "good": good}, RetainedState(), SystemClock(), random.Random(0)
        )
        running.start()
        running.stop()

    assert good.is_closed
    PublisherLock(path).close()


def test_a_store_that_refuses_at_the_first_frame_is_waited_for(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """A database that cannot be written when the sensor appears halts the station, and does not end it."""
    import json
    import sqlite3
    import time

    path = station_config(tmp_path, recording, bundle, sinks=JSONL % (tmp_path / "out"), loop=True)
    log = tmp_path / "out" / "messages.jsonl"
    stop = threading.Event()
    with Gateway.open(load_config(path), SystemClock(), lambda report: stop.set()) as gateway:
        other = sqlite3.connect(tmp_path / "gelgate.db", timeout=60)
        with other:
            other.execute("CREATE TRIGGER no BEFORE INSERT ON gels BEGIN SELECT RAISE(FAIL, 'no room'); END")

        def repair() -> None:
            deadline = time.monotonic() + 60
            while '"state":"halted"' not in log.read_text(errors="replace") and time.monotonic() < deadline:
                time.sleep(0.02)
            with sqlite3.connect(tmp_path / "gelgate.db", timeout=60) as connection:
                connection.execute("DROP TRIGGER no")
            connection.close()

        other.close()
        log.parent.mkdir(exist_ok=True)
        log.touch()
        repairer = threading.Thread(target=repair)
        repairer.start()
        gateway.run(stop)
        repairer.join()
    messages = [json.loads(line) for line in log.read_text().splitlines()]
    states = [message["payload"]["state"] for message in messages if message["topic"] == "state"]

    # A sink that is slower than the recording, which is played at full speed, gets the latest state, not every state.
    assert states[-1] == "stopped"
    assert gateway.summary.presses == 1
