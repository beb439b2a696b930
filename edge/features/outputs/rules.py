"""When a pedal counts as pressed, and what is switched when: pure rules."""

from collections.abc import Iterable, Mapping, Sequence

from edge.core.digital_io import OutputRule, State, StationView

__all__ = ["Debounce", "levels", "next_blink_ns"]


class Debounce:
    """From the changes of a contact to presses: down for `hold_ns`, then up for `hold_ns` before the next one."""

    def __init__(self, hold_ns: int) -> None:
        self._hold_ns = hold_ns
        self._is_down = False
        self._since_ns = 0
        self._has_fired = False

    def step(self, change: bool | None, now_ns: int) -> bool:
        """True once for each press."""
        if change is not None and change != self._is_down:
            self._is_down, self._since_ns = change, now_ns
        if self._is_down == self._has_fired or now_ns - self._since_ns < self._hold_ns:
            return False
        self._has_fired = self._is_down
        return self._is_down

    def due_ns(self) -> int | None:
        """When `step` must be called again although nothing changes; None where only a change matters."""
        return None if self._is_down == self._has_fired else self._since_ns + self._hold_ns


def levels(rules: Sequence[OutputRule], view: StationView, now_ns: int) -> Mapping[int, bool]:
    """Channel to level, without pulses. A channel of several rules is on where one of them switches it on."""
    conditions = view.conditions()
    found = {rule.channel: False for rule in rules}
    for rule in rules:
        if rule.pulse_ns is None:
            found[rule.channel] |= _is_on(rule, conditions, view.state, now_ns)
    return found


def _is_on(rule: OutputRule, conditions: frozenset[str], state: State, now_ns: int) -> bool:
    if rule.when & conditions:
        return rule.blink_ns is None or now_ns // rule.blink_ns % 2 == 0
    return rule.safe and state != "ready"


def next_blink_ns(rules: Iterable[OutputRule], now_ns: int) -> int | None:
    """When the next output that blinks changes; None where none does."""
    periods = {rule.blink_ns for rule in rules if rule.blink_ns is not None}
    return min(((now_ns // period + 1) * period for period in periods), default=None)
