"""The broker of the demo and of the tests: its port is its own."""

import socket

import pytest

from edge.messaging.local_broker import LocalBroker

from .conftest import require


def test_its_port_is_kept_while_it_is_stopped(mosquitto: LocalBroker) -> None:
    """A program that the system gives a free port to never gets this one, so the broker can return to it."""
    mosquitto.stop()

    with socket.socket() as other, pytest.raises(OSError, match="in use"):
        other.bind((mosquitto.host, mosquitto.port))
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((mosquitto.host, mosquitto.port), timeout=30)

    mosquitto.start()
    socket.create_connection((mosquitto.host, mosquitto.port), timeout=30).close()


def test_its_port_is_free_after_the_end() -> None:
    """Nothing of it is left."""
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        port = broker.port

    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # what its connections leave for a minute
        other.bind(("127.0.0.1", port))
        other.listen()
