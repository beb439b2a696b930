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

    BLIND = "blind"
    """The frame is not usable: within 0.3 s after an interruption."""
    MOVING = "moving"
    """While learning: more than a contact's worth of the view has changed since it came to rest."""
    CLEAR = "clear"
    """The touched area is at most 0.2 % of the view, or 5 % of this press's largest area; or the imprint has had less
    than 40 % of its largest strength for 0.2 s; relief decides for a press that never had an area."""
    FAINT = "faint"
    """Between clear and touch (hysteresis)."""
    TOUCH = "touch"
    """The touched area, or the relief, is at least 1 % of the view; over a residue also an imprint of twice its
    strength."""
    STILL = "still"
    """A verdict is wanted, and the press rests."""
    LATE = "late"
    """A verdict is wanted, and the press has not rested for 3 s since its imprint last grew."""
    ELAPSED = "elapsed"
    """The state's own condition has held: warm-up 0.5 s, baseline 10 frames, approach 0.06 s, release 0.08 s, recovery
    3 s."""
    INVERSE = "inverse"
    """The view has lost structure that the reference shows; or the first press ever has lasted 30 s and added none."""
    FREE = "free"
    """While in doubt: the view rests and adds no structure to the reference, so it is the free gel."""
    GAP = "gap"
    """The stream was interrupted (unplugged, stalled, opened again), or for 0.27 s its frames showed nothing."""
    RELEARN = "relearn"
    """A new reference is requested, as after a change of gel."""


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
