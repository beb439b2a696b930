"""A shadow is scored beside the bundle in use and decides nothing, until it takes over on request."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import gelgate
from shadow_station import FIVE, Shadowed, adopt, restore
from sql import execute
from station import Motion, press_recording, variant
from stepped_station import SteppedStation

from edge.core.contact.mask import Touch
from edge.core.errors import NotScorable
from edge.core.part_position import PartPosition
from edge.core.press import JudgedFrame, Press, ShadowVerdict
from edge.features.shadow import Shadow, _follow_light
from edge.gateway.bundle_set import BundleSet
from edge.gateway.opening import Opened
from edge.model.bundle import Bundle
from edge.store.acts import CONFIRM, Act
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database

PZ0 = PartPosition("PZ0", "pos1")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven short presses, the third and sixth one dented."""
    folder = tmp_path_factory.mktemp("shadow") / "presses"
    return press_recording(folder, 7, dented=[2, 5], motion=Motion(hold=8, idle=24), seed=5)


@pytest.fixture
def shadow(tmp_path: Path, bundle: Path) -> Path:
    """The same bundle with a stated promise and another revision."""
    return variant(bundle, tmp_path / "new", revision=2, threshold=FIVE)


def say(station: SteppedStation, words: Mapping[int, str], person: str = "kim") -> None:
    for number, word in words.items():
        given = {"press_id": station.results[number].press_id, "verdict": word}
        act = Act(1, f"{person}, at the page", CONFIRM, None, given, outcome="done")
        station.parts.store.begin_act(act)


def test_a_shadow_is_heard_and_decides_nothing(shadowed: Shadowed, tmp_path: Path, bundle: Path) -> None:
    """One that passes everything: verdicts are as without it, and both are in the result, the row and the history."""
    lenient = variant(bundle, tmp_path / "lenient", threshold={"value": 1e6})
    with SteppedStation(shadowed(bundle, folder="alone")) as alone:
        alone.play_presses(3)
    with SteppedStation(shadowed(bundle, lenient, folder="both")) as station:
        station.play_presses(3)
        database = station.parts.store.path
        ids = station.bundle_id, station.parts.selection.shadow.bundle.digest
        word = station.ask("confirm_press", press_id=station.results[2].press_id, verdict="good")

    assert word["remarks"][0].startswith("the shadow takes over on request (`adopt_shadow`)")
    assert station.verdicts == alone.verdicts
    assert station.verdicts == ["pass", "pass", "fail"]
    assert [one.score for one in station.results] == [one.score for one in alone.results]
    said = [one.shadow for one in station.results]
    assert {(one.bundle_id, one.beside, one.verdict, one.threshold) for one in said} == {
        (ids[1], ids[0], "pass", 1e6)
    }
    assert [one.score for one in said] == [
        one.score for one in station.results
    ]  # the same graphs, bit for bit
    assert all("shadow" in one.latency_ms for one in station.results)
    assert {one.shadow for one in alone.results} == {None}
    rows = list(read_history(database, HistoryQuery()))
    assert [ShadowVerdict.decode(row.shadow).score for row in rows] == [one.score for one in said]
    printed = gelgate("history", "--database", database, "--by", "shadow").out.splitlines()
    assert printed[0] == (
        f"shadow {ids[1][:12]} beside {ids[0][:12]}: 3 presses judged by both: 0 pass the bundle in use alone, 1 the "
        "shadow alone; of 0 that people call good 0 and 0 do not pass, of 0 that they call damaged 0 and 0 pass"
    )
    assert printed[1:] == [f"  {station.results[2].press_id}  fail, shadow pass"]
    assert gelgate("history", "--database", database).out.count("  shadow pass") == 3
    assert [one.text for one in check_database(database) if one.is_fault] == []


def test_a_shadow_takes_one_head_more_and_no_trunk(shadowed: Shadowed, bundle: Path, shadow: Path) -> None:
    """The features of the bundle in use serve both; counted in runs of the graphs."""
    with SteppedStation(shadowed(bundle, shadow)) as station:
        station.play_presses(1)  # now all memory is there
        scorers = station.parts.selection.inspector.scorer, station.parts.selection.shadow.scorer
        assert scorers[0]._trunk is scorers[1]._trunk
        trunks, heads = [], []
        for scorer in scorers:
            pipe = scorer._pipe
            pipe._trunk = Mock(wraps=pipe._trunk)
            trunks.append(pipe._trunk.run_with_iobinding)
        for pipe in (scorers[0]._pipe, scorers[1]._pipe, scorers[1]._beside[1]):
            pipe._head = Mock(wraps=pipe._head)
            heads.append(pipe._head.run_with_iobinding)
        station.play_presses(3)

    assert trunks[1].call_count == heads[1].call_count == 0
    assert heads[2].call_count == 2
    assert trunks[0].call_count >= 2


