"""What a station says of itself: its counters at an interval, what was lost of its frames, and its description."""

import json
from pathlib import Path

import pytest
from station import Configure
from stepped_station import SteppedStation

from edge.acquisition import AcquisitionStatus
from edge.cli.describe import Format, describe_config
from edge.cli.run import summary_text
from edge.config import load_config
from edge.core.imaging.quality import Reason, Rejection
from edge.core.press import Press
from edge.core.verdict import Kind, Verdict, decide
from edge.gateway.recorder import PressReport
from edge.gateway.report import FrameCounts, OverloadRule, Summary
from edge.messaging.result_payload import ResultPayload
from edge.store.gel_ledger import GelRecord


@pytest.mark.parametrize(("stats_s", "least", "most"), [(0.5, 8, 10), (60, 0, 0)])
def test_counters_have_their_interval(configure: Configure, stats_s: float, least: int, most: int) -> None:
    """Five seconds: a report every half second, or none. It names the raised alarms, for a dashboard that comes
    later."""
    times = set()
    config = configure(tables=f"[station]\nstats_s = {stats_s}")
    with SteppedStation(config) as station:
        for _ in range(50):
            station.clock.sleep(0.1)
            station.turn()
            times |= {stats["time_ns"]} if (stats := station.said("stats")) else set()
        for alarm, text in (("bundle", "broken"), ("gel", "worn"), ("device", "away"), ("device", None)):
            station.parts.status.say(alarm, text)
        station.loop.publish_stats()

    assert least <= len(times) <= most
    assert station.said("stats")["alarms"] == ["bundle", "gel"]


def test_a_station_keeps_its_own_description_at_the_broker(station: SteppedStation, config: Path) -> None:
    """Retained from the start on: what `gelgate station describe` prints."""
    assert station.said("asyncapi") == json.loads(describe_config(load_config(config), Format.ASYNCAPI))


def report(reason: str | None, total_ms: float) -> PressReport:
    """Make the report of a press that was scored, or rejected with this reason, after this time."""
    verdict = decide(0.5, 1.0) if reason is None else Verdict.rejected(Rejection(Reason.BLACK, "dark"))
    scores = {"verdict": Kind.PASS, "score": 0.5, "threshold": 1.0}
    result = ResultPayload(
        **(scores if reason is None else {"verdict": Kind.REJECTED, "reason": reason}),  # type: ignore[arg-type]
        time_ns=0,
        press_id="01ARZ3NDEKTSV4RRFFQ69G5FAV",
        part="bolt",
        sensor_serial="2BNN4ZE7",
        gel_id="2BNN4ZE7-1",
        gel_presses=1,
        gel_limit_presses=1000,
        latency_ms={"total": total_ms},
    )
    return PressReport(Press(verdict), result, GelRecord("2BNN4ZE7", "2BNN4ZE7-1", 1, 1000, 0.8, 0))


@pytest.mark.parametrize(
    ("counts", "raised"),
    [
        ([FrameCounts(frames=190, dropped=1)], [False]),
        ([FrameCounts(frames=187, dropped=15)], [True]),  # one shortened queue in ten seconds: 8 %
        ([FrameCounts(frames=190, dropped=1, interrupted=1)], [True]),
        ([FrameCounts(frames=190, dropped=1, late_presses=1)], [True]),
        # Raised at 8 %, kept at 3 %, cleared at 0.5 %; only new frames count.
        (
            [FrameCounts(200, 16), FrameCounts(400, 22), FrameCounts(600, 23), FrameCounts(800, 24)],
            [True, True, False, False],
        ),
    ],
)
def test_a_machine_that_is_too_slow_raises_an_alarm(counts: list[FrameCounts], raised: list[bool]) -> None:
    """By the share of dropped frames, or by one press that could not be followed; what a full disk costs is left
    out."""
    rule, skipping = OverloadRule(), OverloadRule()
    assert [rule.step(one) is not None for one in counts] == raised
    skipping.skip(counts[0])
    assert skipping.step(counts[0]._replace(frames=1000)) is None


def test_a_run_ends_with_what_was_lost() -> None:
    """Dropped, late, stale and corrupt frames, and presses that may be missing. Only scored presses count in the times
    of a score: a press may be rejected after 0.05 ms."""
    summary = Summary()
    for reason, total_ms in (("stale: old", 0.05), ("black: dark", 0.05), (None, 191.0), (None, 193.0)):
        summary.add(report(reason, total_ms))
    summary.frames = summary.frames._replace(late=3)
    summary.see(AcquisitionStatus(frames=100, corrupt=4, stale=5, dropped=16), undecodable=1)
    summary.frames = summary.frames._replace(interrupted=2)
    assert list(summary.latencies_ms) == [191.0, 193.0]
    presses, frames = summary_text(summary).splitlines()
    assert presses == "4 presses: 2 pass, 2 rejected"
    assert frames.startswith("100 frames: 16 dropped, 3 late, 5 repeated, 5 corrupt")
    assert "presses may have been missed" in frames
    names = (
        "frames",
        "frames_dropped",
        "frames_late",
        "frames_stale",
        "frames_corrupt",
        "presses_interrupted",
    )
    assert [summary.fields()[name] for name in names] == [100, 16, 3, 5, 5, 2]
