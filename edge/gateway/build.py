"""The composition root: from a configuration to the parts of a station, built in order and not yet started.

What belongs to one session of a sensor is made by the loop, when the first frame comes.
"""

import logging
import random
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Final

from edge import registry
from edge.config import Config, sink_names
from edge.core.errors import GelgateError
from edge.core.ports import Clock, Device, Message, Sink
from edge.core.press_again import Costs
from edge.core.sink_context import PageRequests, Place, Station, client_id, topic_root
from edge.gateway.acquisition import Acquisition
from edge.gateway.admission import Admission, SelectByCode
from edge.gateway.black_box import BlackBox
from edge.gateway.bundle_set import BundleSet
from edge.gateway.bundle_stage import BundleStage, OpenBundles
from edge.gateway.command_policy import policy_of
from edge.gateway.command_table import station_handlers
from edge.gateway.commands import Commands
from edge.gateway.description import described
from edge.gateway.digital_io.outputs import Outputs
from edge.gateway.free_space import FreeSpace
from edge.gateway.gel_proof_watch import GelProofWatch
from edge.gateway.io_opening import station_io
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.metrics import served
from edge.gateway.opening import BundleOpener, Opened, device_opener, first_part, overview_opener
from edge.gateway.overview import Overview
from edge.gateway.part_selection import PartSelection
from edge.gateway.preflight import Preflight
from edge.gateway.press_again import AgainRule, PressAgain
from edge.gateway.press_stage import PressStage
from edge.gateway.reference_guard import ReferenceGuard
from edge.gateway.scar_watch import ScarSettings, ScarWatch
from edge.gateway.sensing_watch import SensingWatch
from edge.gateway.snapshots import Snapshots
from edge.gateway.station_loop import StationLoop
from edge.gateway.station_parts import Parts
from edge.gateway.status import StationStatus
from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.publisher import Publisher
from edge.messaging.publisher_lock import PublisherLock
from edge.messaging.retained_state import RetainedState
from edge.messaging.status_payloads import StatePayload, availability_message, state_message
from edge.store.backup import migrate
from edge.store.outbox import Bounds
from edge.store.press_archive import PressArchive
from edge.store.press_store import Store
from edge.store.reference_files import ReferenceFolder
from edge.store.scar_files import ScarFolder
from edge.store.schema import SCHEMA_VERSION

__all__ = ["build"]

log = logging.getLogger(__name__)

# An overview camera may give one picture a second.
OVERVIEW_STALL_S: Final = 5.0


def build(
    config: Config,
    clock: Clock,
    closing: ExitStack,
    checked: Preflight | None = None,
    read_again: Callable[[], Config] | None = None,
    labels: PressStage | None = None,
) -> Parts:
    """Every part; a part that cannot work is refused here. closing: gets the calls that close the parts, in reverse.

    checked: the parts that the check before the start has opened. read_again: the configuration as it is at a reload;
    by default as it was at the start. labels: which presses are no part's; by default the reference presses that are
    asked for. Errors: ConfigError, BundleError, StoreError.
    """
    table, calls, retained_state = config.station, LoopCalls[StationLoop](), _retained_state(config)
    # The lock first: a second gateway must not migrate the tables of this one, or take its place at the broker.
    lock = PublisherLock(config.store.path)
    closing.callback(lock.close)
    store = closing.enter_context(_open_store(config, clock))
    opener, bundles = _open_bundles(config, clock, store, checked)
    part = first_part(config.inspection, bundles, store.read_selected())
    commands = _commands(config, calls, store, clock)
    publisher = _publisher(config, clock, retained_state, commands, closing, lock)
    status = StationStatus(_announcer(config, publisher.announce, closing), clock)
    closing.callback(publisher.stop)
    closing.callback(status.stopped)
    status.set_waiting_for("the sensor")
    io = station_io(config, clock, status, calls)
    closing.callback(io.close)
    device = _opener(config, bundles[part].bundle.profile.controls, clock, closing, checked)
    acquisition = Acquisition(device, clock, status.sensor_changed)
    closing.callback(acquisition.close)
    stage = BundleStage(_staging(opener, read_again or (lambda: config)))
    closing.callback(stage.close)
    reference = None if labels else ReferenceGuard(config.reference, store, status, clock)
    return Parts(
        selection=PartSelection(bundles, part, stage, store, status, clock),
        stage=stage,
        contact=config.contact.settings(is_external=config.inspection.trigger == "command"),
        place=_place(config),
        store=store,
        free_space=_free_space(config),
        references=ReferenceFolder(config.store.path.with_suffix(".references")),
        retained_state=retained_state,
        publisher=publisher,
        status=status,
        acquisition=acquisition,
        calls=calls,
        clock=clock,
        io=io,
        snapshots=_snapshots(config, clock, closing),
        black_box=_black_box(config),
        reference=reference,
        proof=GelProofWatch(config.gel.unproven, store, status, clock),
        sensing=SensingWatch(status, clock),
        stages=partial(_stages, config, labels),
        overview=_overview(config, clock, status, closing),
        stats_s=table.stats_s,
    )


