"""The options by which a verb finds its station: `--config` and `--database`."""

from pathlib import Path
from typing import Annotated, Final

import typer

__all__ = ["CONFIG", "ConfigOption", "DatabaseOption", "database_path"]

CONFIG: Final = Path("gelgate.toml")

ConfigOption = Annotated[Path, typer.Option("--config", "-c", help="The station's TOML file.")]
DatabaseOption = Annotated[
    Path | None, typer.Option(help="A database file instead of the one that the configuration names.")
]


def database_path(config: Path, database: Path | None) -> Path:
    """Find the database; the configuration is read only where none is named. Errors: ConfigError."""
    from edge.config import load_config
    from edge.core.errors import ConfigError

    path = database or load_config(config).store.path
    if not path.is_file():
        raise ConfigError(f"database {path} does not exist; the gateway makes it at its first run")
    return path
