"""`gelgate bundle teach`: what would find a damage that passed, what it costs, and a bundle that finds it."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
from command_line import Outcome, gelgate
from confirmed_station import Judged, fit, hide_places
from graph_session import open_graph
from station import gel, jpeg, variant
from tiny_fit import config

from calibration.fitting.bundle_measurements import score_again
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.limits.appended import TAUGHT_WEIGHTS, append, extend_head
from calibration.fitting.limits.threshold import conformal_threshold, promise_at
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.fitting.teach import (
    Lesson,
    Remedy,
    change_method,
    hold_out,
    lower_limit,
    lower_place,
    why_not,
)
from calibration.fitting.teach_command import _fit_method
from edge.core.detector import Bank
from edge.core.drawn_regions import DrawnRegion, DrawnRegions
from edge.core.errors import NotScorable
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Bundle
from edge.model.manifest import REGION_WEIGHTS
from edge.model.scorer import Scored, Scorer
from edge.store.history import HistoryQuery, read_history

SIDE = 128
"""Of a region, pixels: 8 mm."""


def draw(path: Path, share: float, seed: int = 5, shift_px: int = 0) -> Path:
    """A press with a dent of this share of the film's, and this far from its place."""
    sound = gel(np.random.default_rng(seed), 1.0)
    dented = gel(np.random.default_rng(seed), 1.0, dent=True)
    mixed = sound + share * np.roll(dented.astype(np.float64) - sound, shift_px, axis=1)
    path.write_bytes(jpeg(np.clip(np.rint(mixed), 0, 255).astype(np.uint8)))
    return path


def teach(station: Judged, damaged: Sequence[object], *more: object) -> Outcome:
    named = [word for one in damaged for word in ("--damaged", one)]
    words = station.old, station.nominal, *named, "--method", "tiny"
    return gelgate("bundle", "teach", *words, *more)


def ratio(bundle: Path, picture: Path) -> float:
    loaded = Bundle.load(bundle)
    (rgb,) = read_presses([picture], loaded.profile, loaded.region).frames
    return Scorer(loaded, 1).score(rgb).anomaly_score / loaded.manifest.threshold.value


def find_passed(station: Judged) -> list[int]:
    """The numbers of the presses that passed, the lowest score first."""
    passed = read_history(station.database, HistoryQuery(verdicts=("pass",)))
    return [station.ids.index(row.press_id) for row in sorted(passed, key=lambda row: row.score or 0)]


@pytest.fixture
def faint(inspected: Judged, tmp_path: Path) -> Path:
    """A dent so faint that it passes."""
    picture = draw(tmp_path / "faint.jpg", 0.86)
    assert 0.97 < ratio(inspected.old, picture) < 1
    return picture


