"""A station under less light than at the fit judges as under the light of the fit, and says that it follows it."""

from pathlib import Path

import pytest
from command_line import gelgate
from station import Motion, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.core.contact.tracker import ContactTracker
from edge.messaging.result_payload import ResultPayload
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
        assert gain is not None
        assert min(gain) > 1.1  # an offset does the rest


def test_without_it_sound_presses_fail(
    tmp_path: Path, films: dict[float, Path], bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is guarded: with the light taken as it is, every press of the film fails."""
    monkeypatch.setattr(module, "find_light", lambda now, at_fit, new_gel: (None, False))
    assert {verdict for verdict, _, _ in scores(station_config(tmp_path, films[0.8], bundle))} == {"fail"}


def test_light_that_falls_between_presses_is_followed_without_a_pause(
    tmp_path: Path, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From all of the light to 80 % of it over 10 presses, the gel free for 0.5 s between two: what was learnt of the
    free gel at the start is never renewed. Every sound press passes, and the chart of the light sees it; without the
    view before each press the last ones fail."""
    film = press_recording(
        tmp_path / "film", 10, dented=[7], motion=Motion(hold=7, idle=9), light=1.0, light_at_end=0.8
    )
    with SteppedStation(station_config(tmp_path / "a", film, bundle)) as station:
        station.play()
        verdicts = [report.result.verdict for report in station.reports]
        (light,) = (one for one in station.said("drift")["charts"] if one["measure"] == "light_levels")
    monkeypatch.setattr(ContactTracker, "newest_free", None)
    without = [verdict for verdict, _, _ in scores(station_config(tmp_path / "b", film, bundle))]

    assert verdicts == ["fail" if number == 7 else "pass" for number in range(10)]
    assert light["newest"] < 0.97 * 118
    assert without[-3:] == ["fail"] * 3


@pytest.fixture
def new_gel(tmp_path: Path, films: dict[float, Path], bundle: Path) -> Path:
    """The configuration of a station that has pressed on the gel of the fit, with a film of another one."""
    strict = with_strict_limit(bundle, tmp_path)
    with SteppedStation(station_config(tmp_path, films[1.0], strict)) as station:
        station.play()
    shaded = press_recording(tmp_path / "shaded", 3, dented=[1], motion=Motion(free=80), shading=SHADING)
    return station_config(tmp_path, shaded, strict)


SHADING = 8.0


def with_strict_limit(bundle: Path, folder: Path) -> Path:
    """A bundle that fails sound presses of a gel with this shading."""
    return variant(bundle, folder / "strict", threshold={"value": 0.03})


def press_on_new_gel(config: Path) -> list[ResultPayload]:
    """Say that the gel was changed, and press; the station says that its bundle is not proven there."""
    with SteppedStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        station.ask("replace_gel")
        station.play()
        assert "is not yet proven on gel" in (station.alarm("gel_proof") or "")
        return [report.result for report in station.reports]


def test_the_shading_of_a_new_gel_changes_no_verdict(
    new_gel: Path, films: dict[float, Path], bundle: Path, tmp_path: Path
) -> None:
    """Scores within a tenth of the limit of those on the gel of the fit, and made again bit for bit from how the light
    was followed; after a restart it is followed again."""
    before = scores(station_config(tmp_path / "before", films[1.0], bundle))
    results = press_on_new_gel(new_gel)
    replayed = gelgate("station", "replay", "--all", "-c", str(new_gel))
    again = scores(new_gel)

    assert [result.verdict for result in results] == ["pass", "fail", "pass"]
    assert [verdict for verdict, _, _ in again] == ["pass", "fail", "pass"]
    assert [result.score for result in results] == pytest.approx(
        [score for _, score, _ in before], abs=0.01, rel=0.1
    )
    assert replayed.code == 0, replayed.err


def test_a_gel_that_nobody_recorded_is_not_followed(tmp_path: Path, bundle: Path) -> None:
    """The first one of a sensor may be that of another unit."""
    shaded = press_recording(tmp_path / "shaded", 2, motion=Motion(free=80), shading=SHADING)
    config = station_config(tmp_path, shaded, with_strict_limit(bundle, tmp_path))
    verdicts = {verdict for verdict, _, _ in scores(config)}
    assert verdicts <= {"fail", "rejected"}
