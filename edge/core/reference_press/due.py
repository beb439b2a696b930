"""When a reference press is due: a number of hours after the last one, and at the beginning of each shift."""

import datetime
from collections.abc import Sequence

__all__ = ["why_due"]

_DAY = datetime.timedelta(days=1)


def why_due(
    last_ns: int | None,
    now_ns: int,
    every_h: float,
    shifts: Sequence[datetime.time] = (),
    zone: datetime.tzinfo | None = None,
) -> str | None:
    """Say why a reference press is due, as a sentence without its end, or None.

    last_ns, now_ns: wall clock, nanoseconds since 1970; last_ns None where there was none with this gel and
    bundle. every_h: hours, above 0.
    shifts: the local times at which shifts begin. zone: of these times; None for that of this machine.
    """
    if last_ns is None:
        return "there was none with this gel and bundle"
    if last_ns > now_ns:
        return "the last one is in the future, so the clock was set back"
    if now_ns - last_ns >= every_h * 3.6e12:
        return f"the last one is more than {every_h:g} h old"
    begun = _newest_begin(datetime.datetime.fromtimestamp(now_ns / 1e9, zone).astimezone(zone), shifts, zone)
    if begun is not None and last_ns < begun.timestamp() * 1e9:
        return f"the shift of {begun:%H:%M} has begun since the last one"
    return None


def _newest_begin(
    now: datetime.datetime, shifts: Sequence[datetime.time], zone: datetime.tzinfo | None
) -> datetime.datetime | None:
    """The newest moment at which a shift began, today or yesterday."""
    days = (now.date(), now.date() - _DAY)
    begins = (
        datetime.datetime.combine(day, shift, zone).astimezone(zone) for day in days for shift in shifts
    )
    return max((begin for begin in begins if begin <= now), default=None)
