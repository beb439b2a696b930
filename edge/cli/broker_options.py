"""The broker of `gelgate watch` and `gelgate page`, from their options."""

from pathlib import Path
from typing import TYPE_CHECKING

from edge.core.errors import ConfigError

if TYPE_CHECKING:
    from edge.messaging.mqtt_broker import Broker

__all__ = ["broker_at"]


def broker_at(
    host: str, port: int, client: str, username: str | None, password_file: Path | None, ca: Path | None
) -> "Broker":
    """client: of the client id, which also has the number of the process. Errors: ConfigError for a file that cannot be
    used."""
    import os

    from edge.messaging.mqtt_broker import Broker, Tls

    try:
        password = None if password_file is None else password_file.read_text(encoding="utf-8").rstrip("\r\n")
    except OSError as error:
        raise ConfigError(f"password file {password_file} cannot be read: {error.strerror}") from error
    tls = None if ca is None else Tls(ca).context()
    return Broker(host, port, f"gelgate-{client}-{os.getpid()}", username, password, tls)
