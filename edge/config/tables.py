"""The tables of a configuration, but for those that name a plugin."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from edge.config.feature_tables import (
    CommandTable,
    ConfirmTable,
    MetricsTable,
    OverviewTable,
    PieceTable,
    ReferenceTable,
)
from edge.config.plugin_tables import (
    ActuatorTable,
    HandshakeTable,
    PlainText,
    PluginTable,
    SinkTable,
    Table,
    TriggerTable,
)
from edge.core.contact.settings import ContactSettings
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES, DEFAULT_WARN_FRACTION, MOST_PRESSES
from edge.core.sink_context import Place, topic_level

__all__ = [
    "ArchiveTable",
    "BundleTable",
    "Config",
    "ContactTable",
    "InspectionTable",
    "PressAgainTable",
    "StationTable",
]

TopicLevel = Annotated[str, AfterValidator(topic_level)]


class StationTable(Table):
    """The place of this gateway in the plant: the levels of its MQTT topics, how often it reports, and its pictures.

    Each level has 1 to 64 characters, no space, and none of + # / $.
    """

    prefix: TopicLevel = Field(default="gelgate", description="first level of every topic")
    site: TopicLevel = Field(default="site", description="second level: the plant")
    line: TopicLevel = Field(default="line", description="third level: the production line")
    station: TopicLevel = Field(
        default="station", description="fourth level: this gateway, unique on its line"
    )
    stats_s: float = Field(
        default=10.0,
        ge=0.5,
        le=60,
        description="seconds between two `stats`; disk, clock and receivers are checked as often",
    )
    # Two users: people, to whom both look alike, and programs of version 0.1, which read the PNG and its text chunks.
    heatmap: Literal["jpeg", "png"] = Field(
        default="jpeg",
        description="form of the picture of a press: jpeg; or png, as in version 0.1, six times as many bytes",
    )
    last_heatmap: bool = Field(
        default=False,
        description="retain the newest picture on `last/heatmap`, for dashboards and pages that start later; always "
        "where an `mqtt` sink has `home_assistant`",
    )

    @property
    def place(self) -> Place:
        return Place(self.site, self.line, self.station, self.prefix)


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
        default=None,
        description="several bundles: every folder with a manifest.json or a graph, and every .zip, in it",
    )
    shadows: tuple[Path, ...] = Field(
        default=(),
        description="bundles that are scored beside the one in use of the same part and position, and decide nothing; "
        "see operations.md",
    )
    takeover: Literal["on request", "by itself"] = Field(
        default="on request",
        description="whether a shadow takes the place of the bundle in use when adopt_shadow asks for it, or as soon "
        "as that request would not be refused and nobody has to answer for it (operations.md); one that was taken "
        "back waits for a request",
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

    press_again: Literal["never", "unsure"] = Field(
        default="never",
        description="unsure: a press a little above the threshold asks for a second one of the same piece, where the "
        "costs of [press_again] say that it pays; see operations.md",
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
        description="a press rests when its frame is like the one this long before, seconds; shorter takes "
        "frames of less force (0.12: 72 % of the press's force, 0.2: 96 %), longer loses presses "
        "that are held for a moment",
    )
    still_share: float = Field(
        default=ContactSettings.still_share,
        gt=0,
        lt=1,
        description="like: fewer than this share of the touched pixels have changed (a shearing fingertip "
        "changes 25 % and more, noise under 1 %)",
    )
    growth_share: float = Field(
        default=ContactSettings.growth_share,
        gt=0,
        lt=1,
        description="and the imprint has grown by no more than this share of itself (a ramp of 2 s grows 12 % "
        "and more in 0.2 s; 0.06 takes light ramps of a soft part for rest at half of their "
        "depth)",
    )
    settle_timeout_s: float = Field(
        default=ContactSettings.settle_timeout_s,
        gt=2,
        le=60,
        description="a press that does not rest within this time after its imprint last grew is not settled, "
        "seconds",
    )
    light_levels: float = Field(
        default=ContactSettings.light_levels,
        gt=0,
        le=100,
        description="fine relief of this many levels counts as contact: lower finds lighter and softer "
        "presses and, below 2.5, noise",
    )

    def settings(self, *, is_external: bool) -> ContactSettings:
        """Make the settings of `PressDetector`."""
        return ContactSettings(is_external=is_external, **self.model_dump())


class GelTable(Table):
    """When the gel is due, and what its scars mean for a press: see gel.md."""

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
    scars: Literal["masked", "named"] = Field(
        default="masked",
        description="masked: places of known scars are not judged, and each result states their area; named: they are "
        "judged, and a result that they fail has the cause `gel`",
    )
    unproven: Literal["off", "warn", "refuse"] = Field(
        default="warn",
        description="what a bundle does that is not yet proven on the mounted gel. off: nothing; warn: the alarm "
        "`gel_proof`; refuse: the same, and presses of parts are rejected; see gel.md",
    )
    most_blind_share: float = Field(
        default=0.05,
        ge=0,
        le=1,
        description="with more of a contact under masked scars no press passes, and a new gel is asked for",
    )
    heights: Path | None = Field(
        default=None,
        description="of `gelgate lab calibrate --heights`: sizes and depths of deviations, and `gelgate station "
        "heights`; see heights.md",
    )


def _database_file(path: Path) -> Path:
    """Refuse a name that SQLite reads as a database in memory, one for each connection. Errors: ValueError."""
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


class PressAgainTable(Table):
    """What presses and wrong verdicts cost, in any one unit: by that, and by the scores of the fit, a station decides
    when one more press of a piece pays. See operations.md.
    """

    missed_defect: float = Field(
        default=1000, ge=0, le=1e12, description="cost of a damaged piece that passes"
    )
    false_alarm: float = Field(default=100, ge=0, le=1e12, description="cost of a sound piece that fails")
    press: float = Field(default=1, ge=0, le=1e12, description="cost of one more press, in time and gel")
    defect_rate: float = Field(default=0.01, ge=0, le=1, description="share of damaged pieces")
    within_s: float = Field(
        default=30,
        ge=0.5,
        le=3600,
        description="a second press that does not come within this time is an alarm",
    )


class ArchiveTable(Table):
    """What verdicts were made from, so that `gelgate station replay` makes them again: see security.md.

    It lies next to the database. On a disk that is full, or has less room than `store.free_mb`, presses are inspected
    and not archived.
    """

    presses: int = Field(
        default=1000,
        ge=0,
        le=10_000_000,
        description="presses that are kept, the newest, and older ones that people spoke of, up to half; 0: none",
    )
    mb: float = Field(
        default=1000,
        ge=1,
        le=100_000_000,
        description="room for them; a press of a Mini is about 1 MB: camera frame, free gel, score map",
    )


class Config(Table):
    """The complete file."""

    version: Literal[1] = Field(description="the version of this format")
    station: StationTable = StationTable()
    device: PluginTable = Field(description="the sensor")
    overview: OverviewTable | None = Field(default=None, description="a camera that sees the part")
    inspection: InspectionTable
    contact: ContactTable = ContactTable()
    gel: GelTable = GelTable()
    reference: ReferenceTable = ReferenceTable()
    store: StoreTable = StoreTable()
    archive: ArchiveTable = ArchiveTable()
    press_again: PressAgainTable = PressAgainTable()
    piece: PieceTable | None = Field(default=None, description="a piece of several places")
    commands: CommandTable = CommandTable()
    confirm: ConfirmTable = ConfirmTable()
    metrics: MetricsTable = MetricsTable()
    sinks: list[SinkTable] = Field(min_length=1, description="where results go; one table each")
    triggers: list[TriggerTable] = Field(
        default_factory=list, description="pedals and buttons; one table each"
    )
    actuators: list[ActuatorTable] = Field(
        default_factory=list, description="lights and relays; one table each"
    )
    handshake: HandshakeTable | None = Field(default=None, description="a server for a PLC")
    feature: dict[str, dict[str, Any]] = Field(
        default_factory=dict,
        description="options of features of other packages, a table `[feature.NAME]` each",
    )

    @model_validator(mode="after")
    def _one_word_per_pedal(self) -> "Config":
        pedals: dict[str, list[tuple[str, Mapping[str, Any]]]] = {"good": [], "damaged": []}
        for table in self.triggers:
            pedals.get(table.action, []).append((table.plugin, table.options))
        if both := [plugin for plugin, options in pedals["good"] if (plugin, options) in pedals["damaged"]]:
            raise ValueError(
                f"two [[triggers]] of {both[0]} have equal options, so one press of one pedal says `good` and "
                "`damaged`; give each its own device, serial, key or line"
            )
        return self

    @property
    def keeps_heatmap(self) -> bool:
        """Say whether a dashboard asks for the retained picture: Home Assistant has no other."""
        asks = any(sink.plugin == "mqtt" and sink.options.get("home_assistant") for sink in self.sinks)
        return self.station.last_heatmap or asks

    @property
    def features(self) -> Mapping[str, bool]:
        """Say of each feature whether it is wanted, in the order in which a press goes through them."""
        commands = self.commands
        served = {*commands.unsigned, *commands.signed, *commands.page}
        return {
            "sensing_watch": True,
            "contact_state": True,
            "reference_press": bool(self.reference.pieces) or "reference_press" in served,
            "gel_date": True,
            "gel_proof": True,
            "overview": self.overview is not None,
            "shadow": True,
            "scars": True,
            "press_again": self.inspection.press_again != "never",
            "drift": True,
            "deviations": self.gel.heights is not None,
            "drawn_regions": "set_regions" in served,
            "piece": True,
            "outputs": bool(self.triggers or self.actuators),
            "handshake": self.handshake is not None,
            "black_box": self.archive.presses > 0,
            "snapshots": "snapshot" in served,
            "person_verdicts": True,
            "metrics": self.metrics.port is not None,
        }
