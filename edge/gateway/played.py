"""Checks that a recording that was played to its end gave all its presses: a missed press is an error."""

from edge.core.errors import PressesMissed
from edge.gateway.acquisition import AcquisitionStatus
from edge.gateway.summary import Summary
from edge.recording.format import Recording

__all__ = ["check_played"]


def check_played(recording: Recording, summary: Summary, status: AcquisitionStatus) -> None:
    """Errors: PressesMissed where the labels give another number of presses.

    Without labels: where frames were dropped, or no press was seen. A run that was stopped before the recording's end
    is not checked.
    """
    held = recording.presses()
    is_unknown = held is None and summary.presses > 0 and not status.dropped
    if not summary.has_ended or is_unknown or held == summary.presses:
        return
    found = (
        f"its number of presses is not known and the run saw {summary.presses}"
        if held is None
        else f"it holds {held} presses and the run saw {summary.presses}"
    )
    why = (
        f"{status.dropped} of its {status.frames} frames were dropped because they were not processed in time; "
        "play it with pace = 0"
        if status.dropped
        else "no frame was dropped; play it with pace 0 or 1, and `gelgate run -v` shows contact in each frame"
    )
    cut = "; its index ends in the middle of a line, so the end of it is lost" if recording.is_cut else ""
    raise PressesMissed(f"recording {recording.folder}: {found}; {why}{cut}")
