"""What a shadow may never do: bring an older or unsigned bundle into use, undo a takeover, hold up verdicts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from shadow_station import FIVE, adopt, configure, limit
from station import Motion, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.config import load_config
from edge.model.bundle import Bundle
from edge.model.signing import new_key
from edge.store.bundles_in_use import read_takeover


@pytest.fixture(scope="module")
def presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight short presses, all sound."""
    folder = tmp_path_factory.mktemp("limits") / "presses"
    return press_recording(folder, 8, motion=Motion(hold=8, idle=24), seed=5)


@pytest.fixture
def old(tmp_path: Path, bundle: Path) -> Path:
    return variant(bundle, tmp_path / "old", revision=1, threshold=limit(bundle, **FIVE))


@pytest.fixture
def new(tmp_path: Path, bundle: Path) -> Path:
    return variant(bundle, tmp_path / "new", revision=2, threshold=limit(bundle, **FIVE, value=0.2))


@pytest.fixture(autouse=True)
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.core.shadow.LEAST_COMPARED", 1)


def open_at(config: Path) -> SteppedStation:
    return SteppedStation(config, lambda: load_config(config))


def reload(station: SteppedStation, meanwhile: Callable[[], Any] = lambda: None) -> None:
    """Open the bundles again; before the loop takes them, something else happens."""
    station.parts.selection.reload()
    station.parts.selection.worker.step()
    meanwhile()
    station.turn()


def in_use(station: SteppedStation) -> str:
    return station.parts.selection.inspector.bundle.digest


def test_an_older_bundle_is_no_shadow_so_it_cannot_take_over(
    tmp_path: Path, presses: Path, old: Path, new: Path
) -> None:
    """A revision that was in use is the lowest, at a start and after it rose."""
    folder = tmp_path / "station"
    with SteppedStation(configure(folder, presses, new)) as first:
        first.play_presses(1)
    with open_at(configure(folder, presses, new, old)) as station:
        station.play_presses(1)
        assert "has revision 1, and revision 2 was in use here" in station.alarm("shadow")
        with pytest.raises(ValueError, match="there is no shadow"):
            adopt(station)
        assert in_use(station) == Bundle.load(new).digest


def test_a_shadow_that_grew_old_is_none_any_more_and_no_bundle_either(
    tmp_path: Path, presses: Path, bundle: Path, old: Path, new: Path
) -> None:
    """It was opened beside a bundle of its own revision, which a newer one has replaced."""
    folder = tmp_path / "station"
    same = variant(bundle, tmp_path / "same", revision=1)
    config = configure(folder, presses, same, old)
    with open_at(config) as station:
        station.play_presses(1)
        assert station.parts.selection.shadow is not None
        configure(folder, presses, new, old)
        reload(station)
        station.turn()
        reload(station)
        assert station.parts.selection.shadow is None
        assert "is older" in station.alarm("shadow")
    with open_at(configure(tmp_path / "other", presses, same, old)) as station:
        station.play_presses(1)
        variant(bundle, same, revision=3)
        reload(station)
        station.turn()  # revision 3 is in use, and the shadow of revision 1 is still open
        configure(tmp_path / "other", presses, old)
        reload(station)
        station.turn()
        assert in_use(station) == Bundle.load(same).digest
        assert "is older" in station.alarm("bundle")


def test_a_shadow_that_is_not_trusted_any_more_cannot_take_over(
    tmp_path: Path, presses: Path, old: Path, new: Path
) -> None:
    """Signatures are required since the reload; the bundle in use goes on, its shadow does not."""
    pytest.importorskip("cryptography", reason="signatures need the extra `signing`")
    folder = tmp_path / "station"
    config = configure(folder, presses, old, new)
    with open_at(config) as station:
        station.play_presses(1)
        (tmp_path / "keys").mkdir()
        new_key(tmp_path / "keys" / "somebody")
        more = f'bundle = "{old}"\nshadows = ["{new}"]\nsigned = "required"\ntrusted_keys = "{tmp_path / "keys"}"'
        station_config(folder, presses, more)
        reload(station)
        assert station.parts.selection.shadow is None
        with pytest.raises(ValueError, match="there is no shadow"):
            adopt(station)
        assert in_use(station) == Bundle.load(old).digest


