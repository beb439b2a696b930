"""The composition root: from a configuration to a station, its parts built in order and not yet started.

What belongs to one session of a sensor is made by the loop, when the first frame comes.
"""

import logging
import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

from edge import registry
from edge.acquisition import Acquisition
from edge.config import Config, sink_names
from edge.core.errors import StoreError
from edge.core.ports import Clock, Device, Message, Sink
from edge.core.sentence import Sentence
from edge.core.sink_context import PageRequests, Station
from edge.gateway.bundle_set import BundleSet
from edge.gateway.command_table import (
    ask_stages,
    describe_station,
    station_commands,
    station_handlers,
    trigger_by_pedal,
)
from edge.gateway.commands import Commands, policy_of
from edge.gateway.features import load_features, read_options
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.opening import BundleOpener, device_opener, explain_first, first_part
from edge.gateway.part_selection import PartSelection
from edge.gateway.pictures import Pictures, PressDrawing
from edge.gateway.preflight import Preflight
from edge.gateway.recorder import draw_archived
from edge.gateway.report import FreeSpace
from edge.gateway.station_loop import OnPress, Parts, StationLoop
from edge.gateway.status import StationStatus
from edge.messaging.descriptions.asyncapi import asyncapi_message
from edge.messaging.publisher import Publisher, PublisherLock
from edge.messaging.result_payload import PressFiles, empty_last_heatmap
from edge.messaging.sink_worker import RetainedState
from edge.messaging.status_payloads import StatePayload, availability_message
from edge.press_stage import PressStage, StageParts
from edge.store.backup import migrate
from edge.store.bundles_in_use import read_selected, read_takeover
from edge.store.database import SCHEMA_VERSION
from edge.store.outbox import Bounds
from edge.store.press_store import Store

__all__ = ["open_station"]

log = logging.getLogger(__name__)


@contextmanager
def open_station(
    config: Config,
    clock: Clock,
    on_press: OnPress = lambda report: None,
    checked: Preflight | None = None,
    read_again: Callable[[], Config] | None = None,
    stages: Mapping[str, PressStage] | None = None,
) -> Iterator[StationLoop]:
    """Build every part, and close them in reverse; a part that cannot work is refused before anything is started.

    A missing sensor is a fault while running, not an error: it is reported, and the station waits for it.

    on_press: called by the loop with every recorded press. checked: the parts that the check before the start has
    opened. read_again: reads the configuration at a reload; by default it is as at the start. stages: they take the
    place of the features of these names. Errors: ConfigError, BundleError, StoreError.
    """
    with ExitStack() as closing:
        parts = _build(config, clock, closing, checked, read_again or (lambda: config), stages or {})
        yield StationLoop(parts, on_press)


