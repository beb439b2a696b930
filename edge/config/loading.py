"""A TOML file to a `Config`: every fault of it in one report, every path made relative to the file."""

import codecs
import errno
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from edge import registry
from edge.config.plugin_tables import PluginTable, SinkTable, Table
from edge.config.tables import Config
from edge.core.errors import ConfigError
from edge.core.plugins import HasIdentity
from edge.validation_messages import numbered, sentences, types_in

__all__ = ["load_config", "read_secret", "root_options", "sink_names"]

M = TypeVar("M", bound=BaseModel)


def load_config(path: Path, state_dir: Path | None = None) -> Config:
    """Read and check the file.

    state_dir: the folder of a relative `store.path`; by default that of the file. Errors: ConfigError with one line for
    every fault found.
    """
    try:
        # Editors of Windows begin a file with a byte order mark.
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ConfigError(
            f"configuration {path} does not exist; `gelgate check --example` prints one"
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(
            f"configuration {path} cannot be read: {error}; `gelgate check --example` prints a correct one"
        ) from error
    faults: list[str] = []
    config = _validate(Config, table, "", faults)
    faults += _plugin_faults(table)
    faults += _equal_sinks(config) if config is not None and not faults else []
    if faults or config is None:
        raise ConfigError(numbered(f"configuration {path}", faults))
    rooted: Config = _root_paths(path.parent, config)
    store = rooted.store.model_copy(update={"path": (state_dir or path.parent) / config.store.path})
    return rooted.model_copy(update={"store": store})


def sink_names(sinks: Sequence[SinkTable]) -> list[str]:
    """The name of each sink in the outbox: the configured one, or plugin and address, in any order of the file."""
    return [sink.name or _receiver(sink) for sink in sinks]


def _receiver(sink: SinkTable) -> str:
    options = registry.options("sinks", sink.plugin).model_validate(sink.options)
    return f"{sink.plugin}:{options.identity()}" if isinstance(options, HasIdentity) else sink.plugin


def _equal_sinks(config: Config) -> list[str]:
    counts = Counter(sink_names(config.sinks))
    return [
        f"'sinks': {n} of them are '{name}', and the outbox could not tell them apart; give each a 'name'"
        for name, n in counts.items()
        if n > 1
    ]


def _validate(model: type[M], table: object, where: str, faults: list[str]) -> M | None:
    try:
        return model.model_validate(table)
    except ValidationError as error:
        faults += sentences(model, error, where)
        return None


def _plugin_faults(table: Mapping[str, Any]) -> list[str]:
    """Faults in plugin names and options, of the tables that can be read."""
    faults: list[str] = []
    for kind, where, plugin in _plugin_tables(table):
        try:
            model = registry.options(kind, str(plugin["plugin"]))
        except ConfigError as error:
            faults.append(f"'{where}.plugin': {error}")
            continue
        _validate(model, plugin.get("options", {}), f"{where}.options", faults)
    return faults


def _plugin_tables(table: Mapping[str, Any]) -> Iterator[tuple[registry.PluginGroup, str, Mapping[str, Any]]]:
    for key, kind in _KINDS.items():
        value = table.get(key)
        places = (
            {f"{key}.{index}": inner for index, inner in enumerate(value)}
            if isinstance(value, list)
            else {key: value}
        )
        for where, plugin in places.items():
            if isinstance(plugin, dict) and "plugin" in plugin:
                yield kind, where, plugin


# The keys of the tables that name a plugin, and its kind.
_KINDS: Final[Mapping[str, registry.PluginGroup]] = {
    "device": "devices",
    "overview": "overviews",
    "sinks": "sinks",
    "triggers": "triggers",
    "actuators": "actuators",
    "handshake": "handshakes",
}


def _root_paths(folder: Path, value: Any, kind: registry.PluginGroup | None = None) -> Any:
    """Take every relative path from the folder, in nested tables and in plugin options too. kind: of a plugin."""
    if isinstance(value, Path):
        return folder / value
    if type(value) in (list, tuple):
        return type(value)(_root_paths(folder, inner, kind) for inner in value)
    if not isinstance(value, Table):
        return value
    rooted = {name: _root_paths(folder, inner, _KINDS.get(name)) for name, inner in value}
    if isinstance(value, PluginTable) and kind is not None:
        rooted["options"] = root_options(folder, registry.options(kind, value.plugin), value.options)
    return value.model_copy(update=rooted)


def root_options(folder: Path, model: type[BaseModel], options: Mapping[str, Any]) -> dict[str, Any]:
    """Take each path among the options, which are not validated yet, from the folder."""
    rooted = dict(options)
    for name, value in options.items():
        kinds = set(types_in(model.model_fields[name].annotation))
        inner = next((kind for kind in kinds if issubclass(kind, BaseModel)), None)
        if Path in kinds and isinstance(value, str):
            rooted[name] = str(folder / value)
        elif inner is not None and isinstance(value, dict):
            rooted[name] = root_options(folder, inner, value)
    return rooted


def read_secret(path: Path, key: str, shortest: int) -> bytes:
    """The secret without blanks around it, at least `shortest` bytes. key: of the configuration, such as
    `commands.secret_file`. Errors: ConfigError; none holds the secret."""
    try:
        if path.is_fifo():  # reading would wait for its writer
            raise OSError(errno.EINVAL, "it is a pipe, expected a file")
        secret = path.read_bytes().removeprefix(codecs.BOM_UTF8).strip()
        rights = path.stat().st_mode
    except OSError as error:
        raise ConfigError(
            f"{key}: {path} cannot be read ({error.strerror}); make one with "
            f"`head -c 32 /dev/urandom | base64 > {path}; chmod 0640 {path}`"
        ) from error
    if rights & 0o007:
        raise ConfigError(f"{key}: {path} is open to every user; set its rights to 0640")
    if len(secret) < shortest:
        raise ConfigError(f"{key}: {path} holds {len(secret)} bytes, at least {shortest} are needed")
    return secret
