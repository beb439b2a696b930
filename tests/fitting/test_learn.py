"""`gelgate bundle learn`: what people said at a station becomes a new bundle, or a sentence."""

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from command_line import Outcome, gelgate
from confirmed_station import PLAIN, Judged, fit, hide_places
from sql import execute
from station import station_config, variant
from stepped_station import SteppedStation

from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.fit_again import configure_again
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.learn import (
    Comparison,
    ConfirmedPress,
    ConfirmedPresses,
    leave_out_places,
    read_confirmed,
    write_picture,
)
from calibration.fitting.learn_command import _read_pictures, _warn_of_fewer_found
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.part_position import PartPosition
from edge.core.person_verdict import PersonVerdict
from edge.core.press import Press
from edge.core.verdict import decide
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.store.gel_proofs import GelBundle
from edge.store.press_archive import ArchivedPress


def learn(station: Judged, *more: object, bundle: Path | None = None, sources: Path | None = None) -> Outcome:
    words = bundle or station.old, sources or station.nominal, "-o", station.new
    return gelgate("bundle", "learn", *words, "-c", station.config, *more)


def test_what_is_called_good_is_learnt_and_what_is_called_damaged_is_still_found(station: Judged) -> None:
    """With the parameters and the backbone of the old bundle, and the next revision; the old one is as it was."""
    before = (station.old / "manifest.json").read_bytes()
    station.say({0: "good", 1: "good", 2: "damaged", 3: "cannot_tell", 5: "gel"})

    done = learn(station)

    assert done.code == 0, done.err
    assert "people said of bolt/default: 1 cannot_tell, 1 damaged, 1 gel, 2 good\n" in done.out
    assert "10 nominal presses, 2 of them from the station\n" in done.out
    assert "\nnext: name it under `shadows` in [inspection], and reload" in done.out
    assert "archived presses: done" in done.err
    assert (
        "of 1 presses that people call damaged 1 do not pass the old bundle and 1 do not pass the new one; of 2 that "
        "they call good 0 and 0; 0 of 3 other archived presses change\n" in done.out
    )
    manifest = Bundle.load(station.new).manifest
    assert (manifest.revision, manifest.parameters["gain"], manifest.method) == (2, 2.0, "tiny")
    assert {f"confirmed/{press_id}.jpg" for press_id in station.ids[:2]} <= set(manifest.provenance.presses)
    assert (station.old / "manifest.json").read_bytes() == before


def test_presses_of_one_piece_are_one_in_the_promise(station: Judged) -> None:
    """A second press of a piece, and one that names the same piece."""
    first, second, _, third, *_ = station.ids
    execute(
        station.database,
        f"UPDATE presses SET second_of = '{first}' WHERE press_id = '{second}'",
        f"UPDATE presses SET piece_id = 'P1' WHERE press_id IN ('{first}', '{third}')",
    )
    station.say({0: "good", 1: "good", 3: "good", 5: "good"})

    done = learn(station)

    assert done.code == 0, done.err
    limit = Bundle.load(station.new).manifest.threshold
    assert (limit.n, limit.pieces) == (12, 10)


@pytest.mark.parametrize("words", [{}, {3: "cannot_tell", 5: "gel"}])
def test_without_a_good_word_nothing_is_learnt(station: Judged, words: Mapping[int, str]) -> None:
    station.say(words)

    done = learn(station)

    assert "no press of bolt/default that people call good can be learnt" in done.sentence()
    assert not (station.new).exists()