def _build(
    config: Config,
    clock: Clock,
    closing: ExitStack,
    checked: Preflight | None,
    read_again: Callable[[], Config],
    stages: Mapping[str, PressStage],
) -> Parts:
    """Build the parts. closing: gets the calls that close them."""
    calls, retained_state = LoopCalls[StationLoop](clock), RetainedState()
    retained_state.announce(asyncapi_message(describe_station(config)))
    lock, store = _open_store(config, clock, closing)
    opener, bundles = _open_bundles(config, clock, store, checked)
    selected = store.read("reading the selected part", read_selected)
    part = first_part(config.inspection, bundles, selected)
    if why := explain_first(config.inspection, bundles, selected):
        log.warning("%s is inspected: %s", part, why)
    handlers = station_handlers(calls, station_commands(config))
    commands = Commands(handlers, policy_of(config), store, clock, config.commands.requests_per_minute)
    by_name: dict[str, PressStage] = {}
    draw_again = _drawer(config, store, lambda: selection.bundles, by_name.values())
    context = _sink_context(config, clock, store, retained_state, commands, draw_again)
    publisher = _open_publisher(config, context, retained_state, clock, lock)
    listeners: list[Callable[[Message], object]] = [publisher.announce]
    status = StationStatus(lambda message: [hear(message) for hear in listeners], clock)
    closing.callback(publisher.stop)
    _forget_last_heatmap(config, store, retained_state)
    pictures = Pictures(store, publisher.wake, draw_again, keeps_last=config.keeps_heatmap)
    closing.callback(pictures.close)
    status.set_waiting_for(Sentence("the sensor"))
    device = _opener(config, bundles[part].bundle.profile.controls, clock, checked)
    acquisition = Acquisition(device, clock, status.sensor_changed)
    closing.callback(acquisition.close)
    selection = PartSelection(
        bundles, part, lambda in_use: opener.open_again(config, read_again(), in_use), store, status, clock
    )
    closing.callback(selection.close)
    free_space = FreeSpace(config.store.path, round(config.store.free_mb * 1e6))
    stage_parts = StageParts(
        config,
        clock,
        store,
        status,
        selection,
        find_sensor=lambda: acquisition.status.identity,
        find_low_space=free_space.check,
        post=lambda do: calls.post(lambda loop: do()),
        trigger=partial(calls.post, trigger_by_pedal),
        do=lambda verb, arguments: ask_stages(by_name.values(), verb, arguments),
        announce=status.announce,
        listen=listeners.append,
    )
    by_name.update(_open_stages(stage_parts, stages, closing))
    closing.callback(status.stopped)
    opened = list(by_name.values())
    for stage in (stage for stage in opened if stage.is_awaited):
        closing.callback(stage.close)
    return Parts(
        config, opened, selection, store, publisher, status, acquisition, pictures, free_space, calls, clock
    )


def _drawer(
    config: Config, store: Store, find_bundles: Callable[[], BundleSet], stages: Iterable[PressStage]
) -> Callable[[str], PressFiles]:
    """Return what draws an archived press by its id. find_bundles, stages: as they are when it draws."""

    def draw_again(press_id: str) -> PressFiles:
        bundles = find_bundles()
        opened = [bundle.bundle for bundle in (*bundles.bundles.values(), *bundles.shadows.values())]
        return draw_archived(press_id, store, opened, config.station.heatmap, list(stages))

    return draw_again


def _forget_last_heatmap(config: Config, store: Store, retained_state: RetainedState) -> None:
    """Empty `last/heatmap`, where an earlier configuration may have left a picture. Errors: StoreError."""
    if config.keeps_heatmap:
        return
    empty = empty_last_heatmap()
    retained_state.announce(empty)
    doing, waiting = "forgetting the retained picture", (empty.topic,)
    if store.read(doing, lambda c: c.execute("SELECT 1 FROM outbox WHERE topic = ?", waiting).fetchone()):
        store.write(doing, lambda c: c.execute("DELETE FROM outbox WHERE topic = ?", waiting))


def _open_stages(
    parts: StageParts, instead: Mapping[str, PressStage], closing: ExitStack
) -> dict[str, PressStage]:
    """Open the features that are configured. instead: of features of these names. Errors: ConfigError."""
    features, stages = load_features(parts.config), dict[str, PressStage]()
    for name in (*(name for name in instead if name not in features), *features):
        stage = instead.get(name)
        if stage is None:
            feature = features[name]
            stage = feature.open(replace(parts, options=read_options(name, feature, parts.config)))
        if stage is not None:
            stage.foreign_name = name if name in features and name not in parts.config.features else None
            closing.callback(stage.close)
            stages[name] = stage
    return stages


def _open_bundles(
    config: Config, clock: Clock, store: Store, checked: Preflight | None
) -> tuple[BundleOpener, BundleSet]:
    """Return the bundles of the check, or open them. Errors: BundleError, ConfigError: all must be usable."""
    is_open = checked is not None and bool(checked.bundles.bundles)
    opener = checked.opener if checked and is_open else BundleOpener(None, config.inspection.threads, clock)
    opener.newest = store.newest_revision
    opener.taken = lambda part: store.read("reading takeovers", partial(read_takeover, part=part))
    if checked and is_open:
        return opener, checked.bundles
    opened = opener.open(config.inspection)
    for error in opened.faults.values():
        raise error
    return opener, opened.bundles


