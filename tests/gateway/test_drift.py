"""A station whose passing presses shift says what has shifted, and goes on after a restart and another gel."""

from pathlib import Path

import numpy as np
import pytest
from station import Motion, press_recording
from stepped_station import SteppedStation

from edge.core.drift import MEASURES
from edge.features.drift import DriftWatch, _bundles_from


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty short presses, the third one dented."""
    folder = tmp_path_factory.mktemp("drift") / "presses"
    return press_recording(folder, 30, dented=[2], motion=Motion(hold=8, idle=10), seed=5)


def shift(station: SteppedStation, name: str, far: float) -> None:
    """Move what was charted so far, as if the presses from now on lay elsewhere."""
    watch = station.find(DriftWatch)
    charts = watch._bundles[watch._bundle]
    charts[name] = charts[name].__class__.from_numbers(
        [charts[name].count, charts[name].mean + far, *charts[name].numbers[2:]]
    )


def test_a_shift_is_an_alarm_until_somebody_acknowledges_it(config: Path) -> None:
    """Of 24 presses, 23 pass and are charted; then every place lies 3 mm away. The alarm comes again after a restart;
    acknowledged, this chart begins again, also after one more restart, and the others go on."""
    with SteppedStation(config) as station:
        station.play_presses(24)
        quiet, charts = station.alarm("drift"), dict(station.find(DriftWatch)._bundles)
        assert list(config.parent.rglob("*.drift.npy")), "kept before the end: the process may be killed"
        shift(station, "x_mm", 3.0)
        station.play_presses(30)
        said = station.alarm("drift")
    with SteppedStation(config) as again:
        again.play_until(lambda: again.loop.session is not None)
        restarted = again.alarm("drift")
        again.play_presses(1)
        again.ask("acknowledge_alarm", alarm="drift")
        watch = again.find(DriftWatch)
        left = watch._bundles[watch._bundle]
        assert again.alarm("drift") is None
        assert {chart["measure"] for chart in again.said("drift")["charts"]} == set(left)
        assert {name for _, name in watch._sums} == set(left), "what is drawn of the chart is gone too"
    with SteppedStation(config) as last:
        last.play_until(lambda: last.loop.session is not None)
        watch = last.find(DriftWatch)
        assert (last.alarm("drift"), watch._bundles[watch._bundle]) == (None, left)
        last.play_presses(1)
        last.ask("replace_gel")
        assert (watch._bundles, watch._sums) == ({}, {})

    assert quiet is None
    (only,) = charts.values()
    assert set(only) == {measure.name for measure in MEASURES}
    assert {chart.count for name, chart in only.items() if name != "noise_levels"} == {29}
    assert said is not None
    assert said.startswith("place x is lower since about 6 passing presses: ")
    assert restarted == said
    assert set(left) == {measure.name for measure in MEASURES} - {"x_mm"}


def test_the_charts_are_shown_with_every_press_that_passes(config: Path) -> None:
    """Of three presses the third is dented, and charted by none; what the lines show begins with the start. After
    another gel nothing is charted."""
    with SteppedStation(config) as station:
        station.play_presses(3)
        shown = station.said("drift")
        charts = station.find(DriftWatch)._bundles
    with SteppedStation(config) as again:
        again.play_until(lambda: again.loop.session is not None)
        restarted = again.said("drift")
        again.ask("replace_gel")
        other = again.said("drift")

    (kept,) = charts.values()
    by_name = {chart["measure"]: chart for chart in shown["charts"]}
    assert (shown["part"], shown["position"], shown["limit"]) == ("PZ0", "pos1", 10.0)
    assert list(by_name) == [measure.name for measure in MEASURES if measure.name in kept]
    assert {chart["count"] for name, chart in by_name.items() if name != "noise_levels"} == {2}
    for name, chart in by_name.items():
        assert len(chart["above"]) == len(chart["below"]) == chart["count"]
        assert chart["above"][-1] == round(kept[name].above, 2)
        assert chart["newest"] == pytest.approx(kept[name].newest, rel=1e-5)
    assert [chart["count"] for chart in restarted["charts"]] == [chart["count"] for chart in shown["charts"]]
    assert {chart["above"] == [] for chart in restarted["charts"]} == {True}
    assert other["charts"] == []
    assert other["gel_id"] != shown["gel_id"]


@pytest.mark.parametrize(
    "damaged", [np.zeros((2, 3)), np.full((1, 10), np.nan), np.full((1, 10), 7.0), np.zeros(3, np.float32)]
)
def test_damaged_charts_are_refused(damaged: np.ndarray) -> None:
    """The folder of the gel then logs it, and they are learnt again."""
    with pytest.raises(ValueError):  # noqa: PT011 - each fault has its own sentence
        _bundles_from(damaged)


def test_a_file_without_rows_has_no_charts() -> None:
    assert _bundles_from(np.empty(0)) == {}