def _commands(config: Config, calls: LoopCalls[StationLoop], store: Store, clock: Clock) -> Commands:
    handlers = station_handlers(calls)
    policy = policy_of(config, frozenset(handlers))
    return Commands(handlers, policy, store, clock, config.commands.requests_per_minute)


def _publisher(
    config: Config,
    clock: Clock,
    retained_state: RetainedState,
    commands: Commands,
    closing: ExitStack,
    lock: PublisherLock,
) -> Publisher:
    """With its sinks, and not yet started. Errors: ConfigError."""
    sinks = _open_sinks(config, _sink_context(config, clock, retained_state, commands), closing)
    before = _names_before(config)
    return Publisher(
        config.store.path, sinks, retained_state, clock, random.Random(), lock=lock, before=before
    )


def _retained_state(config: Config) -> RetainedState:
    """With the station's description, which does not change while it runs."""
    retained_state = RetainedState()
    retained_state.announce(asyncapi_message(described(config)))
    return retained_state


def _open_bundles(
    config: Config, clock: Clock, store: Store, checked: Preflight | None
) -> tuple[BundleOpener, BundleSet]:
    """Those of the check, or opened here. Errors: BundleError, ConfigError: at a start every bundle must be usable."""
    if checked is not None and checked.bundles.bundles:
        opener, bundles = checked.opener, checked.bundles
        opener.newest = store.newest_revision
        return opener, bundles
    opener = BundleOpener(None, config.inspection.threads, clock)
    opener.newest = store.newest_revision
    opened = opener.open(config.inspection)
    for error in opened.faults.values():
        raise error
    return opener, opened.bundles


def _staging(opener: BundleOpener, read_again: Callable[[], Config]) -> OpenBundles:
    """Opens what is configured at the time of a reload."""

    def open_bundles(in_use: BundleSet) -> Opened | GelgateError:
        try:
            return opener.open(read_again().inspection, in_use)
        except GelgateError as error:
            return error

    return open_bundles


def _announcer(
    config: Config, publish: Callable[[Message], object], closing: ExitStack
) -> Callable[[Message], None]:
    """Status messages go to the receivers, and to the metrics where they are served. Errors: ConfigError."""
    serving = None
    if config.metrics.port is not None:
        serving = closing.enter_context(served(config.metrics.port))

    def announce(message: Message) -> None:
        if serving is not None:
            serving.see(message)
        publish(message)

    return announce


def _overview(config: Config, clock: Clock, status: StationStatus, closing: ExitStack) -> Overview | None:
    """Errors: ConfigError for a picture of the empty station that cannot be read."""
    table = config.overview
    if table is None:
        return None
    rules = table.rules()
    changed = partial(status.overview_changed, is_needed=rules.is_asking)
    camera = Acquisition(
        overview_opener(table, clock), clock, changed, depth=1, stall_after_s=OVERVIEW_STALL_S
    )
    overview = Overview(camera, rules, clock, max_age_s=table.max_age_s, max_side_px=table.max_side_px)
    closing.callback(overview.close)
    return overview


def _snapshots(config: Config, clock: Clock, closing: ExitStack) -> Snapshots:
    """Next to the database; off where it is not served."""
    is_served = "snapshot" in (*config.commands.signed, *config.commands.unsigned, *config.commands.page)
    snapshots = Snapshots(config.store.path.with_suffix(".snapshots") if is_served else None, clock)
    closing.callback(snapshots.close)
    return snapshots


