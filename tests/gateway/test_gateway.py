"""From a press to a result: the running gateway on the virtual sensor."""

import json
import subprocess
import sys
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from station import FPS, HEADER, gel, jpeg, station_config
from stepped_station import SteppedStation

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import BundleMismatch
from edge.gateway.build import open_station
from edge.gateway.recorder import PressReport
from edge.pictures.image_file import texts
from edge.recording.format import RecordingWriter
from edge.store.press_store import Store


def count(config: Path) -> int:
    with Store(config.parent / "gelgate.db") as store:
        return sum(gel.presses for gel in store.gels())


@pytest.fixture(scope="module")
def finished(
    tmp_path_factory: pytest.TempPathFactory, recording: Path, bundle: Path
) -> tuple[Path, list[PressReport]]:
    """A gateway with its threads that has run until its recording ended: its folder, and its presses."""
    config = station_config(tmp_path_factory.mktemp("finished"), recording, bundle)
    reports: list[PressReport] = []
    with open_station(load_config(config), SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())
    return config.parent, reports


def test_each_press_gives_one_result_and_is_counted_once(finished: tuple[Path, list[PressReport]]) -> None:
    """Three presses, three results, and the dented one fails, above its threshold. The messages of a press arrive once,
    matched by its id; the state ends with `stopped`."""
    folder, reports = finished
    results = [report.result for report in reports]
    lines = [json.loads(line) for line in (folder / "out/messages.jsonl").read_text().splitlines()]
    topics = Counter(str(line["topic"]).split("/")[0] for line in lines)
    states = [line["payload"]["state"] for line in lines if line["topic"] == "state"]

    assert [result.verdict for result in results] == ["pass", "fail", "pass"]
    assert [(result.sequence, result.gel_presses) for result in results] == [(1, 1), (2, 2), (3, 3)]
    assert count(folder / "gelgate.toml") == 3
    assert {(result.site, result.line, result.station) for result in results} == {("site", "line", "station")}
    assert results[0].mm_per_pixel == pytest.approx((0.0634, 0.0634))
    assert topics["result"] == topics["heatmap"] == topics["scoremap"] == 3
    # `last` and `last/press`, of which a slow sink sees the newest alone, and the empty `last/heatmap` of the start.
    assert 3 <= topics["last"] <= 7
    assert ("ready" in states, states[-1]) == (True, "stopped")
    for result in results:
        for name in (f"heatmap/{result.press_id}.jpg", f"scoremap/{result.press_id}.png"):
            written = texts((folder / "out" / name).read_bytes())
            assert (written["press_id"], written["verdict"]) == (result.press_id, result.verdict)
        assert result.score_ratio == pytest.approx((result.score or 0) / (result.threshold or 0))
        assert ((result.score_ratio or 0) > 1) == (result.verdict == "fail")
        # One that was scored ahead was decoded and scored before it rested: then `total` is less than their sum.
        assert {"total", "decode", "trunk", "head"} <= result.latency_ms.keys()


def test_a_result_says_where_the_defect_is(finished: tuple[Path, list[PressReport]]) -> None:
    """The strongest part of the dented press is at the dent, in pixels and in millimetres; a pass has none."""
    sound, dented = (report.result for report in finished[1][:2])
    assert sound.defects is None
    assert dented.defects
    strongest = dented.defects[0]

    # The dent is at (150, 100) of the picture: (102, 92) of the centre region that starts at (48, 8).
    assert strongest.centroid_px == pytest.approx((102, 92), abs=20)
    assert strongest.centroid_mm == pytest.approx([0.0634 * px for px in strongest.centroid_px], abs=0.004)
    assert strongest.box_mm == pytest.approx([0.0634 * px for px in strongest.box_px], abs=0.001)
    assert strongest.score == pytest.approx(dented.score)
    assert 0 < strongest.area_mm2 <= strongest.box_px[2] * strongest.box_px[3] * 0.0634**2
    areas = sum(defect.area_mm2 for defect in dented.defects)
    assert dented.defect_area_mm2 == pytest.approx(areas, abs=0.001)