def _names_before(config: Config) -> dict[str, str]:
    """The names that sinks had in databases of version 0.2.0 and before, where these are clear: those of a plugin used
    once. Where it was used several times, what they have is sent again."""
    names = dict(zip((sink.plugin for sink in config.sinks), sink_names(config.sinks), strict=True))
    counts = Counter(sink.plugin for sink in config.sinks)
    return {plugin: name for plugin, name in names.items() if counts[plugin] == 1 and name != plugin}


def _open_store(config: Config, clock: Clock, closing: ExitStack) -> tuple[PublisherLock, Store]:
    """The lock first: a second gateway must not migrate the tables of this one, or take its place at the broker."""
    path = config.store.path
    lock = PublisherLock(path)
    closing.callback(lock.close)
    before, copy = migrate(path) if path.is_file() else (0, None)
    if copy is not None:
        log.warning(
            "database %s migrated from version %d to %d; as it was: %s", path, before, SCHEMA_VERSION, copy
        )
    bounds = Bounds(round(config.store.outbox_mb * 1e6), config.store.outbox_days * 86400)
    store = Store(path, bounds, config.gel.limit_presses, config.gel.warn_fraction, clock.monotonic_ns)
    return lock, closing.enter_context(store)


def _sink_context(
    config: Config,
    clock: Clock,
    store: Store,
    retained_state: RetainedState,
    commands: Commands,
    draw_again: Callable[[str], PressFiles],
) -> Station:
    lost = StatePayload(time_ns=clock.time_ns(), state="lost", reason="the gateway ended without a message")
    return Station(
        root=config.station.place.root,
        client_id=config.station.place.client_id,
        will=lost.message(),
        offline=availability_message(is_online=False),
        birth=retained_state.all,
        on_command=commands,
        on_refused=commands.refuse,
        page=PageRequests(commands.page_verbs, commands.from_page, commands.refuse_at_page),
        picture_type=f"image/{config.station.heatmap}",
        draw=lambda press_id: PressDrawing(press_id, partial(draw_again, press_id)).draw_now().draw().sheet,
        earlier=partial(_list_earlier, store),
    )


def _list_earlier(store: Store, most: int) -> list[dict[str, Any]]:
    """Return what the history has of the newest results, oldest first; only the page asks."""
    names = ("press_id", "sequence", "part", "position", "time_ns", "cause", "verdict", "score_ratio")
    query = (
        "SELECT press_id, number, part, position, time_ns, cause, nullif(verdict, 'error'), "
        "CASE WHEN threshold > 0 THEN score / threshold END FROM presses ORDER BY number DESC LIMIT ?"
    )
    try:
        rows = store.read("reading the newest results", lambda it: it.execute(query, (most,)).fetchall())
    except StoreError as error:
        log.warning("the presses of before the start are not shown: %s", error)
        return []
    earlier = [dict(zip(names, row, strict=True)) for row in reversed(rows)]
    return [{**one, "time_ms": one["time_ns"] // 1_000_000} for one in earlier]


def _open_publisher(
    config: Config, context: Station, retained_state: RetainedState, clock: Clock, lock: PublisherLock
) -> Publisher:
    """Open the sinks for the publisher, which alone closes them: it waits for none that does not return."""
    path, before = config.store.path, _names_before(config)
    sinks: dict[str, Sink] = {}
    with ExitStack() as opened:
        for name, chosen in zip(sink_names(config.sinks), config.sinks, strict=True):
            plugin = registry.sink(chosen.plugin)
            sinks[name] = sink = plugin.open(plugin.Options.model_validate(chosen.options), context)
            opened.callback(sink.close)
        publisher = Publisher(path, sinks, retained_state, clock, random.Random(), lock=lock, before=before)
        opened.pop_all()
    return publisher


def _opener(
    config: Config, controls: Mapping[str, int], clock: Clock, checked: Preflight | None
) -> Callable[[], Device]:
    """Opens the sensor; the first call returns the one that the check before the start has opened, the others open the
    same one again: a virtual sensor goes on where it was."""
    again = (checked.open_device if checked else None) or device_opener(config.device, controls, clock)
    waiting = [checked.device] if checked and checked.device else []
    return lambda: waiting.pop() if waiting else again()
