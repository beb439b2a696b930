"""A machine that is too slow is reported: the rule, its counters, and the summary at the end of a run."""

import json
from dataclasses import replace

import pytest

from edge.acquisition import AcquisitionStatus
from edge.cli.run import summary_text
from edge.clock import ManualClock
from edge.core.imaging.quality import Reason, Rejection
from edge.core.ports import Message
from edge.core.press import Press
from edge.core.verdict import Kind, Verdict, decide
from edge.gateway.recorder import PressReport
from edge.gateway.report import FrameCounts, OverloadRule, Summary
from edge.gateway.status import StationStatus
from edge.messaging.result_payload import ResultPayload
from edge.store.gel_ledger import GelRecord

GEL = GelRecord("2BNN4ZE7", "2BNN4ZE7-1", 1, 1000, 0.8, 0)


def report(**fields: object) -> PressReport:
    """A press as it was recorded, with these fields of its result."""
    score = fields.get("score")
    rejection = Rejection(Reason.BLACK, "dark")
    verdict = Verdict.rejected(rejection) if score is None else decide(float(str(score)), 1.0)
    result = ResultPayload(
        **{  # type: ignore[arg-type]
            "time_ns": 0,
            "press_id": "01ARZ3NDEKTSV4RRFFQ69G5FAV",
            "part": "bolt",
            "sensor_serial": "2BNN4ZE7",
            "gel_id": "2BNN4ZE7-1",
            "gel_presses": 1,
            "gel_limit_presses": 1000,
            **fields,
        }
    )
    return PressReport(Press(verdict), result, GEL)


def scored(total_ms: float) -> PressReport:
    return report(verdict=Kind.PASS, score=0.5, threshold=1.0, latency_ms={"total": total_ms})


def rejected(reason: str, total_ms: float) -> PressReport:
    return report(verdict=Kind.REJECTED, reason=reason, latency_ms={"total": total_ms})


def test_a_machine_that_keeps_up_raises_nothing() -> None:
    """One lost frame in a hundred raises no alarm."""
    assert OverloadRule().step(FrameCounts(frames=190, dropped=1)) is None


def test_a_share_of_dropped_frames_is_an_alarm_that_says_what_to_do() -> None:
    """15 of 187 is one shortened queue in ten seconds: 8 %."""
    sentence = OverloadRule().step(FrameCounts(frames=187, dropped=15))

    assert sentence is not None
    assert "of the last 187 frames 15 were dropped" in sentence
    assert "give it more cores" in sentence


@pytest.mark.parametrize("missed", [{"interrupted": 1}, {"late_presses": 1}])
def test_one_press_that_could_not_be_followed_is_an_alarm(missed: dict[str, int]) -> None:
    """However few the frames were."""
    assert OverloadRule().step(FrameCounts(frames=190, dropped=1, **missed)) is not None


def test_the_alarm_lasts_until_a_window_is_clean() -> None:
    """Raised at 8 %, kept at 3 %, cleared at 0.5 %; only new frames count."""
    rule = OverloadRule()
    counts = [FrameCounts(200, 16), FrameCounts(400, 22), FrameCounts(600, 23), FrameCounts(800, 24)]

    assert [rule.step(one) is not None for one in counts] == [True, True, False, False]


def test_what_a_full_disk_costs_is_left_out() -> None:
    """A window that something else delayed has another alarm."""
    rule = OverloadRule()
    rule.skip(FrameCounts(200, 150))

    assert rule.step(FrameCounts(400, 150)) is None


def test_latencies_are_those_of_scored_presses() -> None:
    """A press that was rejected after 0.05 ms does not count in the times of a score."""
    summary = Summary()
    for one in (rejected("stale: old", 0.05), rejected("black: dark", 0.05), scored(191.0), scored(193.0)):
        summary.add(one)

    assert list(summary.latencies_ms) == [191.0, 193.0]


def test_stats_say_what_became_of_the_frames() -> None:
    """Dropped, late, stale and corrupt frames and interrupted presses, and the median of scored presses only."""
    summary = Summary()
    summary.frames = replace(summary.frames, late=3, interrupted=2)
    summary.see(AcquisitionStatus(frames=100, corrupt=4, stale=5, dropped=16), undecodable=1)
    summary.add(rejected("stale: old", 0.05))
    summary.add(scored(191.0))
    stats = summary.fields()
    names = (
        "frames",
        "frames_dropped",
        "frames_late",
        "frames_stale",
        "frames_corrupt",
        "presses_interrupted",
    )
    assert [stats[name] for name in names] == [100, 16, 3, 5, 5, 2]
    assert stats["latency_ms_p50"] == 191.0


def test_the_alarm_is_raised_and_cleared_on_its_topic() -> None:
    """The sentence while it lasts, an empty payload when it is over."""
    said: list[Message] = []
    status = StationStatus(said.append, ManualClock())
    status.say("overload", "this machine is too slow")
    status.say("overload", None)

    assert [message.topic for message in said] == ["alarm/overload"] * 2
    assert json.loads(said[0].payload)["text"] == "this machine is too slow"
    assert said[1].payload == b""


def test_a_run_ends_with_what_was_lost() -> None:
    """Frames always; presses that may be missing in words."""
    summary = Summary()
    summary.add(scored(1.0))
    summary.see(AcquisitionStatus(frames=100, dropped=16), undecodable=0)
    assert summary_text(summary).splitlines() == [
        "1 presses: 1 pass",
        "100 frames: 16 dropped, 0 late, 0 repeated, 0 corrupt",
    ]

    summary.frames = replace(summary.frames, interrupted=1)
    assert "presses may have been missed" in summary_text(summary)
