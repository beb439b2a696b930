"""Options of several verbs: the station, its database, and a bundle."""

from pathlib import Path
from typing import Annotated, Final

import typer

from edge.config import load_config
from edge.core.errors import ConfigError

__all__ = [
    "CONFIG",
    "BundlePath",
    "ConfigOption",
    "DatabaseOption",
    "TrunkStore",
    "database_path",
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
    path = database or load_config(config).store.path
    if not path.is_file():
        raise ConfigError(f"database {path} does not exist; the gateway makes it at its first run")
    return path
