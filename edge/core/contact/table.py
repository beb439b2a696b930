"""The contact table: (state, signal) to state, small enough to print, and printed in the manual from here."""

from enum import StrEnum

__all__ = ["TABLE", "Signal", "State", "table_markdown"]


class State(StrEnum):
    """What the gel is doing."""

    WARM_UP = "warm-up"
    BASELINE = "baseline"
    NO_CONTACT = "no contact"
    APPROACH = "approach"
    SETTLING = "settling"
    EARLY_RELEASE = "early release"
    CONTACT = "contact"
    RELEASE = "release"
    RECOVERY = "recovery"
    DOUBT = "doubt"


class Signal(StrEnum):
    """The signal of one frame, or of the outside world."""

    BLIND = "blind"  # the frame is not usable: black, or too soon after a gap
    MOVING = "moving"  # while learning: the view differs from the one held as still
    CLEAR = "clear"  # touched area at or below the off level
    FAINT = "faint"  # between the off and the on level
    TOUCH = "touch"  # at or above the on level
    STILL = "still"  # touched, wanted, and still for the settle time
    LATE = "late"  # wanted, and not still within the settle timeout
    ELAPSED = "elapsed"  # the state's own condition has held for its time
    INVERSE = "inverse"  # the view has lost structure that the reference shows, or a first press never ends
    FREE = "free"  # at rest, and without structure that the doubted reference lacks
    GAP = "gap"  # the stream was interrupted
    RELEARN = "relearn"  # a new reference is requested


def _row(state: State, **moves: State) -> dict[tuple[State, Signal], State]:
    """Make one row of the table: a signal that is not named leaves the state as it is."""
    return {(state, signal): moves.get(signal.name, state) for signal in Signal}


TABLE: dict[tuple[State, Signal], State] = {
    **_row(State.WARM_UP, ELAPSED=State.BASELINE),
    **_row(
        State.BASELINE,
        MOVING=State.WARM_UP,
        ELAPSED=State.NO_CONTACT,
        TOUCH=State.CONTACT,  # only against a stored reference: the part was there at the start
        GAP=State.WARM_UP,
        RELEARN=State.WARM_UP,
    ),
    **_row(State.NO_CONTACT, TOUCH=State.APPROACH, RELEARN=State.WARM_UP),
    **_row(
        State.APPROACH,
        CLEAR=State.NO_CONTACT,
        FAINT=State.NO_CONTACT,
        ELAPSED=State.SETTLING,
        INVERSE=State.DOUBT,
        GAP=State.NO_CONTACT,
        RELEARN=State.WARM_UP,
    ),
    **_row(
        State.SETTLING,
        CLEAR=State.EARLY_RELEASE,
        STILL=State.CONTACT,
        LATE=State.CONTACT,
        INVERSE=State.DOUBT,
        RELEARN=State.WARM_UP,
    ),
    **_row(
        State.EARLY_RELEASE,
        FAINT=State.SETTLING,
        TOUCH=State.SETTLING,
        ELAPSED=State.RECOVERY,
        GAP=State.SETTLING,
        RELEARN=State.WARM_UP,
    ),
    **_row(State.CONTACT, CLEAR=State.RELEASE, INVERSE=State.DOUBT, RELEARN=State.WARM_UP),
    **_row(
        State.RELEASE,
        FAINT=State.CONTACT,
        TOUCH=State.CONTACT,
        ELAPSED=State.RECOVERY,
        GAP=State.CONTACT,
        RELEARN=State.WARM_UP,
    ),
    **_row(State.RECOVERY, TOUCH=State.APPROACH, ELAPSED=State.NO_CONTACT, RELEARN=State.WARM_UP),
    **_row(State.DOUBT, CLEAR=State.NO_CONTACT, FREE=State.RECOVERY, RELEARN=State.WARM_UP),
}


def table_markdown() -> str:
    """Print the table as Markdown, one row per state; a dot means: stay. docs/contact.md shows it."""
    heads = "| state | " + " | ".join(Signal) + " |"
    rule = "|---|" + "---|" * len(Signal)
    return "\n".join([heads, rule, *(_print(state) for state in State)]) + "\n"


def _print(state: State) -> str:
    targets = (TABLE[state, signal] for signal in Signal)
    return f"| **{state}** | " + " | ".join("·" if to is state else to for to in targets) + " |"
