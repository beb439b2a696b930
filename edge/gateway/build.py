"""The composition root: from a configuration to the parts of a station, built in order and not yet started.

What belongs to one session of a sensor is made by the loop, when the first frame comes.
"""

import logging
import random
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

from edge import registry
from edge.acquisition import Acquisition
from edge.config import Config, sink_names
from edge.core.errors import GelgateError
from edge.core.ports import Clock, Device, Message, Sink
from edge.core.press_again import Costs
from edge.core.sink_context import PageRequests, Place, Station, client_id, topic_root
from edge.features.black_box.stage import BlackBox
from edge.features.gel_proof import GelProofWatch
from edge.features.outputs.opening import open_outputs
from edge.features.outputs.stage import Outputs
from edge.features.overview import OVERVIEW_STALL_S, Overview, say_overview_camera
from edge.features.press_again import PressAgain
from edge.features.press_stage import PressStage
from edge.features.reference_press import ReferenceGuard
from edge.features.scars import ScarWatch
from edge.features.snapshots import Snapshots
from edge.gateway.bundle_set import BundleSet
from edge.gateway.bundle_stage import BundleStage, OpenBundles
from edge.gateway.command_policy import policy_of
from edge.gateway.command_table import acknowledge_by_pedal, station_handlers, trigger_by_pedal
from edge.gateway.commands import Commands
from edge.gateway.description import describe_station
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.metrics import serve_metrics
from edge.gateway.opening import BundleOpener, Opened, device_opener, first_part, overview_opener
from edge.gateway.part_selection import PartSelection
from edge.gateway.preflight import Preflight
from edge.gateway.report import FreeSpace
from edge.gateway.sensing_watch import SensingWatch
from edge.gateway.station_loop import Parts, StationLoop
from edge.gateway.status import StationStatus
from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.publisher import Publisher, PublisherLock
from edge.messaging.sink_worker import RetainedState
from edge.messaging.status_payloads import StatePayload, availability_message, state_message
from edge.store.backup import migrate
from edge.store.database import SCHEMA_VERSION
from edge.store.gel_files import ReferenceFolder, ScarFolder
from edge.store.outbox import Bounds
from edge.store.press_archive import PressArchive
from edge.store.press_store import Store

__all__ = ["build"]