def test_a_takeover_and_the_way_back_survive_a_reload_that_began_before(
    tmp_path: Path, presses: Path, old: Path, new: Path
) -> None:
    ids = Bundle.load(old).digest, Bundle.load(new).digest
    config = configure(tmp_path / "station", presses, old, new)
    with open_at(config) as station:
        station.play_presses(1)
        for verb, used in (("adopt_shadow", ids[1]), ("restore_bundle", ids[0])):

            def ask(verb: str = verb) -> None:
                adopt(station) if verb == "adopt_shadow" else (station.ask(verb), station.turn())

            selection = station.parts.selection
            selection.reload()
            selection.worker.step()
            outcome, selection.worker._outcome = (
                selection.worker._outcome,
                None,
            )  # the opening is not done yet
            ask()
            assert in_use(station) == used
            selection.worker._outcome = outcome
            station.turn(2)
            selection.worker.step()
            station.turn(2)
            assert in_use(station) == used, verb


def test_a_configured_takeover_is_no_way_back_to_the_older_one(
    tmp_path: Path, presses: Path, old: Path, new: Path
) -> None:
    """Once the shadow that took over is the configured bundle, the one before is an older bundle as any other."""
    folder = tmp_path / "station"
    with open_at(configure(folder, presses, old, new)) as station:
        station.play_presses(1)
        adopt(station)
        configure(folder, presses, new)
        reload(station)
        station.turn()
        part = station.parts.selection.part
        assert station.parts.store.read("test", lambda connection: read_takeover(connection, part)) is None
        configure(folder, presses, old)
        reload(station)
        station.turn()
        assert in_use(station) == Bundle.load(new).digest
        assert "is older" in station.alarm("bundle")


def test_a_shadow_that_took_over_and_is_broken_goes_on_as_every_bundle_in_use(
    tmp_path: Path, presses: Path, old: Path, new: Path
) -> None:
    digest = Bundle.load(new).digest
    with open_at(configure(tmp_path / "station", presses, old, new)) as station:
        station.play_presses(1)
        adopt(station)
        (new / "manifest.json").write_text("{")
        reload(station)
        station.play_presses(2)
        assert in_use(station) == digest
        assert "manifest" in station.alarm("bundle")
        assert station.alarm("shadow") is None


def test_the_alarm_of_a_shadow_that_fails_ends_with_the_shadow(
    tmp_path: Path, presses: Path, old: Path, new: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "station"
    with open_at(configure(folder, presses, old, new)) as station:
        monkeypatch.setattr(station.parts.selection.shadow.scorer, "score_beside", None)
        station.play_presses(1)
        assert "gave no score" in station.alarm("shadow")
        configure(folder, presses, old)
        reload(station)
        station.turn()
        assert station.alarm("shadow") is None


def test_a_shadow_that_holds_up_verdicts_is_left_out(
    tmp_path: Path, presses: Path, old: Path, new: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After two presses in a row, and it is said."""
    with SteppedStation(configure(tmp_path / "station", presses, old, new)) as station:
        scorer = station.parts.selection.shadow.scorer
        score, calls = scorer.score_beside, []

        def score_slowly(*given: Any) -> Any:
            calls.append(given)
            station.clock.sleep(0.9 if len(calls) == 2 else 1.2)
            return score(*given)

        monkeypatch.setattr(scorer, "score_beside", score_slowly)
        station.play_presses(7)
        assert len(calls) == 4
        assert "is left out, for it took 1.2 s, at most 1.0 s are allowed" in station.alarm("shadow")
    assert [one.shadow is not None for one in station.results] == [True] * 4 + [False] * 3
    assert station.verdicts == ["pass"] * 7


def test_a_takeover_that_was_asked_for_twice_is_made_once(
    tmp_path: Path, presses: Path, old: Path, new: Path
) -> None:
    """The second request was weighed while the first was done; the alarm still says why."""
    with SteppedStation(configure(tmp_path / "station", presses, old, new)) as station:
        station.play_presses(1)
        asked = [station.ask("adopt_shadow") for _ in range(2)]
        asked[0]()
        station.turn()
        asked[1]()
        station.turn()
        assert in_use(station) == Bundle.load(new).digest
        assert "presses judged by both" in station.alarm("takeover")
