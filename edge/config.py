"""The configuration: one TOML file, read once into frozen values, all faults reported together.

Paths are relative to the file. Plugin options are validated by the plugin's own `Options` model, in the same report.
"""

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    ValidationError,
    model_validator,
)

from edge import registry
from edge.core.contact.settings import ContactSettings
from edge.core.errors import ConfigError
from edge.core.gel import DEFAULT_LIMIT_PRESSES, DEFAULT_WARN_FRACTION, MOST_PRESSES
from edge.core.plugins import HasIdentity
from edge.core.sink_context import topic_level
from edge.overview_table import OverviewTable
from edge.plugin_tables import ActuatorTable, PlainText, PluginTable, SinkTable, Table, TriggerTable
from edge.validation_messages import numbered, sentences, types_in

__all__ = [
    "BundleTable",
    "Config",
    "InspectionTable",
    "OverviewTable",
    "PluginTable",
    "SinkTable",
    "StationTable",
    "load_config",
    "sink_names",
]

M = TypeVar("M", bound=BaseModel)
T = TypeVar("T", bound="PluginTable")

TopicLevel = Annotated[str, AfterValidator(topic_level)]


class StationTable(Table):
    """The place of this gateway in the plant: the levels of its MQTT topics.

    Each has 1 to 64 characters, no space, and none of + # / $.
    """

    prefix: TopicLevel = Field(default="gelgate", description="first level of every topic")
    site: TopicLevel = Field(default="site", description="second level: the plant")
    line: TopicLevel = Field(default="line", description="third level: the production line")
    station: TopicLevel = Field(
        default="station", description="fourth level: this gateway, unique on its line"
    )


class BundleTable(Table):
    """One bundle of a station with several, and the names that select it."""

    path: Path = Field(description="folder or .zip made by `gelgate fit`")
    names: tuple[PlainText, ...] = Field(
        default=(),
        description="other names of its part, such as the code on it; `part/position` selects it too",
    )


