"""A file that holds only a secret: read, and refused where others could read it or guess it."""

import errno
from pathlib import Path

from edge.core.errors import ConfigError

__all__ = ["read_secret"]


def read_secret(path: Path, key: str, shortest: int) -> bytes:
    """The secret without blanks around it, at least `shortest` bytes. key: of the configuration, such as
    `commands.secret_file`. Errors: ConfigError; none holds the secret."""
    try:
        if path.is_fifo():  # reading would wait for its writer
            raise OSError(errno.EINVAL, "it is a pipe, expected a file")
        secret = path.read_bytes().strip()
        rights = path.stat().st_mode
    except OSError as error:
        raise ConfigError(
            f"{key}: {path} cannot be read ({error.strerror}); make one with `head -c 32 /dev/urandom | base64`"
        ) from error
    if rights & 0o007:
        raise ConfigError(f"{key}: {path} is open to every user; set its rights to 0640")
    if len(secret) < shortest:
        raise ConfigError(f"{key}: {path} holds {len(secret)} bytes, at least {shortest} are needed")
    return secret