def test_a_peak_is_not_late_because_the_lift_is_slow(tmp_path: Path, bundle: Path) -> None:
    """A press that never rests, lifted for two seconds, is judged at its peak when the gel is free: the machine is not
    too slow by that, and a reject gate has its time from then on."""
    rng, depths = np.random.default_rng(5), [0.0] * 28 + [0.3, 0.6, 0.9, 1.0, 1.0]
    with RecordingWriter(tmp_path / "lifted", HEADER) as writer:
        for number, depth in enumerate([*depths, *np.linspace(1.0, 0.0, 40), *[0.0] * 14]):
            writer.add(jpeg(gel(rng, float(depth))), round(number * 1e9 / FPS))
    ages: list[float] = []

    def note(report: PressReport) -> None:
        ages.append((station.clock.monotonic_ns() - (report.press.judged_ns or 0)) / 1e9)

    config = station_config(tmp_path / "station", tmp_path / "lifted", bundle, pace=1.0)
    with SteppedStation(config, on_press=note) as station:
        station.play()
        station.loop.publish_stats()
        assert station.raised == []

    assert [(result.verdict, result.reason) for result in station.results] == [("pass", None)]
    assert ages[0] < 0.3


@pytest.mark.parametrize(("value", "presses"), [(255, 1), (0, 0)])
def test_a_saturated_press_is_rejected_and_a_black_stream_is_no_press(
    tmp_path: Path, bundle: Path, value: int, presses: int
) -> None:
    """A press that clips has no verdict but wears the gel; black frames are not used."""
    folder, rng = tmp_path / "odd", np.random.default_rng(5)
    with RecordingWriter(folder, HEADER) as writer:
        for number in range(50):
            frame = gel(rng)
            if 30 <= number < 42:
                frame[40:200, 60:260] = value
                if value == 0:
                    frame[:] = rng.integers(0, 3, frame.shape)
            writer.add(jpeg(frame), round(number * 1e9 / FPS))
    config = station_config(tmp_path / "station", folder, bundle)
    with SteppedStation(config) as station:
        station.play()

    assert station.verdicts == ["rejected"] * presses
    assert all(str(result.reason).startswith("saturated") for result in station.results)
    assert count(config) == presses


def test_a_sensor_of_another_mode_is_refused(tmp_path: Path, bundle: Path) -> None:
    """A bundle made from other frames never scores these."""
    small = jpeg(gel(np.random.default_rng(0))[::2, ::2].copy())
    with RecordingWriter(tmp_path / "small", replace(HEADER, mode=(160, 120), profile="")) as writer:
        writer.add(small, 0)
    with (
        SteppedStation(station_config(tmp_path / "station", tmp_path / "small", bundle)) as station,
        pytest.raises(BundleMismatch, match=r"320x240 frames .* sends 160x120"),
    ):
        station.play()


def test_a_station_loads_what_it_uses_and_a_press_imports_nothing(config: Path, tmp_path: Path) -> None:
    """A sensor, a bundle with its trunk, without tiles and registration, and no second presses: none of the code for
    the others is loaded. What the first press needs is there when the free gel is learnt, with its pictures. In a
    process of its own."""
    lines = config.read_text().splitlines()
    lines[lines.index('plugin = "usb_mock"') : lines.index("[inspection]")] = ['plugin = "gelsight_mini"']
    (real := tmp_path / "real.toml").write_text("\n".join(lines))
    program = f"""
import json, sys
from pathlib import Path
from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
with open_station(load_config(Path({str(real)!r})), SystemClock()):
    loaded = sorted(sys.modules)
sys.path.insert(0, {str(Path(__file__).parents[1] / "support")!r})
from stepped_station import SteppedStation
with SteppedStation(Path({str(config)!r})) as station:
    station.play_until(lambda: station.said("state")["state"] == "ready")
    before = set(sys.modules)
    station.play()
    station.parts.pictures.step()
    print(json.dumps([loaded, len(station.reports), sorted(set(sys.modules) - before)]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded, presses, imported = json.loads(done.stdout)

    assert (presses, imported) == (3, [])
    assert {"edge.model.scorer", "plugins.devices.gelsight_mini"} <= set(loaded)
    assert not set(loaded) & {
        "edge.core.handshake",
        "edge.core.overview.rules",
        "edge.core.press_again",
        "edge.core.reference_press.charts",
        "edge.core.registration.registrar",
        "edge.model.detectability",
        "edge.model.graph_cut",
        "edge.model.tile_runner",
        "edge.recording.format",
    }
