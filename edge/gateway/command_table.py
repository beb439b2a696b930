"""The verbs of a station: those that every station has, and those of its features."""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from edge.clock import local_day
from edge.config import Config
from edge.core.errors import ConfigError, DeviceNotFound
from edge.core.ports import Message
from edge.core.suggest import suggestion
from edge.extras import find_version
from edge.gateway.commands import Change, Handler
from edge.gateway.features import load_every_feature, load_features
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.self_test import self_test
from edge.gateway.station_loop import StationLoop
from edge.messaging.alarm_payload import list_alarms
from edge.messaging.command_payloads import (
    AcknowledgeAlarmArguments,
    CommandArguments,
    NoArguments,
    ReplaceGelArguments,
    SelectPartArguments,
)
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.status_payloads import GelPayload
from edge.press_stage import Command, Data, PressStage
from edge.store.gel_ledger import GelRecord
from edge.store.press_counts import acknowledge_corrections

__all__ = [
    "ask_stages",
    "describe_station",
    "every_command",
    "station_commands",
    "station_handlers",
    "trigger_by_pedal",
]

log = logging.getLogger(__name__)

LoopCommand = Command[StationLoop, Any]


def _trigger(loop: StationLoop, arguments: NoArguments) -> Data:
    session = loop.need_session()
    refusal = session.trigger()
    if refusal is not None:
        raise ValueError(refusal)
    return {"state": session.contact_state}


def trigger_by_pedal(loop: StationLoop) -> None:
    """A pedal or button asks for a verdict. No one waits for an answer, so a refusal is in the log."""
    try:
        _trigger(loop, NoArguments())
    except (DeviceNotFound, ValueError) as error:
        log.warning("the trigger gave no verdict: %s", error)


def _relearn(loop: StationLoop, arguments: NoArguments) -> Data:
    session = loop.need_session()
    session.relearn()
    return {"state": session.contact_state}


def _replace_gel(loop: StationLoop, arguments: ReplaceGelArguments) -> Data:
    session, parts = loop.need_session(), loop.parts
    given, now_ns = (arguments.gel_id, arguments.limit_presses, arguments.note), parts.clock.time_ns()
    label = arguments.label
    if session.unrecorded:  # they would be counted on the new gel
        raise ValueError("a press waits to be recorded; see the alarm `store`, and replace the gel after it")

    def say(gel: GelRecord) -> list[Message]:
        """The new gel takes the place of the old one's count that waits for a receiver."""
        return [GelPayload.of(gel, now_ns).message()]

    gel = parts.store.replace_gel(session.gel.serial, now_ns, *given, make_messages=say, label=label)
    session.see_gel(gel)
    return {
        "gel_id": gel.gel_id,
        "presses": gel.presses,
        "limit_presses": gel.limit_presses,
        "remarks": gel.list_remarks(local_day(now_ns)),
    }


def _select_part(loop: StationLoop, arguments: SelectPartArguments) -> Data:
    selection = loop.parts.selection
    if arguments.name is not None:
        part = selection.bundles.find_by_name(arguments.name)
    else:
        part = selection.bundles.find(arguments.part or "", arguments.position)
    selection.select(part, is_pressed=loop.is_pressed)
    return {**_selection(loop), "is_waiting": selection.is_waiting}


def _reload(loop: StationLoop, arguments: NoArguments) -> Data:
    loop.parts.selection.reload()
    return {"is_waiting": True}


def _acknowledge_alarm(loop: StationLoop, arguments: AcknowledgeAlarmArguments) -> Data:
    alarm, raised, known = arguments.alarm, _alarms(loop), list_alarms()
    if alarm not in known:
        raise ValueError(f"no alarm is named '{alarm}'; {suggestion(alarm, sorted(known))}")
    if not known[alarm].stays:
        raise ValueError(
            f"the alarm '{alarm}' ends by itself when its reason is over; see docs/operations.md"
        )
    if alarm not in raised:
        raise ValueError(f"the alarm '{alarm}' is not raised; raised: {', '.join(raised) or 'none'}")
    if alarm == "outbox_full":
        loop.report.acknowledge_drops()
    elif alarm == "counts":
        loop.parts.store.write("acknowledging corrected counts", acknowledge_corrections)
    loop.parts.status.say(alarm, None)  # first: what a stage's own thread raises from here on stays
    for stage in loop.parts.stages:
        stage.acknowledge(alarm)
    return {"alarms": _alarms(loop)}


