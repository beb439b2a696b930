"""The verbs of a station: arguments, what each does, and its text in the manual."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic, TypeVar

from edge.core.errors import DeviceNotFound
from edge.core.suggest import suggestion
from edge.features.gel_proof import GelProofWatch
from edge.features.outputs.stage import Outputs
from edge.features.reference_press import ReferenceGuard
from edge.features.snapshots import KEPT, KEPT_BYTES, Snapshots
from edge.gateway.commands import Change, Handler
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.self_test import self_test
from edge.gateway.station_loop import StationLoop
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.command_payloads import (
    AcknowledgeAlarmArguments,
    CommandArguments,
    NoArguments,
    ReferencePressArguments,
    ReplaceGelArguments,
    SelectPartArguments,
    SnapshotArguments,
)

__all__ = ["COMMANDS", "Command", "acknowledge_by_pedal", "station_handlers", "trigger_by_pedal"]

log = logging.getLogger(__name__)

A = TypeVar("A", bound=CommandArguments)

Data = Mapping[str, Any]


@dataclass(frozen=True)
class Command(Generic[A]):
    """One verb: its arguments' model, the loop's action, and its text in the manual."""

    verb: str
    arguments: type[A]
    do: Callable[[StationLoop, A], Data | Callable[[], Data]]
    """Returns the data of the response, plain JSON, or what makes them on the requester's thread while the loop goes
    on. Errors of both: GelgateError, ValueError."""
    help: str
    changes: str = ""
    """What it changes for good, for the manual; empty for nothing."""


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


def acknowledge_by_pedal(loop: StationLoop) -> None:
    """A person has seen the last verdict, and the pulses that were not given."""
    if (outputs := loop.find(Outputs)) is not None:
        outputs.acknowledge()


def _relearn(loop: StationLoop, arguments: NoArguments) -> Data:
    session = loop.need_session()
    session.relearn()
    return {"state": session.contact_state}


def _replace_gel(loop: StationLoop, arguments: ReplaceGelArguments) -> Data:
    session, parts = loop.need_session(), loop.parts
    given = (arguments.gel_id, arguments.limit_presses, arguments.note)
    session.see_gel(parts.store.replace_gel(session.gel.serial, parts.clock.time_ns(), *given))
    gel = session.gel
    return {"gel_id": gel.gel_id, "presses": gel.presses, "limit_presses": gel.limit_presses}


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


def _reference_press(loop: StationLoop, arguments: ReferencePressArguments) -> Data:
    guard = loop.find(ReferenceGuard)
    if guard is None:
        raise ValueError("a gauge study runs on this station; ask for a reference press after it")
    if arguments.cancel:
        guard.cancel()
        return {"is_waiting": False}
    label = guard.request(arguments.piece, is_start=arguments.restart)
    return {"piece": label.piece, "is_waiting": True, "within_s": guard.within_s}


def _prove_gel(loop: StationLoop, arguments: NoArguments) -> Data:
    watch = loop.find(GelProofWatch)
    if watch is None:
        raise ValueError("this station does not watch whether a bundle is proven on its gel")
    proof = watch.prove()
    return {"presses": proof.presses, "alarms": proof.alarms, "rate": proof.rate}


def _acknowledge_alarm(loop: StationLoop, arguments: AcknowledgeAlarmArguments) -> Data:
    alarm, raised = arguments.alarm, _alarms(loop)
    if alarm not in ALARMS:
        raise ValueError(f"no alarm is named '{alarm}'; {suggestion(alarm, sorted(ALARMS))}")
    outputs = loop.find(Outputs)
    staying = {
        "pulse": outputs.acknowledge_pulses if outputs else lambda: None,
        "outbox_full": loop.report.acknowledge_drops,
        "counts": loop.parts.store.findings.clear,
    }
    if alarm not in staying:
        raise ValueError(
            f"the alarm '{alarm}' ends by itself when its reason is over; see docs/operations.md"
        )
    if alarm not in raised:
        raise ValueError(f"the alarm '{alarm}' is not raised; raised: {', '.join(raised) or 'none'}")
    staying[alarm]()
    loop.parts.status.say(alarm, None)
    return {"alarms": _alarms(loop)}


def _snapshot(loop: StationLoop, arguments: SnapshotArguments) -> Data:
    snapshots = loop.find(Snapshots)
    if snapshots is None:
        raise ValueError("snapshots are off; name the command snapshot in [commands]")
    recording = snapshots.request(arguments.before_s, arguments.after_s)
    return {"recording": str(recording), "is_waiting": True}


def _self_test(loop: StationLoop, arguments: NoArguments) -> Callable[[], Data]:
    return self_test(loop.parts)


COMMANDS: Final[tuple[Command[Any], ...]] = (
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
        "record that a new gel is mounted, count from 0 and learn its picture",
        "the record of wear",
    ),
    Command(
        "prove_gel",
        NoArguments,
        _prove_gel,
        "a person says that every press on this gel was of a sound part: with enough presses and few alarms the bundle "
        "in use is proven on it. `rate`: the false alarms that they still allow",
        "what the bundle is trusted with",
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
        "reference_press",
        ReferencePressArguments,
        _reference_press,
        "the next press is that of a master piece; its outcome is on the topic `reference`. `restart`: its charts "
        "begin again; `cancel`: the next press is a part's",
        "the charts of the master piece",
    ),
    Command(
        "acknowledge_alarm",
        AcknowledgeAlarmArguments,
        _acknowledge_alarm,
        "end an alarm that stays after its reason is over: `pulse`, `outbox_full` or `counts`; the others end by "
        "themselves. `alarms`: those that remain",
        "the alarm",
    ),
    Command(
        "snapshot",
        SnapshotArguments,
        _snapshot,
        f"write the camera's frames around now as a recording below the state folder; `recording` is its folder, which "
        f"is there when it is complete. At most {KEPT} with {KEPT_BYTES / 1e6:g} MB are kept, the oldest go first",
        "the oldest snapshots",
    ),
    Command(
        "self_test",
        NoArguments,
        _self_test,
        "score the golden frames now, check the database, the sensor, the receivers and the disk; `parts` has each "
        "outcome, `is_ok` all of them together. Other requests wait for its end, up to 15 s",
    ),
)
"""All commands of a station; docs/mqtt.md prints this table."""


def station_handlers(calls: LoopCalls[StationLoop]) -> dict[str, Handler]:
    """Verb to handler. Arguments are read on the caller's thread; the station's loop does the rest."""
    return {command.verb: partial(_ask, calls, command) for command in COMMANDS}


def _ask(calls: LoopCalls[StationLoop], command: Command[Any], arguments: Mapping[str, Any]) -> Change:
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
    gel = loop.session.gel
    return {
        "gel_id": gel.gel_id,
        "presses": gel.presses,
        "limit_presses": gel.limit_presses,
        "state": loop.session.contact_state,
        **known,
    }


def _selection(loop: StationLoop) -> Data:
    part, bundle = loop.parts.selection.part, loop.parts.selection.inspector.bundle
    return {"part": part.part, "position": part.position, "bundle_id": bundle.digest}


def _alarms(loop: StationLoop) -> list[str]:
    """Return those that are raised, in order."""
    return sorted(loop.parts.status.view().alarms)
