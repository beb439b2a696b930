"""A TOML file to a `Config`: every fault of it in one report, every path made relative to the file."""

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from edge import registry
from edge.config.overview_table import OverviewTable
from edge.config.plugin_tables import PluginTable, SinkTable
from edge.config.tables import Config
from edge.core.errors import ConfigError
from edge.core.plugins import HasIdentity
from edge.validation_messages import numbered, sentences, types_in

__all__ = ["load_config", "sink_names"]

M = TypeVar("M", bound=BaseModel)
T = TypeVar("T", bound="PluginTable")


def load_config(path: Path, state_dir: Path | None = None) -> Config:
    """Read and check the file.

    state_dir: the folder of a relative `store.path`; by default that of the file. Errors: ConfigError with one line for
    every fault found.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
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
    return _with_paths_from(path.parent, config, state_dir)


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
    device = table.get("device")
    if isinstance(device, dict) and "plugin" in device:
        yield "devices", "device", device
    overview = table.get("overview")
    if isinstance(overview, dict) and "plugin" in overview:
        yield "overviews", "overview", overview
    for kind in _LISTS:
        listed = table.get(kind)
        for index, one in enumerate(listed if isinstance(listed, list) else []):
            if isinstance(one, dict) and "plugin" in one:
                yield kind, f"{kind}.{index}", one


_LISTS: Final[tuple[registry.PluginGroup, ...]] = ("sinks", "triggers", "actuators")


def _with_paths_from(folder: Path, config: Config, state_dir: Path | None = None) -> Config:
    """Take every relative path, also in plugin options, from the folder of the configuration's file."""
    table = config.inspection
    inspection = table.model_copy(
        update={
            "bundle": _under(folder, table.bundle),
            "bundles": tuple(one.model_copy(update={"path": folder / one.path}) for one in table.bundles),
            "bundle_folder": _under(folder, table.bundle_folder),
            "trusted_keys": _under(folder, table.trusted_keys),
        }
    )
    store = config.store.model_copy(update={"path": (state_dir or folder) / config.store.path})
    secret = _under(folder, config.commands.secret_file)
    commands = config.commands.model_copy(update={"secret_file": secret})
    device = _with_options_from(folder, "devices", config.device)
    return config.model_copy(
        update={
            "inspection": inspection,
            "store": store,
            "commands": commands,
            "device": device,
            "overview": _overview_from(folder, config.overview),
            **{
                kind: [_with_options_from(folder, kind, one) for one in getattr(config, kind)]
                for kind in _LISTS
            },
        }
    )


def _under(folder: Path, path: Path | None) -> Path | None:
    return None if path is None else folder / path


def _overview_from(folder: Path, table: OverviewTable | None) -> OverviewTable | None:
    if table is None:
        return None
    rooted = _with_options_from(folder, "overviews", table)
    return rooted.model_copy(update={"empty": _under(folder, table.empty)})


def _with_options_from(folder: Path, kind: registry.PluginGroup, table: T) -> T:
    model = registry.options(kind, table.plugin)
    return table.model_copy(update={"options": _take_paths_from(folder, model, table.options)})


def _take_paths_from(folder: Path, model: type[BaseModel], options: Mapping[str, Any]) -> dict[str, Any]:
    """Take each path among the options from the folder, in nested tables too."""
    rooted = dict(options)
    for name, value in options.items():
        kinds = set(types_in(model.model_fields[name].annotation))
        inner = next((kind for kind in kinds if issubclass(kind, BaseModel)), None)
        if Path in kinds and isinstance(value, str):
            rooted[name] = str(folder / value)
        elif inner is not None and isinstance(value, dict):
            rooted[name] = _take_paths_from(folder, inner, value)
    return rooted