def test_a_shadow_takes_over_stays_and_is_taken_back(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, shadow: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By two requests; what it replaced is its shadow then, also after a restart, and counts as no older bundle."""
    monkeypatch.setattr("edge.core.shadow.LEAST_COMPARED", 3)
    first = variant(bundle, tmp_path / "first", revision=1)
    old, new = Bundle.load(first).digest, Bundle.load(shadow).digest
    config = shadowed(first, shadow)
    with SteppedStation(config) as station:
        station.play_presses(3)
        say(station, {0: "good", 2: "damaged"})
        data = adopt(station)
        assert station.bundle_id == new
        station.play_presses(4)
        text = station.alarm("takeover")
        (act,) = [act for act in station.parts.store.acts() if act.verb == "take_over"]
    with SteppedStation(config) as again:
        again.play_presses(2)
        with pytest.raises(ValueError, match="has taken over already; restore_bundle brings"):
            again.ask("adopt_shadow")
        assert restore(again)["is_waiting"] is True
        again.play_presses(3)
        with pytest.raises(ValueError, match="no shadow has taken the place"):
            again.ask("restore_bundle")
    with SteppedStation(config) as last:
        last.play_presses(1)
        found = check_database(last.parts.store.path)

    assert (data["bundle_id"], data["instead_of"]) == (new, old)
    assert [one.bundle_id for one in station.results] == [old, old, old, new]
    assert (station.results[3].shadow.bundle_id, station.results[3].shadow.beside) == (old, new)
    assert text.startswith(
        f"bundle {new[:12]} inspects PZ0/pos1 instead of {old[:12]}: 3 presses judged by both"
    )
    assert (act.before, act.after["bundle_id"], act.after["why"]) == ({"bundle_id": old}, new, data["why"])
    assert [one.bundle_id for one in again.results] == [new, new, old]
    assert last.results[0].bundle_id == old
    assert [one.text for one in found if one.is_fault] == []


def test_a_shadow_takes_over_by_itself_once_and_not_where_it_was_taken_back(
    shadowed: Shadowed, bundle: Path, shadow: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where that is configured: when the request would not be refused, with the same act and alarm."""
    monkeypatch.setattr("edge.core.shadow.LEAST_COMPARED", 3)
    monkeypatch.setattr("edge.features.shadow.WEIGHED_EVERY_S", 0.0)
    new, config = Bundle.load(shadow).digest, shadowed(bundle, shadow)

    def play(station: SteppedStation, upto: int) -> None:
        for number in range(len(station.reports) + 1, upto + 1):
            station.play_presses(number)
            station.find(Shadow).worker.step()
            station.turn()

    with SteppedStation(config) as asked:
        play(asked, 4)
    config.write_text(config.read_text().replace("shadows =", 'takeover = "by itself"\nshadows ='))
    with SteppedStation(config) as station:
        play(station, 3)
        text = station.alarm("takeover")
        restore(station)
        play(station, 6)
        acts = [act.after["bundle_id"] for act in station.parts.store.acts() if act.verb == "take_over"]

    assert {one.bundle_id for one in asked.results} == {Bundle.load(bundle).digest}
    assert text.startswith(f"bundle {new[:12]} inspects PZ0/pos1 instead of")
    assert acts == [Bundle.load(bundle).digest, new]  # the newest first: taken back, and for good
    assert station.results[-1].bundle_id == Bundle.load(bundle).digest


def test_a_takeover_is_an_alarm_until_somebody_acknowledges_it(
    shadowed: Shadowed, bundle: Path, shadow: Path, few: None
) -> None:
    """Over restarts, while the bundle that has taken over inspects."""
    config = shadowed(bundle, shadow)
    with SteppedStation(config) as station:
        station.play_presses(1)
        adopt(station)
        text = station.alarm("takeover")
    with SteppedStation(config) as again:
        again.turn()
        after_restart = again.alarm("takeover")
        act = Act(1, "kim, at the page", "acknowledge_alarm", None, {"alarm": "takeover"}, outcome="done")
        again.parts.store.begin_act(act)
    with SteppedStation(config) as last:
        last.turn()
        acknowledged = last.alarm("takeover")

    assert text is not None
    assert (after_restart, acknowledged) == (text, None)


def test_a_refused_request_with_the_name_of_a_takeover_is_none(
    shadowed: Shadowed, bundle: Path, shadow: Path, few: None
) -> None:
    """Anybody may ask a broker or a page for any verb, and each refusal is an act."""
    refused = Act(1, "page", "take_over", "7", {"part": 1}, outcome="refused", sentence="it needs the token")
    config = shadowed(bundle, shadow)
    with SteppedStation(config) as station:
        station.parts.store.begin_act(refused, 0)
    with SteppedStation(config) as second:
        second.turn()
        assert second.alarm("takeover") is None
        second.play_presses(1)
        adopt(second)
        text = second.alarm("takeover")
        second.parts.store.begin_act(refused, 0)
    with SteppedStation(config) as last:
        last.turn()
        assert text is not None
        assert last.alarm("takeover") == text


def test_a_takeover_waits_for_a_press_end(shadowed: Shadowed, bundle: Path, shadow: Path, few: None) -> None:
    with SteppedStation(shadowed(bundle, shadow)) as station:
        station.play_presses(1)
        station.play_until(lambda: station.loop.session.has_contact)
        adopt(station)
        assert station.alarm("takeover") is None
        station.play_presses(3)

    old, new = Bundle.load(bundle).digest, Bundle.load(shadow).digest
    assert [one.bundle_id for one in station.results] == [old, old, new]


def test_a_damage_named_after_the_takeover_is_no_secret_of_the_bundle_that_passes_it(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, few: None
) -> None:
    """The bundle before had failed it, and nobody had spoken when the other one took over. Where that one has not
    judged it, the answer to the word says so."""
    lenient = variant(bundle, tmp_path / "lenient", revision=2, threshold=FIVE | {"value": 1e6})
    with SteppedStation(shadowed(bundle)) as before:
        before.play_presses(3)
    with SteppedStation(shadowed(bundle, lenient)) as station:
        station.play_presses(3)
        adopt(station)
        found, judged_alone = (one.results[2].press_id for one in (station, before))
        answers = [
            station.ask("confirm_press", press_id=press_id, verdict="damaged")["remarks"]
            for press_id in (found, judged_alone)
        ]
        say(station, {2: "damaged"})
        station.clock.sleep(2)
        station.turn()
        text = station.alarm("escape")

    assert (station.verdicts[2], station.results[2].shadow.verdict) == ("fail", "pass")
    assert text == (
        "the bundle that inspects now passes presses that another one found and that people called damaged in the last "
        f"day: {found}"
    )
    assert answers[0] == []
    assert "whether the one that inspects now finds it is not known" in answers[1][0]


def test_the_way_back_names_the_damage_that_the_old_bundle_passes(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, few: None
) -> None:
    """And is not held up by it."""
    lenient = variant(bundle, tmp_path / "lenient", revision=1, threshold=FIVE | {"value": 1e6})
    strict = variant(bundle, tmp_path / "strict", revision=2, threshold=FIVE)
    with SteppedStation(shadowed(lenient, strict)) as station:
        station.play_presses(1)
        adopt(station)
        station.play_presses(3)
        say(station, {2: "damaged"})
        restore(station)
        text = station.alarm("takeover")
        assert station.bundle_id == Bundle.load(lenient).digest

    named = f"it passes {station.results[2].press_id}, which somebody called damaged"
    assert text is not None
    assert text.endswith(f": restore_bundle was asked for; {named}")


@pytest.mark.parametrize(
    ("words", "value", "sentences"),
    [
        ({0: "good", 2: "damaged"}, 0.1, ["both have judged 3 presses, at least 100 are needed"]),
        (
            {2: "damaged"},
            1e6,
            ["at least 100", "it passes damage that was found: {2}", "passes {2}, which somebody"],
        ),
        ({0: "good"}, 1e-9, ["at least 100", "1 instead of 0 of the 1 press that people call good"]),
    ],
)
def test_a_shadow_that_is_worse_is_refused_with_the_presses(
    shadowed: Shadowed,
    tmp_path: Path,
    bundle: Path,
    words: Mapping[int, str],
    value: float,
    sentences: list[str],
) -> None:
    other = variant(bundle, tmp_path / "other", revision=3, threshold=FIVE | {"value": value})
    with SteppedStation(shadowed(bundle, other)) as station:
        station.play_presses(3)
        say(station, words)
        with pytest.raises(ValueError, match="does not take over") as refused:
            adopt(station)
        station.turn()
        assert station.parts.selection.instead_of is None

    ids = [one.press_id for one in station.results]
    for sentence in sentences:
        assert sentence.format(*ids) in str(refused.value)


def test_on_a_new_gel_a_shadow_that_has_learnt_its_presses_need_not_wait(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four of it that people call good, judged from the archive; with three, and on a gel on which the bundle in use
    is proven, it waits for 100 presses. Damage that people named stands in its way as ever, and is asked for again."""
    lenient = FIVE | {"value": 1e6}
    proven = Bundle.load(bundle).manifest.provenance.presses

    def learnt(name: str, ids: list[str], threshold: Any) -> Path:
        names = [*proven, *(f"confirmed/{press_id}.jpg" for press_id in ids)]
        return variant(
            bundle, tmp_path / name, revision=2, threshold=threshold, provenance={"presses": names}
        )

    with SteppedStation(shadowed(bundle)) as station:
        station.play_presses(1)
        station.ask("replace_gel")
        station.play_presses(7)
        ids = [one.press_id for one in station.results]
        say(station, dict.fromkeys((0, 1, 3, 4, 6), "good"))
    four, three = [ids[k] for k in (1, 3, 4, 6)], [ids[k] for k in (0, 1, 3, 4)]
    waits = learnt("three", three, FIVE)
    with SteppedStation(shadowed(bundle, waits)) as later:
        later.play_presses(1)
        with pytest.raises(ValueError, match="both have judged 1 press, at least 100 are needed"):
            adopt(later)
    blind = learnt("blind", four, lenient)
    with SteppedStation(shadowed(bundle, blind)) as later:
        given = {"press_id": ids[2], "verdict": "damaged"}
        later.parts.store.begin_act(Act(1, "kim, at the page", CONFIRM, None, given, outcome="done"))
        later.play_presses(1)
        with pytest.raises(ValueError, match="does not take over") as refused:
            adopt(later)
        later.clock.sleep(2)
        later.turn()
        asked = [one["press_id"] for one in later.said("questions")["presses"]]
    with SteppedStation(shadowed(bundle, learnt("four", four, FIVE))) as last:
        last.play_presses(1)
        with monkeypatch.context() as proven_gel:
            proven_gel.setattr("edge.features.shadow.unproven_since", lambda connection, key: None)
            with pytest.raises(ValueError, match="both have judged 2 presses, at least 100 are needed"):
                adopt(last)
        adopt(last)
        assert last.parts.selection.inspector.bundle.manifest.revision == 2

    assert f"it passes damage that was found: {ids[2]}; the station asks once more what {ids[2]} is" in str(
        refused.value
    )
    assert "are needed" not in str(refused.value)
    assert asked[0] == ids[2]


def test_a_shadow_that_cures_alarms_need_not_wait(shadowed: Shadowed, tmp_path: Path, bundle: Path) -> None:
    """Five good presses that the bundle in use fails and the shadow, judged from the archive, does not; with four, and
    where another bundle had failed them, it waits for 100 presses."""
    proven = Bundle.load(bundle).manifest.provenance.presses
    strict = FIVE | {"value": 1e-9}
    in_use = variant(bundle, tmp_path / "strict", threshold=strict)
    with SteppedStation(shadowed(in_use)) as station:
        station.play_presses(7)
        say(station, dict.fromkeys((0, 1, 3, 4, 6), "good"))
        ids = [one.press_id for one in station.results]

    def ask(beside: Path, *learnt: int) -> str:
        names = [*proven, *(f"confirmed/{ids[number]}.jpg" for number in learnt)]
        changes = {"threshold": FIVE, "provenance": {"presses": names}}
        other = variant(bundle, tmp_path / f"{beside.name} {len(learnt)}", revision=3, **changes)
        with SteppedStation(shadowed(beside, other)) as later:
            try:
                return adopt(later)["why"]
            except ValueError as refusal:
                return str(refusal)

    stricter = variant(bundle, tmp_path / "stricter", threshold=strict, revision=2)

    waits = ask(in_use, 0, 1, 3, 4)
    of_another = ask(stricter, 0, 1, 3, 4, 6)
    taken = ask(in_use, 0, 1, 3, 4, 6)

    assert station.verdicts == ["fail"] * 7
    assert "both have judged 4 presses, at least 100 are needed" in waits
    assert "both have judged 0 presses, at least 100 are needed" in of_another
    assert taken.startswith("5 presses judged by both: 0 pass the bundle in use alone, 5 the shadow alone")


def test_good_presses_of_before_the_shadow_that_passed_are_judged_from_the_archive(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, few: None
) -> None:
    """One that fails them may not take over; what another gel shows comes no more."""
    strict = variant(bundle, tmp_path / "strict", revision=2, threshold=FIVE | {"value": 1e-9})
    with SteppedStation(shadowed(bundle)) as station:
        station.play_presses(2)
        say(station, {0: "good", 1: "gel"})
        ids = [one.press_id for one in station.results]
    with SteppedStation(shadowed(bundle, strict)) as later:
        later.play_presses(1)
        with pytest.raises(
            ValueError, match="2 instead of 0 of the 2 presses that people call good"
        ) as refused:
            adopt(later)
        execute(later.parts.store.path, "UPDATE presses SET gel_id = 'earlier' WHERE number <= 2")
        assert adopt(later)["why"].startswith("1 press judged by both: 1 pass the bundle in use alone")

    assert f"do not pass it: {', '.join(sorted(ids))}; the station asks once more" in str(refused.value)


def test_known_damage_of_before_the_shadow_is_judged_from_the_archive(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, few: None
) -> None:
    """And what is gone from there is named: nobody knows whether it is found."""
    lenient = variant(bundle, tmp_path / "lenient", threshold=FIVE | {"value": 1e6})
    with SteppedStation(shadowed(bundle)) as station:
        station.play_presses(6)
        say(station, {2: "damaged", 5: "damaged"})
        ids = [one.press_id for one in station.results]
    (tmp_path / "station" / "gelgate.archive" / "presses" / f"{ids[5]}.json").unlink()
    with SteppedStation(shadowed(bundle, lenient)) as later:
        later.play_presses(1)
        with pytest.raises(ValueError, match="does not take over") as refused:
            adopt(later)

    assert f"it passes damage that was found: {ids[2]};" in str(refused.value)
    assert f"whether the shadow finds the damage of {ids[5]} is not known: press {ids[5]} is gone" in str(
        refused.value
    )


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"part": "PZ1"}, "is for PZ1/pos1, of which this station has no bundle"),
        ({"region": {"x": 40, "y": 8, "width": 224, "height": 224}}, "has another region than"),
        ({"profile": {"pixels_per_mm": 20.0}}, "has another profile than"),
        ({}, "is the bundle of PZ0/pos1 itself"),
        ({"golden": None}, "has a score that is not the highest value of its map"),
        (None, "neither a folder nor a zip file"),
    ],
)
def test_a_shadow_that_cannot_be_compared_is_a_sentence_and_the_station_inspects(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, changes: dict[str, Any] | None, sentence: str
) -> None:
    """At `check` and as an alarm."""
    other = tmp_path / "other"
    if changes is not None:
        manifest = json.loads((bundle / "manifest.json").read_text())
        if "golden" in changes:
            golden = [{**one, "score": one["score"] * 2} for one in manifest["golden"]]
            changes = {"golden": golden, "tolerance": {**manifest["tolerance"], "score": 1e3}}
        variant(bundle, other, **changes)
        if not changes:
            shutil.rmtree(other)
            shutil.copytree(bundle, other)
    config = shadowed(bundle, other)

    checked = gelgate("check", "-c", config)
    with SteppedStation(config) as station:
        station.play_presses(1)
        assert sentence in station.alarm("shadow")
        with pytest.raises(ValueError, match="there is no shadow of PZ0/pos1"):
            station.ask("adopt_shadow")

    assert station.verdicts == ["pass"]
    assert sentence in checked.out.partition("warning: ")[2]
    assert "presses are inspected without it" in checked.out


@pytest.mark.parametrize(
    ("error", "why"),
    [(MemoryError("no room"), "MemoryError('no room')"), (NotScorable("not finite"), "not finite")],
)
def test_a_shadow_that_fails_while_it_scores_disturbs_no_verdict(
    shadowed: Shadowed,
    bundle: Path,
    shadow: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    why: str,
) -> None:
    """It is said once, and over with the next score."""
    with SteppedStation(shadowed(bundle, shadow)) as station:
        station.play_presses(1)
        scorer = station.parts.selection.shadow.scorer
        with monkeypatch.context() as patch:
            patch.setattr(scorer, "score_beside", Mock(side_effect=error))
            station.play_presses(3)
            said = station.alarm("shadow")
        station.play_presses(4)
        after = station.alarm("shadow")

    assert station.verdicts == ["pass", "pass", "fail", "pass"]
    assert [one.shadow.verdict for one in station.results] == ["pass", "error", "error", "pass"]
    assert f"gave no score: {why}" in said
    assert after is None


def test_a_shadow_that_took_over_and_is_gone_leaves_the_configured_bundle(
    shadowed: Shadowed, tmp_path: Path, bundle: Path, shadow: Path, few: None
) -> None:
    """The station inspects, and says so; the older revision is the way back and no older bundle."""
    first = variant(bundle, tmp_path / "first", revision=1)
    config = shadowed(first, shadow)
    with SteppedStation(config) as station:
        station.play_presses(1)
        adopt(station)
    (new, old) = Bundle.load(shadow).digest, Bundle.load(first).digest
    shutil.rmtree(shadow)
    with SteppedStation(config) as again:
        again.play_presses(1)
        text = again.alarm("shadow")

    assert again.results[0].bundle_id == old
    assert f"bundle {new[:12]}, which had taken the place of {first}, is not among the shadows" in text
    assert "the configured one inspects PZ0/pos1 again" in text


def test_a_reload_opens_a_shadow_and_keeps_a_takeover(
    shadowed: Shadowed, bundle: Path, shadow: Path, few: None
) -> None:
    config = shadowed(bundle)
    with SteppedStation(config) as station:
        station.play_presses(1)
        shadowed(bundle, shadow)

        station.reload()
        station.play_presses(2)
        adopt(station)
        station.reload()
        station.play_presses(3)

    new = Bundle.load(shadow).digest
    assert [one.shadow is not None for one in station.results] == [False, True, True]
    assert station.results[2].bundle_id == new


def test_bundles_that_were_opened_before_a_takeover_do_not_take_it_back(
    shadowed: Shadowed, bundle: Path, shadow: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They wait, and the next reload has begun already when the loop finds them."""
    inspecting = list[str]()
    with SteppedStation(shadowed(bundle, shadow)) as station:
        station.play_presses(1)
        selection, open_bundles = station.parts.selection, station.parts.selection._open

        def look_meanwhile(in_use: BundleSet) -> Opened:
            station.turn()
            inspecting.append(station.bundle_id)
            return open_bundles(in_use)

        selection.reload()
        selection.worker.step()
        selection.exchange(Act(1, "the gateway", "take_over", arguments=PZ0._asdict(), outcome="done"))
        monkeypatch.setattr(selection, "_open", look_meanwhile)
        station.reload()
        inspecting.append(station.bundle_id)

    assert inspecting == [Bundle.load(shadow).digest] * 2


def test_a_takeover_that_cannot_be_recorded_is_made_when_it_can(
    shadowed: Shadowed, bundle: Path, shadow: Path, few: None
) -> None:
    with SteppedStation(shadowed(bundle, shadow)) as station:
        station.play_presses(1)
        with station.refusing("acts"):
            adopt(station)
            assert station.loop.is_halted
            assert station.bundle_id == Bundle.load(bundle).digest
        station.turn(2)
        assert not station.loop.is_halted
        assert station.bundle_id == Bundle.load(shadow).digest
        assert station.find(Shadow)._exchange is None


def test_a_shadow_of_another_light_follows_the_free_gel_that_the_press_had() -> None:
    """As the light that is followed shows it; without one the picture that it was compared with. Fitted under the same
    light, it takes the light itself."""
    view = np.full((120, 160, 3), 100, np.float32)
    inspector, other, same = (
        Mock(bundle=Mock(free_reference=Mock(view=seen))) for seen in (view, view + 1, view.copy())
    )
    light = Mock(undo=lambda free: free + 7)
    judged = JudgedFrame(Mock(), Touch(0.1), view + 3)
    for press, expected in ((Press(light=light), view + 7), (Press(judged=judged), view + 3)):
        _follow_light(press, other, inspector)
        assert (other.follow_light.call_args.args[0] == expected).all()
    _follow_light(Press(), other, inspector)
    other.follow_light.assert_called_with(None)
    _follow_light(Press(light=light), same, inspector)
    same.set_light.assert_called_once_with(light)
    same.follow_light.assert_not_called()
