"""Detects a machine that is too slow for its sensor: a rule over counters, without a clock.

Frames that are not processed in time are dropped, and a press in them is missed. This must raise an alarm.
"""

from dataclasses import dataclass
from typing import Final

__all__ = ["FrameCounts", "OverloadRule"]

# The share of lost frames in one window that raises the alarm: one shortened queue in ten seconds at 18.75 fps is 8 %.
RAISE_SHARE: Final = 0.05
# Below this the machine keeps up again; between the two the alarm stays as it is.
CLEAR_SHARE: Final = 0.01


@dataclass(frozen=True)
class FrameCounts:
    """Since the start. frames: delivered by the sensor. dropped: of those, never processed. late: processed too late.

    interrupted: how often frames were dropped while the gel was pressed. late_presses: judged too late, so rejected.
    """

    frames: int = 0
    dropped: int = 0
    late: int = 0
    interrupted: int = 0
    late_presses: int = 0

    def since(self, before: "FrameCounts") -> "FrameCounts":
        """The counts since `before`."""
        return FrameCounts(
            self.frames - before.frames,
            self.dropped - before.dropped,
            self.late - before.late,
            self.interrupted - before.interrupted,
            self.late_presses - before.late_presses,
        )


class OverloadRule:
    """Call `step` once a window, some seconds long, with the counts so far."""

    def __init__(self) -> None:
        self._before = FrameCounts()
        self._sentence: str | None = None

    def skip(self, counts: FrameCounts) -> None:
        """Skip this window: something else delayed the gateway, and has its own alarm."""
        self._before = counts

    def step(self, counts: FrameCounts) -> str | None:
        """The fault and what to do while this machine is too slow, None while it keeps up.

        Raised when more than RAISE_SHARE of the window's frames were dropped or late, or when a press could not be
        followed; cleared by a window without such a press and below CLEAR_SHARE.
        """
        window = counts.since(self._before)
        self._before = counts
        lost = window.dropped + window.late
        missed = window.interrupted + window.late_presses
        if lost > RAISE_SHARE * window.frames or missed:
            self._sentence = _sentence(window)
        elif lost <= CLEAR_SHARE * window.frames:
            self._sentence = None
        return self._sentence


def _sentence(window: FrameCounts) -> str:
    presses = ""
    if window.interrupted:
        presses += f", {window.interrupted} times while the gel was pressed"
    if window.late_presses:
        presses += f", and {window.late_presses} presses were rejected because they were judged too late"
    return (
        f"this machine is too slow: of the last {window.frames} frames {window.dropped} were dropped and "
        f"{window.late} came too late{presses}; presses may have been missed. End other programs on it, give it "
        "more cores, or use a bundle that scores faster"
    )
