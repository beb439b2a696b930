"""A real MQTT broker on this machine, for the demo and for tests: mosquitto if it is installed, else amqtt.

It listens on a loopback port, accepts every client, and keeps nothing on disk: not a broker for a plant.
"""

import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal, Self

from edge.core.errors import SinkUnavailable
from edge.messaging.mqtt_broker import Level

__all__ = ["LocalBroker", "available_brokers"]

BrokerKind = Literal["mosquitto", "amqtt"]

# mosquitto accepts after about 30 ms, amqtt after 300 ms on an idle desktop processor; a loaded gateway is slower.
START_TIMEOUT_S: Final = 60.0
STOP_TIMEOUT_S: Final = 5.0

_MOSQUITTO: Final = (
    "listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\nset_tcp_nodelay true\n{extra}\n"
)

# Without its plugins amqtt 0.12 refuses every client; these two allow anonymous clients.
_AMQTT: Final = """\
listeners:
  default:
    type: tcp
    bind: 127.0.0.1:{port}
plugins:
  amqtt.plugins.authentication.AnonymousAuthPlugin:
    allow_anonymous: true
"""


def _mosquitto() -> str | None:
    # Debian keeps it in /usr/sbin, which an ordinary user's path may lack.
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


def available_brokers() -> list[BrokerKind]:
    """The brokers that can be started here, the better one first."""
    kinds: list[BrokerKind] = ["mosquitto"] if _mosquitto() else []
    return [*kinds, "amqtt"] if find_spec("amqtt") else kinds


class LocalBroker:
    """A broker process. `start` returns once it accepts connections; `stop` ends it; both may be repeated.

    Its port is a free one, which no other program gets before `close`, not even while the broker is stopped.
    extra: more lines for mosquitto's file.
    Errors: SinkUnavailable if no broker is installed or it does not start.
    """

    def __init__(self, kind: BrokerKind | None = None, extra: str = "") -> None:
        available = available_brokers()
        if not available or (kind is not None and kind not in available):
            raise SinkUnavailable(
                f"no MQTT broker is installed here (wanted: {kind or 'mosquitto or amqtt'}); "
                "install mosquitto, or pip install amqtt"
            )
        self.host = "127.0.0.1"
        self.kind: BrokerKind = kind or available[0]
        self.level: Level = "5" if self.kind == "mosquitto" else "3.1.1"
        self._reserved = _reserved_port()
        self.port = int(self._reserved.getsockname()[1])
        self._extra = extra
        self._folder = tempfile.TemporaryDirectory(prefix="gelgate-broker-")
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """The broker's process, None while it is stopped."""
        return None if self._process is None else self._process.pid

    def start(self) -> Self:
        if self._process is not None:
            return self
        log_path = Path(self._folder.name) / "broker.log"
        with log_path.open("ab") as log:
            self._process = subprocess.Popen(
                self._command(), stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._accepts():
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.stop()
                last = log_path.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:]
                raise SinkUnavailable(
                    f"the broker {self.kind} does not start on port {self.port}: {''.join(last) or 'no output'}"
                )
            time.sleep(0.02)
        return self

    def stop(self, by: int = signal.SIGTERM) -> None:
        """End it. by: SIGKILL as in a power failure."""
        process, self._process = self._process, None
        if process is None:
            return
        process.send_signal(by)
        try:
            process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def close(self) -> None:
        """Stop it, remove its files, and give up its port."""
        self.stop()
        self._reserved.close()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        try:
            return self.start()
        except BaseException:
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def _command(self) -> list[str]:
        folder = Path(self._folder.name)
        folder.chmod(0o755)  # mosquitto started by root reads its file as its own user
        config = folder / ("mosquitto.conf" if self.kind == "mosquitto" else "amqtt.yaml")
        text = (_MOSQUITTO if self.kind == "mosquitto" else _AMQTT).format(port=self.port, extra=self._extra)
        config.write_text(text, encoding="utf-8")
        if self.kind == "mosquitto":
            return [_mosquitto() or "mosquitto", "-c", str(config)]
        return [sys.executable, "-m", "amqtt.scripts.broker_script", "-c", str(config)]

    def _accepts(self) -> bool:
        try:
            socket.create_connection((self.host, self.port), timeout=1.0).close()
        except OSError:
            return False
        return True


def _reserved_port() -> socket.socket:
    """A socket at a free port, which does not listen: the system gives this port only to a program that names it.

    The broker may listen there, for it allows that its address is reused. Ref: socket(7), SO_REUSEADDR; seen on Linux.
    """
    reserved = socket.socket()
    reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    reserved.bind(("127.0.0.1", 0))
    return reserved
