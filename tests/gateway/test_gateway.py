"""From a press to a result: the running gateway on the virtual sensor."""

import json
import threading
from collections import Counter
from pathlib import Path

import pytest
from station import Motion, gel, jpeg, press_recording, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import BundleMismatch
from edge.gateway.gateway import Gateway
from edge.gateway.recorder import PressReport
from edge.recording.format import RecordingHeader, RecordingWriter
from edge.store.press_store import Store


def inspected(config: Path) -> list[PressReport]:
    """Run a station until its recording ends."""
    reports: list[PressReport] = []
    with Gateway.open(load_config(config), SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())
    return reports


def published(config: Path) -> list[dict[str, object]]:
    """Every message that reached the folder."""
    lines = (config.parent / "out" / "messages.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def counted(config: Path) -> int:
    with Store(config.parent / "gelgate.db") as store:
        return sum(gel.presses for gel in store.gels())


@pytest.fixture(scope="module")
def finished(
    tmp_path_factory: pytest.TempPathFactory, recording: Path, bundle: Path
) -> tuple[Path, list[PressReport]]:
    config = station_config(tmp_path_factory.mktemp("finished"), recording, bundle)
    return config, inspected(config)


def test_each_press_gives_one_result(finished: tuple[Path, list[PressReport]]) -> None:
    """Three presses, three results, and the dented one fails."""
    _, reports = finished

    assert [report.result.verdict for report in reports] == ["pass", "fail", "pass"]


def test_each_press_is_counted_once(finished: tuple[Path, list[PressReport]]) -> None:
    """The gel's count is the number of presses, in the ledger and in every result."""
    config, reports = finished

    assert counted(config) == 3
    assert [report.result.gel_presses for report in reports] == [1, 2, 3]


def test_a_press_publishes_result_heatmap_last_and_gel(finished: tuple[Path, list[PressReport]]) -> None:
    """The messages of a press arrive once, matched by its id; the retained picture is that of `last`."""
    config, reports = finished
    topics = Counter(str(line["topic"]).split("/")[0] for line in published(config))

    assert topics["result"] == topics["heatmap"] == 3
    # `last`, `last/press` and `last/heatmap`: a slow sink sees the newest alone.
    assert 3 <= topics["last"] <= 9
    for report in reports:
        assert (config.parent / "out" / f"heatmap/{report.result.press_id}.png").is_file()


def test_a_result_says_where_the_defect_is(finished: tuple[Path, list[PressReport]]) -> None:
    """The strongest part of the dented press is at the dent, in pixels and in millimetres; a pass has none."""
    _, reports = finished
    assert reports[0].result.defects is None
    assert reports[1].result.defects
    strongest = reports[1].result.defects[0]

    # The dent is at (150, 100) of the picture: (102, 92) of the centre region that starts at (48, 8).
    assert strongest.centroid_px == pytest.approx((102, 92), abs=20)
    assert strongest.centroid_mm == pytest.approx([0.0634 * px for px in strongest.centroid_px], abs=0.004)
    assert strongest.box_mm == pytest.approx([0.0634 * px for px in strongest.box_px], abs=0.001)
    assert strongest.score == pytest.approx(reports[1].result.score)
    _, _, width, height = strongest.box_px
    assert 0 < strongest.area_mm2 <= width * height * 0.0634**2
    assert reports[1].result.defect_area_mm2 == pytest.approx(
        sum(defect.area_mm2 for defect in reports[1].result.defects), abs=0.001
    )


def test_a_result_says_where_it_comes_from_and_how_far_it_is(
    finished: tuple[Path, list[PressReport]],
) -> None:
    """Station, sequence, mm per pixel, and the score in units of its threshold: above 1 where it fails."""
    _, reports = finished
    results = [report.result for report in reports]

    assert [result.sequence for result in results] == [1, 2, 3]
    assert {(result.site, result.line, result.station) for result in results} == {("site", "line", "station")}
    assert results[0].mm_per_pixel == pytest.approx((0.0634, 0.0634))
    for result in results:
        assert result.score_ratio == pytest.approx((result.score or 0) / (result.threshold or 0))
    assert [(result.score_ratio or 0) > 1 for result in results] == [False, True, False]


def test_the_picture_names_its_press(finished: tuple[Path, list[PressReport]]) -> None:
    """A picture saved under any name contains the id and the verdict of its press."""
    from edge.pictures import png

    _, reports = finished
    for report in reports:
        said = png.texts(report.heatmap_png or b"")
        assert (said["press_id"], said["verdict"]) == (report.result.press_id, report.result.verdict)


def test_latencies_are_told_per_stage(finished: tuple[Path, list[PressReport]]) -> None:
    """Decode, trunk and head are parts of the total."""
    _, reports = finished
    stages = reports[0].result.latency_ms

    assert {"decode", "trunk", "head", "total"} == set(stages)
    assert stages["total"] >= stages["decode"] + stages["trunk"] + stages["head"]


def test_the_state_ends_with_stopped(finished: tuple[Path, list[PressReport]]) -> None:
    """A gateway that is stopped publishes `stopped`."""
    config, _ = finished
    states = [line["payload"]["state"] for line in published(config) if line["topic"] == "state"]  # type: ignore[index]

    assert states[-1] == "stopped"
    assert "ready" in states


def test_a_sensor_pulled_out_during_twenty_presses_is_reconnected_each_time(
    tmp_path: Path, bundle: Path
) -> None:
    """Twenty presses, each unplugged while held: no crash, twenty results, twenty counts, twenty reconnections."""
    motion = Motion(free=60, idle=14, hold=52)
    recording = press_recording(tmp_path / "presses", 20, motion=motion, seed=3)
    length = motion.hold + motion.idle + 2
    faults = [f"unplug@{motion.free + press * length + 25}:0.05" for press in range(20)]
    config = station_config(tmp_path / "station", recording, bundle, pace=0, faults=faults)
    reports: list[PressReport] = []
    with Gateway.open(load_config(config), SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())
        reconnects = gateway.status.reconnects

    assert reconnects == 20
    assert len(reports) == counted(config) == 20
    assert {report.result.verdict for report in reports} <= {"pass", "fail"}


def test_broken_frames_are_counted_and_passed_over(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """A truncated JPEG, a packet with an error and a stale frame are lost alone, and nothing else."""
    config = station_config(
        tmp_path,
        recording,
        bundle,
        faults=["truncate@3", "error_bit@20", "stale@36", "drop@41", "lost_packet@50"],
    )
    reports: list[PressReport] = []
    with Gateway.open(load_config(config), SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())
        status = gateway.status

    assert len(reports) == counted(config) == 3
    assert status.corrupt >= 3
    assert status.stale == 1


@pytest.mark.parametrize(("value", "reason"), [(255, "saturated"), (0, None)])
def test_a_saturated_press_is_rejected_and_a_black_stream_is_no_press(
    tmp_path: Path, bundle: Path, value: int, reason: str | None
) -> None:
    """A press that clips has no verdict but wears the gel; black frames are not used."""
    import numpy as np

    folder, rng = tmp_path / "odd", np.random.default_rng(5)
    header = RecordingHeader("GelSight Mini R0B TEST-0001", "TEST0001", (320, 240), 18.75, "cropped_lr")
    with RecordingWriter(folder, header) as writer:
        for number in range(50):
            frame = gel(rng)
            if 30 <= number < 42:
                frame[40:200, 60:260] = value
                if value == 0:
                    frame[:] = rng.integers(0, 3, frame.shape)
            writer.add(jpeg(frame), round(number * 1e9 / 18.75))
    config = station_config(tmp_path / "station", folder, bundle)
    reports = inspected(config)

    if reason is None:
        assert reports == []
    else:
        assert [report.result.verdict for report in reports] == ["rejected"]
        assert reports[0].result.reason is not None
        assert reports[0].result.reason.startswith(reason)
        assert counted(config) == 1


def test_a_sensor_of_another_mode_is_refused(tmp_path: Path, bundle: Path) -> None:
    """A bundle made from other frames never scores these."""
    import numpy as np

    folder = tmp_path / "small"
    header = RecordingHeader("GelSight Mini R0B TEST-0001", "TEST0001", (160, 120), 18.75, "")
    with RecordingWriter(folder, header) as writer:
        for number in range(4):
            writer.add(jpeg(gel(np.random.default_rng(number))[::2, ::2].copy()), round(number * 1e9 / 18.75))
    config = station_config(tmp_path / "station", folder, bundle)

    with pytest.raises(BundleMismatch, match=r"320x240 frames .* sends 160x120"):
        inspected(config)
