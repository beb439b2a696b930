"""Whether a recording that was played to its end gave the presses that it holds: a missed press is never silent."""

from edge.core.errors import PressesMissed
from edge.gateway.acquisition import AcquisitionStatus
from edge.gateway.summary import Summary
from edge.recording.format import Recording

__all__ = ["check_played"]


def check_played(recording: Recording, summary: Summary, status: AcquisitionStatus) -> None:
    """Errors: PressesMissed where labels tell of another number of presses; without them, where frames were dropped.

    A run that was stopped before the recording's end proves nothing and passes.
    """
    held = recording.presses()
    if not summary.has_ended or (held is None and not status.dropped) or held == summary.presses:
        return
    found = (
        f"how many presses it holds is not known and the run saw {summary.presses}"
        if held is None
        else f"it holds {held} presses and the run saw {summary.presses}"
    )
    why = (
        f"{status.dropped} of its {status.frames} frames were dropped because nobody took them in time; "
        "play it with pace = 0"
        if status.dropped
        else "no frame was dropped; `gelgate run -v` says what contact made of them"
    )
    raise PressesMissed(f"recording {recording.folder}: {found}; {why}")
