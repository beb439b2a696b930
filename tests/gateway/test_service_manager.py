"""What systemd hears of a gateway: ready, alive while the loop turns, stopping."""

import socket
import threading
from pathlib import Path

import pytest

from edge.clock import ManualClock, SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.gateway.service_manager import ServiceManager


class Manager:
    """A socket as systemd makes it in a container: with a name of the kernel's, not of the file system's."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("")
        self.path = "@" + self._socket.getsockname()[1:].decode()
        self._socket.setblocking(False)

    def heard(self) -> list[str]:
        messages = []
        while True:
            try:
                messages.append(self._socket.recv(100).decode())
            except BlockingIOError:
                return messages

    def close(self) -> None:
        self._socket.close()


def test_a_run_is_ready_alive_and_stopping(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In that order; the reports come from the loop's own turns, and a manager that does not read stops nothing."""
    manager = Manager()
    monkeypatch.setenv("NOTIFY_SOCKET", manager.path)
    monkeypatch.setenv("WATCHDOG_USEC", "3")
    heard: list[str] = []
    with open_station(
        load_config(config), SystemClock(), lambda report: heard.extend(manager.heard())
    ) as gateway:
        gateway.run(threading.Event())
    heard += manager.heard()
    manager.close()

    assert heard[0] == "READY=1"
    assert heard.count("WATCHDOG=1") > 3


def test_it_is_reported_three_times_in_the_longest_silence() -> None:
    """A turn every 0.2 s is not a message every 0.2 s."""
    manager, clock = Manager(), ManualClock()
    service = ServiceManager(clock, {"NOTIFY_SOCKET": manager.path, "WATCHDOG_USEC": "30000000"})
    for _ in range(300):
        service.alive()
        clock.sleep(0.2)
    service.stopping()

    assert manager.heard() == [*["WATCHDOG=1"] * 6, "STOPPING=1"]
    manager.close()


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nowhere/x", "WATCHDOG_USEC": "1"}])
def test_without_systemd_nothing_happens(environment: dict[str, str]) -> None:
    service = ServiceManager(ManualClock(), environment)
    service.ready()
    service.alive()
    service.stopping()
