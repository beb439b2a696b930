"""The values and errors of a connection to an MQTT broker."""

import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from edge.core.errors import ConfigError, SinkUnavailable

__all__ = [
    "Broker",
    "Level",
    "LevelRefused",
    "LoginRefused",
    "NoAnswer",
    "Received",
    "read_password",
    "tls_context",
]

Level = Literal["5", "3.1.1"]


def read_password(path: Path) -> str:
    """Read the file that holds only the password. Errors: ConfigError."""
    try:
        if path.is_fifo():  # reading would wait for its writer
            raise OSError("it is a pipe, expected a file")
        password = path.read_text(encoding="utf-8-sig").rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"password file {path} cannot be read: {error}") from error
    if not password:
        raise ConfigError(f"password file {path} is empty; write the password into it")
    return password


def tls_context(ca: Path | None, cert: Path | None = None, key: Path | None = None) -> ssl.SSLContext:
    """Make a verified context. ca: the authorities to trust, None for the system's. cert, key: for mutual TLS.

    Errors: ConfigError for a file that is missing or not a certificate.
    """
    files = [path for path in (ca, cert, key) if path is not None]
    try:
        if any(path.is_fifo() for path in files):  # it would be waited for
            raise OSError("one of them is a pipe")
        context = ssl.create_default_context(cafile=ca)
        context.sslsocket_class = _HandshakeSocket
        if cert is not None:
            context.load_cert_chain(cert, key)
    except (OSError, ssl.SSLError) as error:
        names = ", ".join(map(str, files))
        raise ConfigError(f"TLS files {names} cannot be used: {error}; PEM files are expected") from error
    return context


class _HandshakeSocket(ssl.SSLSocket):
    """Closed when its handshake fails: paho-mqtt 2.1 leaves that to the interpreter."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()
            raise


@dataclass(frozen=True)
class Broker:
    """The broker's address and protocol.

    level None: 5, or 3.1.1 where the broker proves that it does not speak 5.
    """

    host: str
    port: int
    client_id: str
    username: str | None = None
    password: str | None = None
    tls: ssl.SSLContext | None = None
    keepalive_s: int = 15
    timeout_s: float = 10.0
    level: Level | None = None
    largest_packet: int | None = None
    """At level 5 the broker is asked to send nothing larger, in bytes; None for no limit."""

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    def __repr__(self) -> str:
        return f"Broker({self}, client_id={self.client_id!r})"  # never the password


@dataclass(frozen=True)
class Received:
    """A message from the broker. response_topic and correlation exist only at level 5."""

    topic: str
    payload: bytes
    qos: int
    retain: bool
    response_topic: str | None = None
    correlation: bytes | None = None


class LevelRefused(SinkUnavailable):
    """The broker says that it does not speak this level; the next one is tried."""


class LoginRefused(SinkUnavailable):
    """The broker refuses this client at a level that it speaks."""


class NoAnswer(SinkUnavailable):
    """Something listens, and it did not answer the request to connect. It may hang: this says nothing of its level."""