class InspectionTable(Table):
    """What is inspected. Exactly one of `bundle`, `bundles` and `bundle_folder` is given.

    With several bundles, `cmd/select_part` chooses the one that inspects; all have the same sensor profile but for
    picture size and scale.
    """

    bundle: Path | None = Field(
        default=None, description="folder or .zip made by `gelgate fit`, of a station with one bundle"
    )
    bundles: tuple[BundleTable, ...] = Field(
        default=(), description="several bundles, one for each position of each part"
    )
    bundle_folder: Path | None = Field(
        default=None, description="several bundles: every folder with a manifest.json and every .zip in it"
    )
    part: PlainText | None = Field(
        default=None,
        description="name of the part that a new station starts with, the first one by default; later it starts with "
        "the part that was selected last",
    )
    older: Literal["refused", "allowed"] = Field(
        default="refused",
        description="what happens to a bundle with a lower revision than one that was in use here; see security.md",
    )
    signed: Literal["allowed", "required"] = Field(
        default="allowed",
        description="required: a bundle without the signature of a trusted key is refused; see security.md",
    )
    trusted_keys: Path | None = Field(
        default=None, description="folder of <name>.pub: the makers whose bundles are trusted"
    )
    threads: int = Field(default=2, ge=1, le=64, description="threads that score one press")
    trigger: Literal["automatic", "command"] = Field(
        default="automatic",
        description="automatic: every press is scored; command: only one that `cmd/trigger` or a pedal asks for",
    )

    @model_validator(mode="after")
    def _one_way_to_name_bundles(self) -> "InspectionTable":
        given = [name for name in ("bundle", "bundles", "bundle_folder") if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(
                f"found {' and '.join(given) or 'no bundle'}, expected exactly one of bundle (a path), bundles "
                "(tables with a path each) and bundle_folder"
            )
        names = Counter(name for table in self.bundles for name in table.names)
        if twice := sorted(name for name, n in names.items() if n > 1):
            raise ValueError(f"the name '{twice[0]}' is given to two bundles")
        return self

    @model_validator(mode="after")
    def _required_of_someone(self) -> "InspectionTable":
        if self.signed == "required" and self.trusted_keys is None:
            raise ValueError('signed = "required" needs trusted_keys, the folder of its makers\' <name>.pub')
        return self


class ContactTable(Table):
    """When a contact counts as a press, and which of its frames is scored: see contact.md."""

    settle_s: float = Field(
        default=ContactSettings.settle_s,
        ge=0.05,
        le=2,
        description="a press rests when its frame is like the one this long before, seconds",
    )
    still_share: float = Field(
        default=ContactSettings.still_share,
        gt=0,
        lt=1,
        description="like: fewer than this share of the touched pixels have changed",
    )
    growth_share: float = Field(
        default=ContactSettings.growth_share,
        gt=0,
        lt=1,
        description="and the imprint has grown by no more than this share of itself",
    )
    settle_timeout_s: float = Field(
        default=ContactSettings.settle_timeout_s,
        gt=2,
        le=60,
        description="a press that does not rest within this time after its imprint last grew is not settled, seconds",
    )
    light_levels: float = Field(
        default=ContactSettings.light_levels,
        gt=0,
        le=100,
        description="fine relief of this many levels counts as contact: lower finds lighter and softer presses",
    )

    def settings(self, *, is_external: bool) -> ContactSettings:
        """For `PressDetector`."""
        return ContactSettings(is_external=is_external, **self.model_dump())


class GelTable(Table):
    """When the gel is due."""

    limit_presses: int = Field(
        default=DEFAULT_LIMIT_PRESSES,
        ge=1,
        le=MOST_PRESSES,
        description="presses after which it must be replaced: the maker's figure for coins; sharp parts cut faster",
    )
    warn_fraction: float = Field(
        default=DEFAULT_WARN_FRACTION,
        gt=0,
        le=1,
        description="part of the limit at which a new gel should be ordered",
    )


def _database_file(path: Path) -> Path:
    """Errors: ValueError for a name that SQLite reads as a database in memory, one for each connection."""
    if path.name.startswith(":") or path.name == "" or str(path).startswith("file:"):
        raise ValueError("a database is a file on a disk; name one, such as gelgate.db")
    return path


class StoreTable(Table):
    """The database of presses, gels and unsent messages, and the room for unsent messages."""

    path: Annotated[Path, AfterValidator(_database_file)] = Field(
        default=Path("gelgate.db"), description="the SQLite file; its folder must exist"
    )
    outbox_mb: float = Field(
        default=512,
        ge=1,
        le=1_000_000,
        description="room for unsent messages; beyond it heatmaps are dropped first, passes next, fails last",
    )
    outbox_days: float = Field(
        default=30,
        ge=0.01,
        le=3650,
        description="unsent messages are dropped after this many days of running; no step of the clock counts",
    )
    free_mb: float = Field(
        default=500,
        ge=0,
        le=1_000_000_000,
        description="less room than this on its disk is an alarm; 0: none before the disk is full",
    )


class MetricsTable(Table):
    """Counters for Prometheus, on this machine alone: http://127.0.0.1:<port>/metrics. Needs the extra `metrics`."""

    port: int | None = Field(default=None, ge=1024, le=65535, description="TCP port; none: not served")


class CommandTable(Table):
    """Which requests over MQTT are served, and from whom; all others are refused. mqtt.md has the verbs."""

    unsigned: tuple[str, ...] = Field(
        default=("trigger",),
        description="verbs for everybody whom the broker lets publish on `cmd/<verb>`: its access rules decide",
    )
    signed: tuple[str, ...] = Field(
        default=(),
        description="verbs that need a signature with the secret, such as `relearn` and `replace_gel`",
    )
    secret_file: Path | None = Field(
        default=None, description="file that holds only the secret, at least 16 bytes, rights 0640"
    )
    requests_per_minute: int = Field(
        default=60, ge=1, le=6000, description="more are refused, of all verbs together"
    )

    @model_validator(mode="after")
    def _secret_for_signed(self) -> "CommandTable":
        if self.signed and self.secret_file is None:
            raise ValueError("signed verbs need secret_file")
        if both := sorted(set(self.signed) & set(self.unsigned)):
            raise ValueError(f"{', '.join(both)}: a verb is signed or unsigned, not both")
        return self


class Config(Table):
    """The complete file."""

    version: Literal[1] = Field(description="the version of this format")
    station: StationTable = StationTable()
    device: PluginTable = Field(description="the sensor")
    overview: OverviewTable | None = Field(default=None, description="a camera that sees the part")
    inspection: InspectionTable
    contact: ContactTable = ContactTable()
    gel: GelTable = GelTable()
    store: StoreTable = StoreTable()
    commands: CommandTable = CommandTable()
    metrics: MetricsTable = MetricsTable()
    sinks: list[SinkTable] = Field(min_length=1, description="where results go; one table each")
    triggers: list[TriggerTable] = Field(
        default_factory=list, description="pedals and buttons; one table each"
    )
    actuators: list[ActuatorTable] = Field(
        default_factory=list, description="lights and relays; one table each"
    )


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
    config = _validated(Config, table, "", faults)
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


def _validated(model: type[M], table: object, where: str, faults: list[str]) -> M | None:
    try:
        return model.model_validate(table)
    except ValidationError as error:
        faults += sentences(model, error, where)
        return None


def _plugin_faults(table: Mapping[str, Any]) -> list[str]:
    """Faults in plugin names and options, of the tables that can be read."""
    faults: list[str] = []
    for kind, where, plugin in _named_plugins(table):
        try:
            model = registry.options(kind, str(plugin["plugin"]))
        except ConfigError as error:
            faults.append(f"'{where}.plugin': {error}")
            continue
        _validated(model, plugin.get("options", {}), f"{where}.options", faults)
    return faults


def _named_plugins(table: Mapping[str, Any]) -> Iterator[tuple[registry.PluginGroup, str, Mapping[str, Any]]]:
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
    """The same configuration with every relative path, also in plugin options, taken from the folder of its file."""
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
    return table.model_copy(update={"options": _rooted(folder, model, table.options)})


def _rooted(folder: Path, model: type[BaseModel], options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with each path of the model taken from the folder, in nested tables too."""
    rooted = dict(options)
    for name, value in options.items():
        kinds = set(types_in(model.model_fields[name].annotation))
        inner = next((kind for kind in kinds if issubclass(kind, BaseModel)), None)
        if Path in kinds and isinstance(value, str):
            rooted[name] = str(folder / value)
        elif inner is not None and isinstance(value, dict):
            rooted[name] = _rooted(folder, inner, value)
    return rooted
