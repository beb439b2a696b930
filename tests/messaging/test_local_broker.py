"""The broker of the demo and of the tests: its port is its own."""

import os
import signal
import socket
from pathlib import Path

import pytest

from edge.core.errors import SinkUnavailable
from edge.messaging import local_broker
from edge.messaging.local_broker import LocalBroker

from .conftest import require


def test_its_port_is_its_own_until_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kept while it is stopped: the system gives it to no other program, so it can return to it. Then it is free, also
    where the broker hangs and has to be killed."""
    require("mosquitto")
    monkeypatch.setattr(local_broker, "STOP_TIMEOUT_S", 0.5)
    with LocalBroker("mosquitto") as broker:
        place = (broker.host, broker.port)
        assert broker.pid is not None
        broker.stop()
        assert broker.pid is None
        with socket.socket() as other, pytest.raises(OSError, match="in use"):
            other.bind(place)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(place, timeout=30)
        pid = broker.start().start().pid
        assert pid is not None
        socket.create_connection(place, timeout=30).close()
        os.kill(pid, signal.SIGSTOP)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)

    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # what its connections leave for a minute
        other.bind(place)
        other.listen()


def test_one_that_does_not_start_leaves_no_port_and_no_folder_behind() -> None:
    require("mosquitto")
    broker = LocalBroker("mosquitto", extra="nonsense")
    with pytest.raises(SinkUnavailable, match="does not start on port"), broker:
        pytest.fail("it has started")

    assert broker._reserved.fileno() == -1
    assert not Path(broker._folder.name).exists()
