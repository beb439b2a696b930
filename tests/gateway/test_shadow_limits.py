"""What a shadow may never do: bring an older or unsigned bundle into use, undo a takeover, hold up verdicts."""

from pathlib import Path
from typing import Any

import pytest
from shadow_station import FIVE, Shadowed, adopt, restore
from station import Motion, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.model.bundle import Bundle
from edge.model.signing import new_key
from edge.store.bundles_in_use import read_takeover

pytestmark = pytest.mark.usefixtures("few")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight short presses, all sound."""
    folder = tmp_path_factory.mktemp("limits") / "presses"
    return press_recording(folder, 8, motion=Motion(hold=8, idle=12), seed=5)


@pytest.fixture
def old(tmp_path: Path, bundle: Path) -> Path:
    return variant(bundle, tmp_path / "old", revision=1, threshold=FIVE)


@pytest.fixture
def new(tmp_path: Path, bundle: Path) -> Path:
    return variant(bundle, tmp_path / "new", revision=2, threshold=FIVE | {"value": 0.2})


def test_an_older_bundle_is_no_shadow_and_cannot_take_over(shadowed: Shadowed, old: Path, new: Path) -> None:
    """A revision that was in use is the lowest, at a start and after it rose."""
    with SteppedStation(shadowed(new)) as first:
        first.play_presses(1)
    with SteppedStation(shadowed(new, old)) as station:
        station.play_presses(1)
        assert "has revision 1, and revision 2 was in use here" in station.alarm("shadow")
        with pytest.raises(ValueError, match="there is no shadow"):
            adopt(station)
        assert station.bundle_id == Bundle.load(new).digest


def test_a_shadow_that_grew_old_is_none_any_more_and_no_bundle_either(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, old: Path, new: Path
) -> None:
    """It was opened beside a bundle of its own revision, which a newer one has replaced."""
    same = variant(bundle, tmp_path / "same", revision=1)
    config = shadowed(same, old)
    with SteppedStation(config) as station:
        station.play_presses(1)
        assert station.parts.selection.shadow is not None
        shadowed(new, old)
        station.reload()
        station.turn()
        station.reload()
        assert station.parts.selection.shadow is None
        assert "is older" in station.alarm("shadow")
    with SteppedStation(shadowed(same, old, folder="other")) as station:
        station.play_presses(1)
        variant(bundle, same, revision=3)
        station.reload()
        station.turn()  # revision 3 is in use, and the shadow of revision 1 is still open
        shadowed(old, folder="other")
        station.reload()
        station.turn()
        assert station.bundle_id == Bundle.load(same).digest
        assert "is older" in station.alarm("bundle")


def test_a_shadow_that_is_not_trusted_any_more_cannot_take_over(
    shadowed: Shadowed, tmp_path: Path, recording: Path, old: Path, new: Path
) -> None:
    """Signatures are required since the reload; the bundle in use goes on, its shadow does not."""
    pytest.importorskip("cryptography", reason="signatures need the extra `signing`")
    config = shadowed(old, new)
    with SteppedStation(config) as station:
        station.play_presses(1)
        (tmp_path / "keys").mkdir()
        new_key(tmp_path / "keys" / "somebody")
        more = f'bundle = "{old}"\nshadows = ["{new}"]\nsigned = "required"\ntrusted_keys = "{tmp_path / "keys"}"'
        station_config(tmp_path / "station", recording, more)
        station.reload()
        assert station.parts.selection.shadow is None
        with pytest.raises(ValueError, match="there is no shadow"):
            adopt(station)
        assert station.bundle_id == Bundle.load(old).digest


def test_takeover_and_way_back_survive_a_reload_of_before(shadowed: Shadowed, old: Path, new: Path) -> None:
    ids = Bundle.load(old).digest, Bundle.load(new).digest
    config = shadowed(old, new)
    with SteppedStation(config) as station:
        station.play_presses(1)
        for verb, used in (("adopt_shadow", ids[1]), ("restore_bundle", ids[0])):

            def ask(verb: str = verb) -> None:
                (adopt if verb == "adopt_shadow" else restore)(station)

            selection = station.parts.selection
            selection.reload()
            selection.worker.step()
            # The opening is not done yet.
            outcome, selection.worker._outcome = selection.worker._outcome, None
            ask()
            assert station.bundle_id == used
            selection.worker._outcome = outcome
            station.turn(2)
            selection.worker.step()
            station.turn(2)
            assert station.bundle_id == used, verb


def test_a_configured_takeover_is_no_way_to_the_older_one(shadowed: Shadowed, old: Path, new: Path) -> None:
    """Once the shadow that took over is the configured bundle, the one before is an older bundle as any other."""
    with SteppedStation(shadowed(old, new)) as station:
        station.play_presses(1)
        adopt(station)
        shadowed(new)
        station.reload()
        station.turn()
        part = station.parts.selection.part
        assert station.parts.store.read("test", lambda connection: read_takeover(connection, part)) is None
        shadowed(old)
        station.reload()
        station.turn()
        assert station.bundle_id == Bundle.load(new).digest
        assert "is older" in station.alarm("bundle")


def test_a_broken_shadow_that_took_over_goes_on_as_others(shadowed: Shadowed, old: Path, new: Path) -> None:
    digest = Bundle.load(new).digest
    with SteppedStation(shadowed(old, new)) as station:
        station.play_presses(1)
        adopt(station)
        (new / "manifest.json").write_text("{")
        station.reload()
        station.play_presses(2)
        assert station.bundle_id == digest
        assert "manifest" in station.alarm("bundle")
        assert station.alarm("shadow") is None


def test_the_alarm_of_a_shadow_that_fails_ends_with_the_shadow(
    shadowed: Shadowed, old: Path, new: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SteppedStation(shadowed(old, new)) as station:
        monkeypatch.setattr(station.parts.selection.shadow.scorer, "score_beside", None)
        station.play_presses(1)
        assert "gave no score" in station.alarm("shadow")
        shadowed(old)
        station.reload()
        station.turn()
        assert station.alarm("shadow") is None


def test_a_shadow_that_holds_up_verdicts_is_left_out(
    shadowed: Shadowed, old: Path, new: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After two presses in a row, and it is said."""
    with SteppedStation(shadowed(old, new)) as station:
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
    assert [one.latency_ms.get("shadow") for one in station.results] == [1200, 900, 1200, 1200, *[None] * 3]
    assert station.verdicts == ["pass"] * 7


def test_a_takeover_that_was_asked_for_twice_is_made_once(shadowed: Shadowed, old: Path, new: Path) -> None:
    """The second request was weighed while the first was done; the alarm still says why."""
    with SteppedStation(shadowed(old, new)) as station:
        station.play_presses(1)
        asked = [station.ask("adopt_shadow") for _ in range(2)]
        asked[0]()
        station.turn()
        asked[1]()
        station.turn()
        assert station.bundle_id == Bundle.load(new).digest
        assert "1 press judged by both" in station.alarm("takeover")