COMMANDS: Final[Sequence[LoopCommand]] = (
    Command(
        "trigger",
        NoArguments,
        _trigger,
        'score the press that is held now; the way to inspect with `trigger = "command"`',
    ),
    Command(
        "relearn",
        NoArguments,
        _relearn,
        "learn the picture of the free gel again; nothing may touch it",
        "nothing is inspected until the gel is seen free",
    ),
    Command(
        "replace_gel",
        ReplaceGelArguments,
        _replace_gel,
        "record that a new gel is mounted, count from 0 and learn its picture; one with the serial of an earlier gel "
        "counts on. `remarks`: sentences for the person who mounts it",
        "the record of wear",
    ),
    Command(
        "select_part",
        SelectPartArguments,
        _select_part,
        "inspect another position or part from the next press on; during a press it waits for its end (`is_waiting`)",
        "the bundle that inspects",
    ),
    Command(
        "reload",
        NoArguments,
        _reload,
        "open the configured bundles again while presses are judged as before; `info` and the alarm `bundle` have the "
        "outcome",
        "the bundles",
    ),
    Command(
        "acknowledge_alarm",
        AcknowledgeAlarmArguments,
        _acknowledge_alarm,
        "end an alarm that stays after its reason is over: `pulse`, `outbox_full`, `counts`, `drift` or `takeover`; "
        "the others end by themselves. `alarms`: those that remain",
        "the alarm",
    ),
    Command(
        "self_test",
        NoArguments,
        lambda loop, arguments: self_test(loop.parts),
        "score the golden frames now, check the database, the sensor, the receivers and the disk; `parts` has each "
        "outcome, `is_ok` all of them together. Other requests wait for its end, up to 15 s",
    ),
)
"""Those of every station."""


def every_command() -> Sequence[LoopCommand]:
    """Return all commands, with those of every installed feature; docs/mqtt.md prints them."""
    return [*COMMANDS, *_commands_of(load_every_feature().values())]


def station_commands(config: Config) -> Sequence[LoopCommand]:
    """Return the commands that this station can serve. Errors: ConfigError for a verb in [commands]
    that no one has, and for one that two features serve."""
    commands = [*COMMANDS, *_commands_of(load_features(config).values())]
    verbs, table = Counter(command.verb for command in commands), config.commands
    if twice := [verb for verb, count in verbs.items() if count > 1]:
        raise ConfigError(
            f"features: the request '{twice[0]}' is served twice; uninstall one of the packages that bring it"
        )
    for verb in (*table.unsigned, *table.signed, *table.page):
        if verb not in verbs:
            known = sorted(command.verb for command in every_command())
            raise ConfigError(f"commands: no command is named '{verb}'; {suggestion(verb, known)}")
    return commands


def describe_station(config: Config) -> DescribedStation:
    """Describe the station of this configuration, with the commands that it serves."""
    commands = config.commands
    served = {*commands.unsigned, *commands.signed}
    return DescribedStation(
        root=config.station.place.root,
        place=str(config.station.place),
        version=find_version("gelgate"),
        commands=[command for command in station_commands(config) if command.verb in served],
        signed=commands.signed,
        picture_type=f"image/{config.station.heatmap}",
        keeps_heatmap=config.keeps_heatmap,
    )


def _commands_of(features: Iterable[type[PressStage]]) -> list[LoopCommand]:
    return [
        replace(command, do=partial(_ask_stage, feature, command))
        for feature in features
        for command in feature.commands
    ]


def _ask_stage(
    feature: type[PressStage], command: Command[Any, Any], loop: StationLoop, arguments: CommandArguments
) -> Data | Callable[[], Data]:
    stage = loop.find(feature)
    if stage is None:
        raise ValueError(
            f"'{command.verb}' is off now: it is not configured, or a gauge study runs on this station"
        )
    return command.do(stage, arguments)


def ask_stages(stages: Iterable[PressStage], verb: str, arguments: Mapping[str, Any]) -> Data:
    """Do the request of one stage for another one, at once. Errors: GelgateError, ValueError."""
    for stage in stages:
        for command in stage.commands:
            if command.verb == verb:
                data = command.do(stage, command.arguments.of(arguments))
                return data() if callable(data) else data
    raise ValueError(f"'{verb}' is off: it is not configured")


def station_handlers(calls: LoopCalls[StationLoop], commands: Iterable[LoopCommand]) -> dict[str, Handler]:
    """Verb to handler. Arguments are read on the caller's thread; the station's loop does the rest."""
    return {command.verb: partial(_ask, calls, command) for command in commands}


def _ask(calls: LoopCalls[StationLoop], command: LoopCommand, arguments: Mapping[str, Any]) -> Change:
    wish = command.arguments.of(arguments)

    def do(loop: StationLoop) -> tuple[Data | Callable[[], Data], Data, Data]:
        before = _facts(loop)
        return command.do(loop, wish), before, _facts(loop)

    data, before, after = calls.ask(do)
    return Change(data() if callable(data) else data, before, after)


def _facts(loop: StationLoop) -> Data:
    """Return what is known of the station; before the first frame the gel is not."""
    known = {**_selection(loop), "alarms": _alarms(loop)}
    if loop.session is None:
        return known
    return {**loop.session.gel.facts, "state": loop.session.contact_state, **known}


def _selection(loop: StationLoop) -> Data:
    part, bundle = loop.parts.selection.part, loop.parts.selection.inspector.bundle
    return {"part": part.part, "position": part.position, "bundle_id": bundle.digest}


def _alarms(loop: StationLoop) -> list[str]:
    """Return those that are raised, in order."""
    return sorted(loop.parts.status.view().alarms)
