"""What several verbs find by their options: the station, its broker, and the options of a plugin.

Like the verbs, this imports nothing heavy at the top.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeVar

import typer

from edge.cli.arguments import named_values
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import BaseModel

    from edge.messaging.mqtt_broker import Broker

    OptionsT = TypeVar("OptionsT", bound=BaseModel)

__all__ = [
    "CONFIG",
    "BundlePath",
    "ConfigOption",
    "DatabaseOption",
    "TrunkStore",
    "broker_at",
    "database_path",
    "plugin_options",
]

CONFIG: Final = Path("gelgate.toml")

ConfigOption = Annotated[Path, typer.Option("--config", "-c", help="The station's TOML file.")]
DatabaseOption = Annotated[
    Path | None, typer.Option(help="A database file instead of the one that the configuration names.")
]
BundlePath = Annotated[Path, typer.Argument(metavar="BUNDLE", help="A bundle: folder or .zip.")]
TrunkStore = Annotated[
    Path | None,
    typer.Option("--trunks", help="Folder of <sha256>.onnx files, for bundles without their trunk."),
]


def database_path(config: Path, database: Path | None) -> Path:
    """Find the database; the configuration is read only where none is named. Errors: ConfigError."""
    from edge.config import load_config

    path = database or load_config(config).store.path
    if not path.is_file():
        raise ConfigError(f"database {path} does not exist; the gateway makes it at its first run")
    return path


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


def plugin_options(kind: str, name: str, model: "type[OptionsT]", given: Sequence[str]) -> "OptionsT":
    """Read a plugin's `Options` from texts such as `pace=0`. Errors: ConfigError with every fault."""
    from pydantic import ValidationError

    from edge.validation_messages import numbered, sentences

    try:
        return model.model_validate(named_values("--option", given))
    except ValidationError as error:
        faults = numbered(f"--option for the {kind} plugin '{name}'", sentences(model, error))
        raise ConfigError(f"{faults}\nit takes: {', '.join(model.model_fields)}") from error