log = logging.getLogger(__name__)


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
    by default as it was at the start. labels: names the presses of references and studies; by default the reference
    presses that are asked for. Errors: ConfigError, BundleError, StoreError.
    """
    calls, retained_state = LoopCalls[StationLoop](), _retained_state(config)
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
    device = _opener(config, bundles[part].bundle.profile.controls, clock, closing, checked)
    acquisition = Acquisition(device, clock, status.sensor_changed)
    closing.callback(acquisition.close)
    stage = BundleStage(_staging(opener, read_again or (lambda: config)))
    closing.callback(stage.close)
    selection = PartSelection(bundles, part, stage, store, status, clock)
    free_space = FreeSpace(config.store.path, round(config.store.free_mb * 1e6))
    base = Base(config, clock, store, status, acquisition, selection, free_space, calls)
    stages = [item for item in _stages(base, labels) if item is not None]
    for item in stages:
        closing.callback(item.close)
    return Parts(
        stages=stages,
        selection=selection,
        contact=config.contact.settings(is_external=config.inspection.trigger == "command"),
        place=_place(config),
        store=store,
        references=ReferenceFolder(config.store.path.with_suffix(".references")),
        publisher=publisher,
        status=status,
        acquisition=acquisition,
        free_space=free_space,
        calls=calls,
        clock=clock,
        stats_s=config.station.stats_s,
    )


@dataclass(frozen=True)
class Base:
    """What stages are made from."""

    config: Config
    clock: Clock
    store: Store
    status: StationStatus
    acquisition: Acquisition
    selection: PartSelection
    free_space: FreeSpace
    calls: LoopCalls[StationLoop]


def _stages(base: Base, labels: PressStage | None) -> list[PressStage | None]:
    """List what a press goes through, in this order; None is not configured. A new feature of presses is one line."""
    config, clock, store, status = base.config, base.clock, base.store, base.status
    return [
        SensingWatch(status, store, clock),
        labels or ReferenceGuard(config.reference, store, status, clock),
        GelProofWatch(config.gel.unproven, store, status, status.set_unproven, clock),
        _overview(base),
        _scars(base),
        _press_again(base),
        _outputs(base),
        _black_box(base),
        _snapshots(base),
    ]


def _overview(base: Base) -> Overview | None:
    """Open the overview camera. Errors: ConfigError for a picture of the empty station that cannot be read."""
    table, clock = base.config.overview, base.clock
    if table is None:
        return None
    rules = table.rules()
    say_camera = partial(say_overview_camera, base.status, is_needed=rules.is_asking)
    opener = overview_opener(table, clock)
    camera = Acquisition(opener, clock, say_camera, depth=1, stall_after_s=OVERVIEW_STALL_S)
    return Overview(
        camera, rules, base.selection, clock, max_age_s=table.max_age_s, max_side_px=table.max_side_px
    )


def _scars(base: Base) -> ScarWatch:
    """Scars are kept next to the database."""
    table, folder = base.config.gel, base.config.store.path.with_suffix(".references")
    is_masking, share = table.scars == "masked", table.most_blind_share
    return ScarWatch(ScarFolder(folder), base.status, is_masking=is_masking, most_blind_share=share)


def _press_again(base: Base) -> PressAgain | None:
    if base.config.inspection.press_again != "unsure":
        return None
    table = base.config.press_again
    costs = Costs(table.missed_defect, table.false_alarm, table.press, table.defect_rate)
    return PressAgain(costs, table.within_s, base.clock, base.status)


def _outputs(base: Base) -> Outputs | None:
    """Open pedals, lights and relays. Errors: ConfigError."""
    if not (base.config.triggers or base.config.actuators):
        return None
    actions = {
        "trigger": partial(base.calls.post, trigger_by_pedal),
        "acknowledge": partial(base.calls.post, acknowledge_by_pedal),
    }
    return open_outputs(base.config, base.clock, base.status, actions)


def _black_box(base: Base) -> BlackBox | None:
    """Next to the database."""
    table, config = base.config.archive, base.config
    if not table.presses:
        return None
    folder, most_bytes = config.store.path.with_suffix(".archive"), round(table.mb * 1e6)
    archive = PressArchive(folder, table.presses, most_bytes, base.free_space.check)
    return BlackBox(archive, str(_place(config)), config.inspection.threads, base.status)


def _snapshots(base: Base) -> Snapshots | None:
    """Next to the database; off where the command is not served."""
    commands = base.config.commands
    if "snapshot" not in (*commands.signed, *commands.unsigned, *commands.page):
        return None
    folder, find_sensor = (
        base.config.store.path.with_suffix(".snapshots"),
        lambda: base.acquisition.status.identity,
    )
    return Snapshots(folder, base.clock, base.store, find_sensor, base.free_space.check)


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
    """Return the publisher with its sinks, not yet started. Errors: ConfigError."""
    sinks = _open_sinks(config, _sink_context(config, clock, retained_state, commands), closing)
    before = _names_before(config)
    return Publisher(
        config.store.path, sinks, retained_state, clock, random.Random(), lock=lock, before=before
    )


def _retained_state(config: Config) -> RetainedState:
    """Return the retained state with the station's description, which does not change while it runs."""
    retained_state = RetainedState()
    retained_state.announce(asyncapi_message(describe_station(config)))
    return retained_state


def _open_bundles(
    config: Config, clock: Clock, store: Store, checked: Preflight | None
) -> tuple[BundleOpener, BundleSet]:
    """Return the bundles of the check, or open them. Errors: BundleError, ConfigError: all must be usable."""
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
        serving = closing.enter_context(serve_metrics(config.metrics.port))

    def announce(message: Message) -> None:
        if serving is not None:
            serving.see(message)
        publish(message)

    return announce


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
        on_refused=commands.refuse,
        page=PageRequests(commands.page_verbs, commands.from_page, commands.refuse_at_page),
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