def test_what_would_find_it_is_shown_and_nothing_is_written(
    inspected: Judged, faint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each with what it finds, and how many sound presses fail by banks without them."""
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))

    done = teach(inspected, [faint])

    assert done.code == 0, done.err
    assert "presses of operation are not counted" in done.out
    assert re.search(r"faint.jpg passes: score 0.9\d of the limit", done.out)
    rows = {line.partition(":")[0]: line for line in done.out.splitlines()}
    assert (
        "the bundle as it is; finds 0 of 1; by banks without them 0 of 8 nominal presses fail" in rows["now"]
    )
    assert "finds 1 of 1; by banks without them" in rows["limit"]
    assert re.search(r"divided by 1.\d+ at \(.*\) mm; finds 1 of 1", rows["place"])
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("what", ["limit", "place"])
def test_a_remedy_finds_it_without_loss(inspected: Judged, faint: Path, tmp_path: Path, what: str) -> None:
    """Every score is at least what it was, in units of the limit; the bundle is sound, and says what it was taught."""
    loud, sound = draw(tmp_path / "loud.jpg", 1.0), draw(tmp_path / "sound.jpg", 0.0)
    old, new = inspected.old, tmp_path / "new"
    before = (old / "manifest.json").read_bytes()

    done = teach(inspected, [faint], "--take", what, "-o", new)

    assert done.code == 0, done.err
    manifest = Bundle.load(new).manifest
    assert manifest.decide(ratio(new, faint) * manifest.threshold.value).kind == "fail"
    assert all(ratio(new, one) >= ratio(old, one) for one in (loud, sound))
    assert manifest.facts["taught"][0]["presses"] == [f"{tmp_path.name}/faint.jpg"]
    assert manifest.revision == 2
    assert gelgate("bundle", "verify", new).code == 0
    assert (old / "manifest.json").read_bytes() == before
    assert "false alarms: 8 presses, counted as 8 pieces: at" in done.out


def press(rng: np.random.Generator, spot: tuple[int, int] | None = None, levels: int = 8) -> np.ndarray:
    """A press whose upper left corner differs from piece to piece; with a blob at a spot (y, x)."""
    rgb: np.ndarray = rng.integers(119, 122, (SIDE, SIDE, 3), dtype=np.uint8)
    rgb[:8, :8] += np.uint8(rng.integers(0, 60))
    if spot is not None:
        rgb[spot[0] : spot[0] + 8, spot[1] : spot[1] + 8] += np.uint8(levels)
    return rgb


def gather(frames: Sequence[np.ndarray], name: str) -> NominalPresses:
    return NominalPresses(np.stack(frames), tuple(f"{name} {k}" for k in range(len(frames))))


@pytest.fixture(scope="module")
def lesson() -> Lesson:
    """Two faint blobs where sound presses are alike, and a limit that the corner sets."""
    rng = np.random.default_rng(8)
    nominal = gather([press(rng) for _ in range(20)], "press")
    damaged = gather([press(rng, (96, 96)), press(rng, (96, 32), 6)], "blob")
    damaged.frames[:, :8, :8] = 149
    settings = config(
        profile=SensorProfile("tiny", (SIDE, SIDE), (0.0, 0.0), (SIDE, SIDE), 1, 15.77),
        region=Region(0, 0, SIDE, SIDE),
    )
    old = fit_files(nominal, settings, created="2026-01-01").bundle()
    return Lesson(old, damaged, nominal, settings, "2026-01-01")


def test_a_place_finds_what_stands_out_there_alone(lesson: Lesson) -> None:
    """At no cost, where the limit of all places would fail nearly every sound press."""
    assert lesson.missed == [0, 1]
    limit, place = lower_limit(lesson), lower_place(lesson)

    assert isinstance(place, Remedy)
    assert place.is_found == [True, True]
    assert place.alarms == 0
    assert place.rate == pytest.approx(0.05)
    assert not isinstance(limit, Remedy) or limit.alarms > 10
    weights = place.fitted.bundle().bank[TAUGHT_WEIGHTS]
    assert (weights[:8, :8] == 1).all()
    assert weights[100, 100] > 1 < weights[100, 36]
    pictures = place.fitted.bundle().nominal_pictures
    assert pictures is not None
    assert pictures == lesson.old.nominal_pictures  # what people are shown stays


def test_where_the_score_is_not_the_highest_of_its_map_no_place_is_taught(lesson: Lesson) -> None:
    """The weights of a place make it that, so what was found by the other score would pass."""
    old = lesson.old
    three = "score = Mul (other_score, three)"
    head = extend_head(old.graphs.head or b"", {"score": "other_score"}, {}, three, "float three = {3}")
    limit = old.manifest.threshold
    scores = tuple(3 * score for score in limit.nominal_scores)
    limit = limit.model_copy(update={"value": 3 * limit.value, "nominal_scores": scores})
    changed = {"graphs": dataclasses.replace(old.graphs, head=head), "golden": ()}
    other = dataclasses.replace(old, manifest=old.manifest.model_copy(update={"threshold": limit}), **changed)
    scorer = Scorer(other, 1)
    other = dataclasses.replace(other, golden=tuple(score_again(one, scorer) for one in old.golden))

    said = lower_place(dataclasses.replace(lesson, old=other))

    assert isinstance(said, str)
    assert "is not the highest value of its map" in said


def test_another_method_keeps_the_drawn_regions(lesson: Lesson, other_package: None) -> None:
    """With what its own limit promises with them."""
    seam = DrawnRegion("seam", "stricter", ((1.0, 1.0), (3.0, 1.0), (3.0, 3.0)), 1.5)
    drawn = lesson.old.manifest.model_copy(update={"regions": DrawnRegions((seam,))})
    old = dataclasses.replace(lesson.old, manifest=drawn)

    remedy = change_method(lesson, "tiny", lambda: _fit_method(dataclasses.replace(lesson, old=old), "tiny"))

    assert isinstance(remedy, Remedy)
    assert remedy.fitted.manifest.regions == drawn.regions
    assert (remedy.fitted.bundle().bank[REGION_WEIGHTS] == 1.5).any()
    assert "the promise with the drawn regions" in remedy.fitted.manifest.threshold.method


def test_a_later_lesson_keeps_the_earlier_one(lesson: Lesson) -> None:
    """The weights of both hold, the head is extended once, and the bundle says both."""
    one = dataclasses.replace(lesson, damaged=lesson.damaged.choose([0]))
    first = lower_place(one)
    assert isinstance(first, Remedy)
    old = first.fitted.bundle()
    second = lower_place(dataclasses.replace(lesson, old=old))
    assert isinstance(second, Remedy)

    new = second.fitted.bundle()
    assert second.is_found == [True, True]
    assert (first.is_found, second.alarms) == ([True], 0)
    assert new.graphs.head == old.graphs.head
    assert (new.bank[TAUGHT_WEIGHTS] >= old.bank[TAUGHT_WEIGHTS]).all()
    assert [len(one["presses"]) for one in new.manifest.facts["taught"]] == [1, 2]
    assert new.manifest.revision == 2


def test_the_reason_names_the_sound_press_that_is_nearest(lesson: Lesson) -> None:
    """A sound press as damage: the others show as much where it stands out most."""
    rng = np.random.default_rng(9)
    (said,) = why_not(dataclasses.replace(lesson, damaged=gather([press(rng)], "sound")))

    assert re.search(
        r"sound 0 scores \d\.\d+ of the limit at \(.*\) mm, where .* the sound press press \d+ \d\.", said
    )


def test_the_cost_of_a_place_is_counted_on_presses_that_did_not_choose_it(lesson: Lesson) -> None:
    """Each sound press has a blob where no other has one, and the damage has two of these. With the place that all
    presses choose one of the two passes; each would fail by the place that the others choose."""
    rng = np.random.default_rng(10)
    spots = [(20 * row + 24, 20 * column) for row in range(5) for column in range(1, 5)]
    nominal = gather([press(rng, spot) for spot in spots], "press")
    damaged = press(rng, spots[7])
    damaged[spots[12][0] : spots[12][0] + 8, spots[12][1] : spots[12][1] + 8] += np.uint8(8)
    damaged[:16, :16] = 149
    old = fit_files(nominal, lesson.config, created="2026-01-01").bundle()
    taught = Lesson(old, gather([damaged], "blobs"), nominal, lesson.config, "2026-01-01")
    place = lower_place(taught)
    assert isinstance(place, Remedy)
    assert taught.held_out is not None
    by_all = taught.held_out[1] * place.fitted.bundle().bank[TAUGHT_WEIGHTS]

    assert place.alarms == 1 + int((by_all.max(axis=(1, 2)) > 1).sum())


def test_a_press_that_has_no_score_is_no_trial(lesson: Lesson, monkeypatch: pytest.MonkeyPatch) -> None:
    """A station never judges such a one, so it is none of the sound presses that pass."""
    score, unseen = Scorer.score, [lesson.nominal.frames[k].tobytes() for k in (3, 4)]

    def refuse(scorer: Scorer, rgb: np.ndarray) -> Scored:
        if rgb.tobytes() in unseen:
            raise NotScorable("its score is no finite number")
        return score(scorer, rgb)

    monkeypatch.setattr(Scorer, "score", refuse)
    place = lower_place(dataclasses.replace(lesson))
    assert isinstance(place, Remedy)
    assert place.fitted.manifest.threshold.n == 18
    assert place.rate == pytest.approx(1 / 19)


def test_a_scar_of_a_sound_press_costs_nothing_where_it_was_not_judged(lesson: Lesson) -> None:
    frames, places = lesson.nominal.frames.copy(), np.zeros(lesson.nominal.frames.shape[:3], np.bool_)
    frames[3, 60:68, 60:68], places[3, 48:80, 48:80] = 255, True
    shown = []
    for unjudged in (None, places):
        scarred = dataclasses.replace(lesson.nominal, frames=frames, unjudged=unjudged)
        held_out = hold_out(lesson.old, scarred, lesson.config, "")
        assert held_out is not None
        shown.append(held_out[1][3, 48:80, 48:80].max())
    assert shown[1] < 0.1 < 0.5 < shown[0]


@pytest.mark.parametrize(
    ("pieces", "folds"),
    [
        ("aabbccddee", "0011220011"),
        ("aaaaabbbbb", "0120120120"),  # of two pieces each press is left out alone
        ("aaaaaaabcd", "0120120120"),  # three presses make no bank
    ],
)
def test_a_press_is_scored_by_a_bank_without_its_piece(
    lesson: Lesson, monkeypatch: pytest.MonkeyPatch, pieces: str, folds: str
) -> None:
    """Or the cost of a place would be that of pieces that the bank knows."""
    nominal = dataclasses.replace(lesson.nominal.first(10), specimens=tuple(pieces))
    learnt = []

    def note(rest: NominalPresses, *given: Any, **more: Any) -> Fitted:
        learnt.append(set(rest.names))
        return fit_files(rest, *given, **more)

    monkeypatch.setattr("calibration.fitting.teach.fit_files", note)
    assert hold_out(lesson.old, nominal, lesson.config, "") is not None
    left_out = [
        {name for name, k in zip(nominal.names, folds, strict=True) if k == str(fold)} for fold in range(3)
    ]
    assert learnt == [{*nominal.names} - held for held in left_out]


def test_of_few_presses_no_place_is_tried(lesson: Lesson) -> None:
    few = dataclasses.replace(lesson, nominal=lesson.nominal.first(5))

    assert lower_place(few) == "place: of one piece, or fewer than 6 presses, none can be held out"
    assert why_not(few) == []


def test_where_nothing_finds_it_the_nearest_sound_press_is_the_reason(station: Judged) -> None:
    """The soundest press, that somebody calls damaged."""
    taught, good = find_passed(station)[:2]
    station.say({taught: "damaged", good: "good"})

    done = teach(station, [station.ids[taught]], "-c", station.config)

    assert done.code == 0, done.err
    (reason,) = [line for line in done.out.splitlines() if line.startswith("nothing of this finds it")]
    assert re.search(
        rf"{station.ids[taught]} scores 0.\d+ of the limit at .* and the sound press \S+ 0.\d+", reason
    )
    assert ": every sound press would fail" in done.out
    assert "archived presses: done" in done.err


def test_a_remedy_that_fails_what_people_call_good_is_not_written(station: Judged) -> None:
    """A limit below a press that somebody calls damaged lies below a good one, too."""
    taught, good = find_passed(station)[-2:]
    station.say({taught: "damaged", good: "good"})

    words = "-c", station.config, "--take", "limit", "-o", station.new
    done = teach(station, [station.ids[taught]], *words)

    assert "fails more of the presses that people call good, and is not written" in done.sentence()
    assert not (station.new).exists()


@pytest.mark.parametrize(
    ("damaged", "more", "sentence"),
    [
        (["loud"], [], "the bundle finds every one of these presses; there is nothing to teach"),
        (["faint"] * 6, [], "found 6 damaged presses, expected 1 to 5"),
        (["faint"], ["--take", "limit"], "give both, or none to look first"),
        (["faint"], ["--take", "place_", "-o", "new"], "is not among what can be taken"),
        (["01J"], [], "does not exist"),
    ],
)
def test_what_cannot_be_taught_is_a_sentence(
    inspected: Judged,
    faint: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    damaged: Sequence[str],
    more: Sequence[object],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    files = [tmp_path / f"{k}.jpg" for k in range(len(damaged))]
    drawn: list[object] = [
        draw(path, {"loud": 1.0, "faint": 0.86}[word]) if word in ("loud", "faint") else word
        for k, (path, word) in enumerate(zip(files, damaged, strict=True))
    ]

    done = teach(inspected, drawn, *more)

    assert sentence in done.sentence()
    assert not (tmp_path / "new").exists()


def test_a_press_that_people_call_good_is_no_damage(station: Judged) -> None:
    station.say({1: "good"})

    done = teach(station, [station.ids[1]], "-c", station.config)

    assert f"people call {station.ids[1]} (pass" in done.sentence()


def test_a_press_of_another_part_is_no_lesson(station: Judged) -> None:
    others = variant(station.old, station.folder / "nut", part="nut")

    done = teach(dataclasses.replace(station, old=others), [station.ids[2]], "-c", station.config)

    assert f"press {station.ids[2]} is of bolt/default, and the bundle is of nut/default" in done.sentence()


def test_a_damage_that_lay_where_the_station_did_not_judge_is_missed(station: Judged) -> None:
    """Under a scar of the gel: it passed, whatever the score of its whole picture is."""
    scar = hide_places(station, station.ids[2], slice(None), slice(None))

    done = teach(station, [station.ids[2]], "-c", station.config)

    assert scar.all()
    assert f"{station.ids[2]} passes: score 0." in done.out
    assert "without the places at which the station did not judge it" in done.out


def test_a_given_limit_has_no_cost_that_is_known(inspected: Judged, faint: Path, tmp_path: Path) -> None:
    fit(inspected.nominal, tmp_path / "given", "--set", "threshold=1000")

    done = gelgate("bundle", "teach", tmp_path / "given", inspected.nominal, "--damaged", faint)

    assert "has no scores of presses (given by hand)" in done.sentence()


def test_the_weights_of_a_head_are_those_of_float64() -> None:
    """A score map times the weights, and its highest value, for several frames at once."""
    frames = tiny.presses(3)
    plain = Bundle.in_memory(*tiny.tiny_files())
    weights = np.random.default_rng(0).uniform(1, 3, plain.manifest.frame).astype(np.float32)
    head, bank = append(plain.graphs.head or b"", Bank(dict(plain.bank)), {TAUGHT_WEIGHTS: weights})
    maps = np.stack([one.score_map for one in Scorer(plain).score_batch(frames)]).astype(np.float64)
    session = open_graph(head)
    trunk = open_graph(plain.graphs.trunk)
    taps = {i.name for i in session.get_inputs()} - set(bank.arrays)
    features = dict(
        zip([o.name for o in trunk.get_outputs()], trunk.run(None, {"frames": frames}), strict=True)
    )
    score_map, score = session.run(
        ["score_map", "score"], {**{tap: features[tap] for tap in taps}, **bank.arrays}
    )

    np.testing.assert_allclose(score_map, maps * weights, rtol=1e-6)
    np.testing.assert_array_equal(score, score_map.max(axis=(1, 2)))


@pytest.mark.parametrize("value", [0.2, 0.45, 0.9, 1.5])
def test_a_given_limit_promises_the_smallest_rate_whose_own_limit_is_no_higher(value: float) -> None:
    """Of ten presses, 0.1 to 1.0, above each of which lie the next ones."""
    scores = np.arange(1, 11) / 10

    found = promise_at(scores, value, 0.05)

    assert found is not None
    assert found.value == value
    above = int((scores > value).sum())
    assert found.alpha == pytest.approx(0.05 if value > 1.2 else (above + 1) / 11, abs=1e-9)
    assert found.by_press is not None
    assert found.by_press.alarms == above
    assert conformal_threshold(scores, found.alpha).value <= value


def test_a_limit_below_every_press_promises_nothing() -> None:
    assert promise_at(np.arange(1, 11) / 10, 0.05, 0.05) is None
