"""What a page shows (docs/operations.md, The page at the station)."""

from collections.abc import Iterator

from simulation.lives import Station
from simulation.sensor import S
from simulation.surroundings import World
from simulation.web import Browser

LATE_S = 2.5
"""A page that asks all the time has a change by then."""

HANGS_S = 8.0
"""Then a loop that hangs has been told as halted, or the page is grey."""


def audit_page(world: World, station: Station, browser: Browser) -> Iterator[str]:
    """A pass is large only while the station is ready, of the newest press, and of one since the last time without
    inspection. A page with an old answer is looked at again when it has a new one."""
    view, now_ns = browser.view, world.clock.now_ns
    is_well = not (station.is_frozen or station.is_disk_disturbed or station.is_disk_slow)
    told_ns = station.so_since("the page is told", is_well)
    hangs_ns = station.so_since("the loop hangs, and a page asks", station.is_hanging, len(station.hung))
    if view is None or told_ns is None or now_ns - told_ns < LATE_S * S or view.at_ns < station.began_ns:
        return
    if view.word != "pass" or view.at_ns < now_ns - S:
        return
    if hangs_ns is not None and view.at_ns - hangs_ns > HANGS_S * S:
        yield f"the loop hangs for {(view.at_ns - hangs_ns) / S:.1f} s, and the page shows a pass"
    rows = [seen for seen in station.seen if seen.noted_ns <= view.at_ns - LATE_S * S]
    own = [seen for seen in station.seen if seen.press_id == view.press_id]
    if not own or own[0].shown != "pass":
        yield f"the page shows a pass of press {view.press_id}, which has {own[0].word if own else 'no row'}"
        return
    if rows and own[0].noted_ns < rows[-1].noted_ns:
        yield f"the page shows a pass of press {view.press_id}, and {rows[-1].press_id} came later"
    since = [when for when in station.halted_ns if own[0].noted_ns < when < view.at_ns - LATE_S * S]
    if since:
        yield f"the page shows a pass of press {view.press_id}, and the station was not ready at {since[-1] / S:.1f} s"


def audit_guesses(station: Station, browser: Browser) -> Iterator[str]:
    """A request that the page refuses is not done."""
    query = "SELECT request FROM acts WHERE outcome = 'done' AND request IS NOT NULL"
    for (transaction,) in station.disk.read(query):
        if transaction in browser.refused:
            yield f"the request {transaction}, {browser.refused[transaction]}, was done"
