"""A station under less light than at the fit judges as under the light of the fit, and says that it follows it."""

from pathlib import Path

import numpy as np
import pytest
from command_line import gelgate
from station import press_recording, station_config
from stepped_station import SteppedStation

from edge.model import inspector as module


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> dict[float, Path]:
    """Three presses, the second one dented: under the light of the fit, and under 80 % of it."""
    folder = tmp_path_factory.mktemp("light")
    return {light: press_recording(folder / str(light), 3, dented=[1], light=light) for light in (1.0, 0.8)}


def scores(config: Path) -> list[tuple[str | None, float, tuple[float, ...] | None]]:
    """Play it to its end: verdict, score and gains of each press."""
    with SteppedStation(config) as station:
        station.play()
        results = [report.result for report in station.reports]
    return [(result.verdict, result.score or 0.0, result.light_gain) for result in results]


def test_less_light_changes_no_verdict(tmp_path: Path, films: dict[float, Path], bundle: Path) -> None:
    """Sound presses pass and the dented one fails, with the scores of full light within a tenth of the limit, and each
    result says by how much its press was made brighter. Under the light of the fit nothing is said."""
    before, now = (
        scores(station_config(tmp_path / str(light), film, bundle)) for light, film in films.items()
    )

    assert [verdict for verdict, _, _ in before] == [verdict for verdict, _, _ in now]
    assert {verdict for verdict, _, _ in now} == {"pass", "fail"}
    assert [score for _, score, _ in now] == pytest.approx(
        [score for _, score, _ in before], abs=0.01, rel=0.1
    )
    assert [gain for _, _, gain in before] == [None] * 3
    for _, _, gain in now:
        assert gain == pytest.approx((1.25, 1.25, 1.25), abs=0.06)  # an offset does the rest


def test_without_it_sound_presses_fail(
    tmp_path: Path, films: dict[float, Path], bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is guarded: with the light taken as it is, every press of the film fails."""
    monkeypatch.setattr(module, "find_light", lambda now, at_fit: None)
    assert {verdict for verdict, _, _ in scores(station_config(tmp_path, films[0.8], bundle))} == {"fail"}


def test_its_verdicts_are_made_again_bit_for_bit(
    tmp_path: Path, films: dict[float, Path], bundle: Path
) -> None:
    """The archive keeps how the light was followed."""
    config = station_config(tmp_path, films[0.8], bundle)
    assert np.ptp([score for _, score, _ in scores(config)]) > 0

    replayed = gelgate("station", "replay", "--all", "-c", str(config))

    assert replayed.code == 0, replayed.err
