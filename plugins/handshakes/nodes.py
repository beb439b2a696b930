"""The nodes of the OPC UA server: every variable and method, with its meaning; docs/plc.md prints them from here."""

from collections.abc import Callable, Mapping
from typing import Any, Final

from edge.core.handshake import Code, HandshakeView

__all__ = ["METHODS", "NAMESPACE", "STATUS", "VARIABLES"]

NAMESPACE: Final = "urn:gelgate:handshake"


def _vision_state(view: HandshakeView) -> str:
    match view.station.state:
        case "ready":
            return "Operational"
        case "halted":
            return "Error"
        case "stopped":
            return "Halted"
        case _:
            return "Preoperational"


def _automatic_state(view: HandshakeView) -> str:
    """Return the sub-state of Operational. A result that waits for its acknowledgement allows no next job."""
    if view.is_ready:
        return "Ready"
    return "SingleExecution" if view.step == "busy" else "Initialized"


_STATES: Final = "VisionStateMachine"
_JOBS: Final = f"{_STATES}/AutomaticModeStateMachine"
_RESULT: Final = "ResultManagement/LatestResult"

VARIABLES: Final[Mapping[str, tuple[str, str, Callable[[HandshakeView], Any]]]] = {
    f"{_STATES}/CurrentState": (
        "String",
        "Preoperational (starting), Operational (ready), Error (halted) or Halted (stopped)",
        _vision_state,
    ),
    f"{_JOBS}/CurrentState": (
        "String",
        "Initialized, Ready (a job would be taken) or SingleExecution (busy)",
        _automatic_state,
    ),
    f"{_RESULT}/JobId": (
        "UInt32",
        "of the job that is busy or done; 0 for none",
        lambda view: view.trigger_id,
    ),
    f"{_RESULT}/PartId": ("String", "the id of its piece", lambda view: view.piece),
    f"{_RESULT}/ResultId": ("String", "the press that answered it", lambda view: view.press_id),
    f"{_RESULT}/IsAvailable": (
        "Boolean",
        "it is done, until it is acknowledged",
        lambda view: view.step == "done",
    ),
    f"{_RESULT}/ResultContent": (
        "String",
        "pass, fail, unsure, rejected, error or place; empty while there is none",
        lambda view: view.word or "",
    ),
    f"{_RESULT}/IsPass": ("Boolean", "it is a pass", lambda view: view.is_pass),
    f"{_RESULT}/IsNotPassed": (
        "Boolean",
        "the complement, also while there is no result",
        lambda view: not view.is_pass,
    ),
    f"{_RESULT}/ErrorCode": ("UInt16", "why it is an error", lambda view: int(view.code)),
    f"{_RESULT}/ScoreRatio": (
        "Double",
        "score / threshold: above 1 fails; -1 for none",
        lambda view: -1.0 if view.score_ratio is None else view.score_ratio,
    ),
    "Station/RefusalCode": (
        "UInt16",
        "why the newest job was refused; 0 since one was taken",
        lambda view: int(view.refused),
    ),
    "Station/GelLife": (
        "UInt16",
        "percent of its presses that the gel has left",
        lambda view: view.gel_left_percent,
    ),
    "Station/Piece": (
        "String",
        "the piece of several places that is in progress; empty for none",
        lambda view: view.station.piece_id or "",
    ),
    "Station/Contact": ("String", "as on the topic `contact`", lambda view: view.station.contact),
    "Station/Alarms": (
        "String",
        "the raised alarms, with commas",
        lambda view: ", ".join(sorted(view.station.alarms)),
    ),
}
"""Path below `VisionSystem`: OPC UA type, meaning and value."""

METHODS: Final[Mapping[str, tuple[Mapping[str, str], str]]] = {
    f"{_JOBS}/StartSingleJob": (
        {"JobId": "UInt32", "PartId": "String", "RecipeId": "String"},
        "the trigger; PartId is the id of the piece, RecipeId a name of the part to inspect; both may be empty",
    ),
    f"{_JOBS}/Abort": ({}, "the same as Acknowledge, for a job that is busy"),
    "ResultManagement/Acknowledge": ({}, "the result was read"),
    "Station/Beat": ({}, "a sign of life, with `watchdog_s`"),
}
"""Path below `VisionSystem`: arguments with their types, and meaning."""

# Why a job is refused, as an OPC UA status code.
STATUS: Final[Mapping[Code, str]] = {
    Code.BUSY: "BadInvalidState",
    Code.NOT_ACKNOWLEDGED: "BadInvalidState",
    Code.ID_TWICE: "BadEntryExists",
    Code.BAD_VALUE: "BadInvalidArgument",
    Code.NOT_READY: "BadResourceUnavailable",
    Code.UNKNOWN_PART: "BadNotFound",
    Code.NO_BEAT: "BadNoCommunication",
}