def _free_space(config: Config) -> FreeSpace:
    return FreeSpace(config.store.path, round(config.store.free_mb * 1e6))


def _black_box(config: Config) -> BlackBox:
    """Next to the database."""
    table = config.archive
    archive = PressArchive(
        config.store.path.with_suffix(".archive"),
        table.presses,
        round(table.mb * 1e6),
        _free_space(config).check,
    )
    return BlackBox(archive, str(_place(config)), config.inspection.threads)


def _stages(
    config: Config, labels: PressStage | None, parts: Parts, select: SelectByCode
) -> list[PressStage]:
    """List what a press goes through, in this order: a new feature of presses is one more line."""
    return [
        parts.sensing,
        *filter(None, (parts.reference, labels)),
        parts.proof,
        *([Admission(parts.overview, parts.selection, select)] if parts.overview else []),
        _scars(config, parts),
        _press_again(config, parts.status, parts.clock),
        Outputs(parts.io, parts.clock),
    ]


def _scars(config: Config, parts: Parts) -> ScarWatch:
    settings = ScarSettings(config.gel.scars == "masked", config.gel.most_blind_share)
    return ScarWatch(ScarFolder(parts.references.folder), settings, parts.status)


def _press_again(config: Config, status: StationStatus, clock: Clock) -> PressAgain:
    table = config.press_again
    costs = Costs(table.missed_defect, table.false_alarm, table.press, table.defect_rate)
    rule = AgainRule(config.inspection.press_again == "unsure", costs, table.within_s)
    return PressAgain(rule, clock, status.press_again)


def _place(config: Config) -> Place:
    return Place(config.station.site, config.station.line, config.station.station)


def _names_before(config: Config) -> dict[str, str]:
    """The names that sinks had in databases of version 0.2.0 and before, where these are clear: those of a plugin used
    once. Where it was used several times, what they have is sent again."""
    names = dict(zip((sink.plugin for sink in config.sinks), sink_names(config.sinks), strict=True))
    counts = Counter(sink.plugin for sink in config.sinks)
    return {plugin: name for plugin, name in names.items() if counts[plugin] == 1 and name != plugin}


def _open_store(config: Config, clock: Clock) -> Store:
    path = config.store.path
    before, copy = migrate(path) if path.is_file() else (0, None)
    if copy is not None:
        log.warning(
            "database %s migrated from version %d to %d; as it was: %s", path, before, SCHEMA_VERSION, copy
        )
    bounds = Bounds(round(config.store.outbox_mb * 1e6), config.store.outbox_days * 86400)
    return Store(path, bounds, config.gel.limit_presses, config.gel.warn_fraction, clock.monotonic_ns)


def _sink_context(config: Config, clock: Clock, retained_state: RetainedState, commands: Commands) -> Station:
    table = config.station
    lost = StatePayload(time_ns=clock.time_ns(), state="lost", reason="the gateway ended without a message")
    return Station(
        root=topic_root(table.prefix, table.site, table.line, table.station),
        client_id=client_id(table.prefix, table.site, table.line, table.station),
        will=state_message(lost),
        offline=availability_message(is_online=False),
        birth=retained_state.all,
        on_command=commands,
        on_refused=commands.refused,
        page=PageRequests(commands.page_verbs, commands.from_page, commands.refused_at_page),
    )


def _open_sinks(config: Config, context: Station, closing: ExitStack) -> dict[str, Sink]:
    sinks: dict[str, Sink] = {}
    for name, chosen in zip(sink_names(config.sinks), config.sinks, strict=True):
        plugin = registry.sink(chosen.plugin)
        sinks[name] = sink = plugin.open(plugin.Options.model_validate(chosen.options), context)
        closing.callback(sink.close)  # has no effect after the publisher's own closing
    return sinks


def _opener(
    config: Config, controls: Mapping[str, int], clock: Clock, closing: ExitStack, checked: Preflight | None
) -> Callable[[], Device]:
    """Opens the sensor; the first call returns the one that the check before the start has opened, the others open the
    same one again: a virtual sensor goes on where it was."""
    again = (checked.open_device if checked else None) or device_opener(config.device, controls, clock)
    first = checked.take_device() if checked else None
    if first is None:
        return again
    closing.callback(first.close)  # in case no one takes it
    waiting = [first]
    return lambda: waiting.pop() if waiting else again()