def test_damage_called_good_is_left_out_and_named(station: Judged, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it lies beyond the threshold by enough: what is learnt of it would hide the next one."""
    monkeypatch.setattr("calibration.fitting.learn.FARTHEST", 1.1)  # the dents of this film score 1.25 of it
    station.say({0: "good", 2: "good", 4: "damaged"})

    done = learn(station)

    assert done.code == 0, done.err
    assert f"warning: left out: {station.ids[2]} (fail, 1.2" in done.err
    assert "lies beyond 1.1 times the threshold" in done.err
    assert "9 nominal presses, 1 of them from the station" in done.out


def test_a_press_called_good_and_damaged_that_is_left_out_is_judged_all_the_same(
    station: Judged, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three people overrule the one who saw a damage, and it lies too far beyond the threshold to be learnt."""
    monkeypatch.setattr("calibration.fitting.learn.FARTHEST", 1.1)
    station.say({0: "good", 2: "damaged"})
    for person in "abc":
        station.say({2: "good"}, person)

    confirmed = read_confirmed(station.database, PartPosition("bolt", "default"), "")

    assert [one.press.press_id for one in confirmed.good] == [station.ids[0]]
    assert station.ids[2] in [one.press_id for one in confirmed.others]


def test_where_the_station_did_not_judge_a_press_nothing_is_learnt(station: Judged) -> None:
    """Of the others everything is; what was archived by a region of another size says nothing of this one."""
    station.say({0: "good", 1: "good", 3: "good"})
    scar = hide_places(station, station.ids[1])
    hide_places(station, station.ids[3], shape=(100, 100))
    confirmed = read_confirmed(station.database, PartPosition("bolt", "default"), "").good
    places = {one.press.press_id: one.unjudged for one in confirmed}
    names = (*(f"confirmed/{press_id}.jpg" for press_id in station.ids[:4]), "nominal/one.jpg")
    presses = NominalPresses(np.zeros((5, 224, 224, 3), np.uint8), names)

    found = leave_out_places(presses, places).unjudged

    assert found is not None
    assert [bool(mask.any()) for mask in found] == [False, True, False, False, False]
    np.testing.assert_array_equal(found[1], scar)
    del places[station.ids[1]]
    assert leave_out_places(presses, places).unjudged is None


@pytest.mark.parametrize("found_without", [0.5, 0.1])
def test_a_good_press_that_alone_hides_damage_is_left_out(
    station: Judged, monkeypatch: pytest.MonkeyPatch, found_without: float
) -> None:
    """And the station asks about it once more; not where without it no more is found."""
    far = f"confirmed/{station.ids[1]}.jpg"

    def fit_and_say(presses: NominalPresses, config: FitConfig, **more: Any) -> Fitted:
        fitted, is_learnt = fit_files(presses, config, **more), far in presses.names
        facts = fitted.manifest.facts | found(0.1 if is_learnt else found_without)
        manifest = fitted.manifest.model_copy(update={"facts": facts})
        return dataclasses.replace(fitted, manifest=manifest, apart=(far,) if is_learnt else ())

    def found(share: float) -> dict[str, Any]:
        return {"limit": {"kind": "plain", "why": "", "found": {"plain": share}}}

    monkeypatch.setattr("calibration.fitting.learn_command.fit_files", fit_and_say)
    station.say({0: "good", 1: "good"})

    done = learn(station, bundle=variant(station.old, station.folder / "old", facts=found(0.5)))

    assert done.code == 0, done.err
    is_left_out = far not in Bundle.load(station.new).manifest.provenance.presses
    assert (
        is_left_out
        == (f"warning: left out: {station.ids[1]}: called good" in done.err)
        == (found_without > 0.1)
    )
    assert (f"the station asks once more what {station.ids[1]} is" in done.err) == is_left_out


def test_presses_that_get_another_verdict_are_named(station: Judged) -> None:
    """The other dent, of which nobody spoke, would pass."""
    station.say({2: "good"})

    done = learn(station)

    assert done.code == 0, done.err
    assert f"1 of 5 other archived presses change: {station.ids[4]} fail to pass\n" in done.out


def test_of_many_presses_that_change_those_that_pass_now_are_named() -> None:
    """Few are named, and a damage that is lost matters most."""
    others = [ArchivedPress.model_construct(press_id=str(number)) for number in range(12)]
    passed, failed = Press(decide(1.0, 2.0)), Press(decide(3.0, 2.0))
    before = {str(number): failed if number == 11 else passed for number in range(12)}
    after = {key: passed if one is failed else failed for key, one in before.items()}

    said = Comparison(ConfirmedPresses(others=others), before, after).changes()

    assert said.startswith("12 of 12 other archived presses change: 11 fail to pass; 0 pass to fail; ")


def test_every_press_that_somebody_called_damaged_and_that_passes_now_is_named() -> None:
    """However many there are, and also where the old bundle passed it already."""
    ids = [f"P{number:02}" for number in range(12)]
    others = [ArchivedPress.model_construct(press_id=press_id) for press_id in ids]
    passed, failed = Press(decide(1.0, 2.0)), Press(decide(3.0, 2.0))
    presses = ConfirmedPresses(others=others, doubted=set(ids))

    said = Comparison(
        presses, dict.fromkeys(ids, failed) | {"P11": passed}, dict.fromkeys(ids, passed)
    ).changes()

    assert said.endswith(f"; it passes {', '.join(ids)}, which somebody called damaged")


def test_a_bundle_that_loses_a_known_damage_is_not_written(station: Judged) -> None:
    """A faint dent is learnt as good, and another such dent would pass."""
    ids = station.ids
    station.say({0: "good", 2: "good", 4: "damaged"})

    done = learn(station)

    assert f"passes what was found before, and is not written: {ids[4]} (fail, " in done.sentence()
    assert re.search(rf"; {ids[4]} scores 1\.2\d of the limit at \(", done.sentence())
    assert f"mm, where it stands out most, and the sound press {ids[2]} " in done.sentence()
    assert f"the station asks once more what {ids[4]} is" in done.sentence()
    assert not (station.new).exists()


def test_a_damage_that_the_new_limit_passes_is_taught_at_its_place(
    station: Judged, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The learnt presses raise the limit for all places, and show little where the damage is."""

    ((highest,),) = execute(station.database, "SELECT max(score) FROM presses")

    def fit_loosely(*given: Any, **named: Any) -> Fitted:
        fitted = fit_files(*given, **named)
        loose = fitted.manifest.threshold.model_copy(update={"value": 2 * highest})
        return dataclasses.replace(fitted, manifest=fitted.manifest.model_copy(update={"threshold": loose}))

    for module in ("learn_command", "teach"):
        monkeypatch.setattr(f"calibration.fitting.{module}.fit_files", fit_loosely)
    monkeypatch.setattr("calibration.fitting.learn_command.lower_limit", lambda lesson: "limit: in vain")
    station.say({0: "good", 2: "damaged", 4: "damaged"})

    done = learn(station)

    assert done.code == 0, done.err
    assert "2 do not pass the old bundle and 0 do not pass the new one" in done.out
    assert "what the new bundle loses is taught: place: the limit divided by 1.3" in done.out
    assert "2 do not pass the old bundle and 2 do not pass the new one" in done.out
    assert sorted(Bundle.load(station.new).manifest.facts["taught"][0]["presses"]) == sorted(
        station.ids[number] for number in (2, 4)
    )


@pytest.mark.parametrize(("loosely", "is_quieter"), [(1.1, False), (2.0, True), (2.0, False)])
def test_a_damage_that_no_place_finds_is_taught_by_the_limit(
    station: Judged, monkeypatch: pytest.MonkeyPatch, loosely: float, is_quieter: bool
) -> None:
    """Where that costs next to nothing, or where the old bundle fails clearly more presses."""
    station.say({0: "good", 2: "damaged", 4: "damaged"})
    damaged = read_confirmed(station.database, PartPosition("bolt", "default"), "").damaged

    def fit_loosely(*given: Any, **named: Any) -> Fitted:
        fitted = fit_files(*given, **named)
        scorer = Scorer(new := fitted.bundle(), 1)
        highest = max(scorer.score(rgb).anomaly_score for rgb in _read_pictures(damaged, new).frames)
        scores = np.array(fitted.manifest.threshold.nominal_scores)
        if loosely > 1.5:  # sound presses that reach as far
            scores[-4:] = 1.5 * highest
        limit = conformal_threshold(scores, 0.05).model_copy(update={"value": loosely * highest})
        return dataclasses.replace(fitted, manifest=fitted.manifest.model_copy(update={"threshold": limit}))

    monkeypatch.setattr("calibration.fitting.learn_command.fit_files", fit_loosely)
    monkeypatch.setattr("calibration.fitting.learn_command.lower_place", lambda lesson: "place: in vain")
    monkeypatch.setattr(Comparison, "is_quieter", is_quieter)

    done = learn(station)

    if loosely > 1.5 and not is_quieter:
        assert "what the new bundle loses costs too much: limit: the limit " in done.out
        assert "passes what was found before, and is not written" in done.sentence()
        assert not station.new.exists()
        return
    assert done.code == 0, done.err
    assert "2 do not pass the old bundle and 0 do not pass the new one" in done.out
    assert "what the new bundle loses is taught: limit: the limit " in done.out
    assert "2 do not pass the old bundle and 2 do not pass the new one" in done.out
    manifest = Bundle.load(station.new).manifest
    assert sorted(manifest.facts["taught"][0]["presses"]) == sorted(station.ids[k] for k in (2, 4))
    assert (manifest.threshold.alpha > 0.1) == (loosely > 1.5)


def test_a_bundle_is_quieter_where_clearly_more_presses_pass_that_nobody_called_damaged() -> None:
    passed, failed = Press(decide(1.0, 2.0)), Press(decide(3.0, 2.0))
    names = [str(number) for number in range(9)]
    others = [ArchivedPress.model_construct(press_id=name) for name in names]

    def is_quieter(now_passing: int, now_failing: int, doubted: int = 0) -> bool:
        before = {name: failed if k < now_passing else passed for k, name in enumerate(names)}
        after = {
            name: passed if k < now_passing or k >= now_passing + now_failing else failed
            for k, name in enumerate(names)
        }
        presses = ConfirmedPresses(others=others, doubted=set(names[:doubted]))
        return Comparison(presses, before, after).is_quieter

    assert [is_quieter(*numbers) for numbers in ((5, 0), (8, 1), (4, 0), (7, 2), (5, 0, 1))] == [
        True,
        True,
        False,
        False,
        False,
    ]


def test_a_damage_that_somebody_else_calls_good_does_not_change_unsaid(station: Judged) -> None:
    """Nobody can tell then, and what the new bundle makes of it is named."""
    ids = station.ids
    station.say({2: "good", 4: "damaged"})
    station.say({4: "good"}, "pat")

    done = learn(station)

    assert done.code == 0, done.err
    assert "1 cannot_tell, 1 good\n" in done.out
    assert (
        f"1 of 5 other archived presses change: {ids[4]} fail to pass; it passes {ids[4]}, which somebody called "
        "damaged\n" in done.out
    )


def test_a_damage_that_the_station_found_is_not_lost_by_a_bundle_that_passes_it(station: Judged) -> None:
    """The bundle that is given is not the one that judged."""
    folder, ids = station.folder, station.ids
    variant(station.old, folder / "other", threshold={"value": 1000.0})
    station.say({2: "good", 4: "damaged"})

    done = learn(station, bundle=folder / "other")

    assert f"passes what was found before, and is not written: {ids[4]} (fail, " in done.sentence()
    assert not (station.new).exists()


def test_what_was_left_out_stays_so_and_the_requested_rate_too(station: Judged) -> None:
    """A nominal press that was left out may be damaged, and a rarer alarm would find less; unless it is asked for."""
    folder, ids = station.folder, station.ids
    names = Bundle.load(station.old).manifest.provenance.presses
    fit(station.nominal, folder / "other", "--leave-out", names[3], "--alpha", "0.2")
    station.say({0: "good"})

    done = learn(station, bundle=folder / "other")

    assert done.code == 0, done.err
    assert "8 nominal presses, 1 of them from the station\n" in done.out
    assert f"left out as before: {names[3]}\n" in done.out
    manifest = Bundle.load(station.new).manifest
    assert manifest.provenance.left_out == (names[3],)
    assert manifest.threshold.alpha == 0.2
    station.say({1: "good"})
    one = f"confirmed/{ids[1]}.jpg"
    asked = learn(station, "--alpha", "0.3", "--leave-out", one, "--overwrite", bundle=folder / "other")
    assert asked.code == 0, asked.err
    assert "8 nominal presses, 1 of them from the station\n" in asked.out
    manifest = Bundle.load(station.new).manifest
    assert manifest.provenance.left_out == (names[3], one)
    assert manifest.threshold.alpha == 0.3


def test_of_a_dataset_the_good_presses_are_learnt(station: Judged) -> None:
    """As `fit` does; a press that was left out, and is there no more, is no fault."""
    folder = station.folder
    old = Bundle.load(station.old)
    whole = Region(0, 0, *old.profile.size)
    presses = read_presses([station.nominal], old.profile, whole).frames
    data, where = folder / "data", "bolt/default"
    for name, some in {"rgb_320x240": presses, "fault/rgb_320x240": presses[:1]}.items():
        below = data / where / name
        below.mkdir(parents=True)
        for number, rgb in enumerate(some):
            cv2.imwrite(str(below / f"bolt_default_s{number:03}_p01.png"), rgb[..., ::-1])
    masks = data / where / "fault" / "mask_320x240"
    masks.mkdir(parents=True)
    cv2.imwrite(str(masks / "bolt_default_s000_p01.png"), presses[0, :, :, 0])
    last = data / where / "rgb_320x240" / "bolt_default_s007_p01.png"
    fit(data, folder / "other", "--leave-out", f"rgb_320x240/{last.name}")
    last.unlink()
    station.say({0: "good"})

    done = learn(station, bundle=folder / "other", sources=data)

    assert done.code == 0, done.err
    assert "8 nominal presses, 1 of them from the station\n" in done.out
    assert "the old bundle knew the free gel" not in done.err  # it was made of these pictures too
    again = learn(station, "--overwrite", sources=data)
    assert again.code == 0, again.err
    assert "warning: the old bundle knew the free gel, and these sources do not show it" in again.err


@pytest.fixture
def new_gel(station: Judged) -> Judged:
    """As if all presses were on a gel on which the bundle is not proven."""
    execute(station.database, "UPDATE gel_proofs SET proven = NULL")
    return station


def test_on_a_new_gel_four_good_presses_of_it_are_needed(new_gel: Judged) -> None:
    new_gel.say(dict.fromkeys((0, 1, 3), "good"))
    early = learn(new_gel)
    new_gel.say({5: "good"})
    done = learn(new_gel)

    assert (
        "is not proven on gel TEST0001-1, and people call 3 of its presses good, at least 4"
        in early.sentence()
    )
    assert done.code == 0, done.err
    assert "12 nominal presses, 4 of them from the station\n" in done.out


@pytest.mark.parametrize("is_of_this_kind", [True, False])
def test_presses_of_a_new_gel_that_were_refused_for_their_colours_are_learnt(
    inspected: Judged, tmp_path: Path, is_of_this_kind: bool
) -> None:
    """They are scored for that alone; colours that no sensor of this kind shows are not."""
    known = json.loads((inspected.old / "manifest.json").read_text())["colours"]
    cells = known["cells"] if is_of_this_kind else (255 - np.array(known["cells"])).tolist()
    strict = variant(inspected.old, tmp_path / "strict", colours={"cells": cells, "limit": 1e-9})
    with SteppedStation(station_config(tmp_path, inspected.presses, strict)) as station:
        station.play_presses(1)
        station.clock.sleep(1)
        station.ask("replace_gel")
        station.play_presses(6)
        ids = [result.press_id for result in station.results]
        assert station.verdicts == ["rejected"] * 6
    refused = dataclasses.replace(inspected, folder=tmp_path, ids=ids, old=strict)
    refused.say(dict.fromkeys((1, 3, 5), "good"))
    early = learn(refused)
    refused.say({2: "good"})
    done = learn(refused)

    if is_of_this_kind:
        assert "people call 3 of its presses good, at least 4 are needed" in early.sentence()
        assert done.code == 0, done.err
        assert "4 of them from the station\n" in done.out
        assert Bundle.load(tmp_path / "new").manifest.colours.limit > 0.01
    else:
        assert f"left out: {ids[1]} (rejected; kim: good) has no score" in done.err
        assert done.code == 3
        assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("gel", [None, GelBundle("SIM1", "G2", "bundle")])
def test_on_a_new_gel_good_presses_of_gels_before_hold_up_no_bundle(gel: GelBundle | None) -> None:
    """Where the old bundle is proven they do; a damage of whichever gel that the new bundle loses holds it up, and a
    good press of the mounted gel."""
    passed, failed = Press(decide(1.0, 2.0)), Press(decide(3.0, 2.0))

    def refuse(before: Mapping[str, Press], after: Mapping[str, Press]) -> str:
        presses = ConfirmedPresses(new_gel=gel, on_new_gel={"here", "there too"})
        for name in before:
            press = Mock(press_id=name, score=1.0, threshold=2.0, verdict="pass")
            word = "damaged" if name.startswith("dent") else "good"
            presses.add(ConfirmedPress(press, PersonVerdict(name, 0, "kim", word), b"", name))
        try:
            Comparison(presses, before, after).check()
        except FitError as error:
            return str(error)
        return ""

    earlier = {"here": passed, "earlier": passed, "earlier too": passed, "dent": failed}
    fails_earlier = refuse(earlier, earlier | {"earlier": failed, "earlier too": failed})

    assert ("it alone fails earlier (" in fails_earlier) == (gel is None)
    assert "it alone fails here (" in refuse(earlier, earlier | {"here": failed})
    assert "passes what was found before" in refuse(earlier, earlier | {"dent": passed})


def test_on_a_new_gel_a_good_press_is_far_where_it_is_far_from_the_others() -> None:
    """All presses score higher there: of the threshold 2.6 is too far where the others score 1.2, and 3.2 is not where
    they score 1.8. A gel on which they score 2.6 times the threshold is too different."""

    def called_good(*ratios: float) -> ConfirmedPresses:
        presses = ConfirmedPresses(new_gel=GelBundle("SIM1", "G2", "bundle"))
        for number, ratio in enumerate(ratios):
            press = Mock(press_id=f"{number}", score=ratio, threshold=1.0, verdict="fail")
            presses.good.append(
                ConfirmedPress(press, PersonVerdict(f"{number}", 0, "kim", "good"), b"", f"{number}")
            )
            presses.on_new_gel.add(f"{number}")
        presses.leave_out_far()
        return presses

    near, far = called_good(1.8, 1.8, 1.8, 1.8, 3.2), called_good(1.2, 1.2, 1.2, 1.2, 2.6)
    near.check_new_gel()

    assert (len(near.good), near.left_out) == (5, [])
    assert (len(far.good), len(far.left_out)) == (4, 1)
    assert far.left_out[0].startswith("4 (fail, 2.60 of the threshold; kim: good) lies beyond 2.4 times")
    with pytest.raises(
        FitError, match=r"on gel G2 score 2\.60 times the threshold in the median, expected at most"
    ):
        called_good(2.6, 2.6, 2.6, 2.6).check_new_gel()


def test_a_press_that_is_gone_from_the_archive_is_named(station: Judged) -> None:
    """The others are learnt; of a damage it is said that it is not proven to be found."""
    folder, ids = station.folder, station.ids
    for number in (1, 4):
        (folder / "gelgate.archive" / "presses" / f"{ids[number]}.json").unlink()
    station.say({0: "good", 1: "good", 4: "damaged"})

    done = learn(station)

    assert done.code == 0, done.err
    assert f"warning: left out: press {ids[1]} is gone" in done.err
    (lost,) = [line for line in done.err.splitlines() if ids[4] in line]
    assert lost.endswith("; whether the new bundle finds this damage is not known")
    assert done.err.count("is not known") == 1
    assert "9 nominal presses, 1 of them from the station" in done.out


def test_a_press_whose_free_gel_is_gone_from_the_archive_holds_up_no_other(station: Judged) -> None:
    """It cannot be judged again: it is left out by name."""
    archive, press_id = station.database.with_suffix(".archive"), station.ids[4]
    record = json.loads((archive / "presses" / f"{press_id}.json").read_text())
    text = json.dumps(record | {"reference": hashlib.sha256(b"of this press alone").hexdigest()})
    (archive / "presses" / f"{press_id}.json").write_text(text)
    evidence = hashlib.sha256(text.encode()).hexdigest()
    execute(station.database, f"UPDATE presses SET evidence = x'{evidence}' WHERE press_id = '{press_id}'")
    station.say({0: "good", 4: "damaged"})

    done = learn(station)

    assert done.code == 0, done.err
    assert f"warning: left out: the free gel of press {press_id} is gone" in done.err
    assert "whether the new bundle finds this damage is not known" in done.err
    assert "9 nominal presses, 1 of them from the station" in done.out


def test_the_learnt_pictures_are_the_camera_s_bytes(station: Judged) -> None:
    """The picture that is learnt decodes to the frame that was judged."""
    from calibration.fitting.learn import read_confirmed, write_pictures
    from edge.core.part_position import PartPosition

    folder, ids = station.folder, station.ids
    station.say({0: "good"})
    found = read_confirmed(station.database, PartPosition("bolt", "default"), "")

    write_pictures(found.good, folder / "confirmed")

    (path,) = (folder / "confirmed").iterdir()
    assert path.name == f"{ids[0]}.jpg"
    assert path.read_bytes() == found.good[0].frame
    assert cv2.imread(str(path)).shape == (240, 320, 3)


@pytest.mark.parametrize("light", [None, ((2.0, 1.0, 0.5), (0.0, 3.0, 0.0))])
def test_a_press_under_a_light_that_was_followed_is_learnt_as_it_was_scored(
    tmp_path: Path, light: tuple[tuple[float, ...], tuple[float, ...]] | None
) -> None:
    """Under the light of the fit, as the nominal presses are."""
    rgb = np.full((16, 16, 3), (40, 50, 60), np.uint8)
    frame = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
    path = write_picture(ArchivedPress.model_construct(press_id="ONE", light=light), frame, tmp_path)

    expected = (40, 50, 60) if light is None else (80, 53, 30)
    assert path.stem == "ONE"
    assert cv2.imread(str(path))[8, 8, ::-1].tolist() == list(expected)


def test_what_the_old_fit_was_asked_for_is_asked_for_again(station: Judged, tmp_path: Path) -> None:
    """Every `--set` that changes what is learnt, and which files of a folder; and the fit after the next one too."""
    folder = station.folder
    old = Bundle.load(station.old)
    frames = read_presses([station.nominal], old.profile, Region(0, 0, *old.profile.size)).frames
    data = tmp_path / "pictures"
    data.mkdir()
    for number, rgb in enumerate(frames):
        for name in ("press", "other"):
            cv2.imwrite(str(data / f"{name}{number}.png"), cv2.resize(rgb[..., ::-1], (640, 480)))
    asked = {"pattern": "press*", "seed": 4, "folds": 3, "scattered": True}
    settings = [word for name, value in asked.items() for word in ("--set", f"{name}={str(value).lower()}")]
    fit(data, folder / "other", "--resize", "--set", "profile=cropped_lr", *settings)
    station.say({0: "good"})

    done = learn(station, bundle=folder / "other", sources=data)

    assert done.code == 0, done.err
    assert "9 nominal presses, 1 of them from the station\n" in done.out
    manifest = Bundle.load(station.new).manifest
    assert manifest.facts["settings"] == {"resize": True, **PLAIN, **asked}
    assert manifest.provenance.seed == 4
    again = configure_again(Bundle.load(station.new), None, 1, None)
    found = (again.seed, again.folds, again.limit, again.register, again.augment, again.is_scattered)
    assert found == (4, 3, "plain", "never", "auto", True)
    assert old.manifest.facts["settings"] == PLAIN, "what was not asked for is not kept"


def test_a_bundle_that_finds_less_rendered_damage_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """People are asked about the highest presses, so what is learnt raises the limit."""

    def facts(**found: float) -> dict[str, Any]:
        return {"limit": {"kind": next(iter(found), "plain"), "why": "", "found": found}}

    new, fewer = facts(surroundings=0.4583, plain=0.4375), facts(plain=0.625, surroundings=0.5)
    for old in (fewer, facts(plain=0.5), facts(), {}):
        _warn_of_fewer_found(old, new)
        said = capsys.readouterr().err
        assert bool(said) == (old is fewer)
        assert ("the new bundle finds 46%, the old one 62%" in said) == (old is fewer)
