"""Whether a fit registers presses, what the bundle keeps of it, and how the bundle then scores."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import tiny
import turned_parts as parts
from command_line import refuse_by_example
from registered_bundle import PROFILE, PlaceDetector, fitted, nominal, registered

from calibration.fitting.damage.damaged_presses import DamagedPresses
from calibration.fitting.limits.appended import append
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses
from calibration.fitting.pose import pose_decision
from calibration.fitting.pose.pose_decision import PoseChoice, choose_pose
from calibration.fitting.pose.registration import LearntPose, in_pose_of, keep_pose, learn_pose
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.contact.mask import Touch
from edge.core.detector import Bank, Features, Nominal
from edge.core.errors import BundleCorrupt, FitError, PoseNotFound
from edge.core.imaging.region import Region
from edge.core.registration.pose import Pose, warp
from edge.core.registration.registrar import PartInPose, Registrar
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.manifest import Facts
from edge.model.scorer import Scorer
from plugins.detectors.common.smoothing import upsampling_matrix
from plugins.onnx_builder import Graph


def take(frames: np.ndarray) -> Features:
    """Frames as their own features."""
    return {"rgb": frames}


@cache
def learnt_from(part: parts.Bumps, n: int = 8) -> LearntPose:
    """Learn the pose of presses anywhere, once for the tests that look at it."""
    return learn_pose(parts.anywhere(part, n)[1], parts.free_gel())


def test_parts_anywhere_are_registered_and_the_bundle_says_why() -> None:
    """The spread of the presses and the proof on rendered damage are in the manifest."""
    assert registered().manifest.registration is not None
    why = registered().manifest.facts["registration"]
    assert "presses are registered: in the median presses lie" in why
    assert "of rendered damage" in why


def test_parts_too_far_apart_to_lie_as_they_are_need_no_second_bank() -> None:
    """Where a method that compares places is refused as presses lie, the damage in held-out presses decides, the sizes
    that few banks find left out: separated as by chance, or not rendered, presses are not registered."""
    touches = (Touch(0.1, 0.05, 0.5), Touch(0.1, 0.95, 0.5)) * 4
    presses = nominal(parts.anywhere(parts.BLOCK, 8)[1], touches=touches)
    why = fitted(presses, "auto").manifest.facts["registration"]
    assert "too far to be compared as they lie; of rendered damage" in why
    assert "without (image" not in why

    names = ("dent of 0.1 mm", "dent of 0.2 mm", "dent of 0.4 mm") * 4
    damage = DamagedPresses(
        np.zeros((12, 1, 1, 3), np.uint8), np.arange(12), np.ones((12, 1, 1), bool), names
    )
    open_choice = PoseChoice(learnt_from(parts.BLOCK), "far apart", is_open=True)

    def prove(*sizes: float) -> PoseChoice:
        sound, edited = np.ones(20), np.tile(sizes, 4)
        maps = [ScoredPresses(np.zeros((len(one), 1, 1), np.float32), one) for one in (sound, edited)]
        return open_choice.prove(HeldOut(*maps), damage)

    unproven, unrendered = prove(3.0, 0.5, 1.2), open_choice.prove(None, None)
    assert (unproven.learnt, unrendered.learnt) == (None, None)
    assert "of rendered damage 0.500 is separated" in unproven.why
    assert "no damage could be rendered" in unrendered.why
    proven = prove(0.5, 2.0, 3.0)
    assert (proven.separated, proven.is_open) == (1.0, False)
    assert proven.learnt is open_choice.learnt


@pytest.mark.parametrize(
    ("detector", "separated", "is_registered"),
    [
        (PlaceDetector(), 0.844, True),
        (PlaceDetector(), 0.741, False),
        (tiny.TinyDetector(), 0.844, False),
        (tiny.TinyDetector(), 0.9, True),
    ],
)
def test_a_proof_that_decides_nothing_is_for_registration_where_places_are_compared(
    monkeypatch: pytest.MonkeyPatch, detector: tiny.TinyDetector, separated: float, is_registered: bool
) -> None:
    """With 14 sound presses 0.01 is chance, and the next press may lie further away."""
    figures = SimpleNamespace(judge_registered=lambda: (separated, 1.0), judge_still=lambda: (0.855, 1.0))
    monkeypatch.setattr(pose_decision._Proof, "of", lambda *_: figures)
    monkeypatch.setattr(pose_decision, "_learn", lambda _: learnt_from(parts.BLOCK, 9))
    learner: Any = SimpleNamespace(detector=detector)
    presses = nominal(parts.anywhere(parts.BLOCK, 9)[1])
    choice = choose_pose("auto", presses, learner, take, (PROFILE, Region(0, 0, parts.SIDE, parts.SIDE)))

    assert (choice.learnt is not None) == is_registered, choice.why
    assert f"{separated:.3f} is separated from sound presses with it, 0.855 without" in choice.why


def test_many_presses_are_found_by_the_mean_of_some(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every press has its own turn, also those that were not chosen to find the common pose."""
    monkeypatch.setattr("calibration.fitting.pose.registration._MOST_PRESSES", 8)
    poses, presses = parts.anywhere(parts.BLOCK, 12)
    learnt = learn_pose(presses, parts.free_gel())
    turns = np.array(
        [one.turn_rad - other.pose.turn_rad for one, other in zip(poses, learnt.registered, strict=True)]
    )
    assert np.abs(np.angle(np.exp(1j * (turns - turns[0])))).max() < np.radians(2)


def test_a_few_parts_in_a_fixture_are_compared_as_they_lie() -> None:
    """Their copies are moved; the manifest says so."""
    still = parts.anywhere(parts.BLOCK, 8, shift_px=2.0, turn_rad=0.01)[1]
    manifest = fitted(nominal(still), "auto").manifest
    assert manifest.registration is None
    assert "compared as they lie" in manifest.facts["registration"]


def test_a_ball_is_compared_as_it_lies_by_a_method_that_compares_no_places() -> None:
    manifest = fitted(nominal(parts.anywhere(parts.BALL, 6)[1]), "auto", detector=tiny.TINY).manifest
    assert manifest.registration is None
    assert "without a turn" in manifest.facts["registration"]


def test_parts_that_are_held_are_registered_for_the_next_may_lie_further_away() -> None:
    """A press that lies a third of a millimetre beyond those of the fit passes; compared as it lies it fails."""
    held = nominal(parts.anywhere(parts.BLOCK, 10, shift_px=2.0, turn_rad=0.01)[1])
    moved = parts.press(parts.BLOCK, Pose(7.0, -5.0, 0.04), seed=99)

    def judge(bundle: Bundle) -> str:
        return bundle.manifest.decide(Scorer(bundle).score(moved).anomaly_score).kind

    fixture = fitted(held, "auto").bundle()
    assert "the next may lie further away" in fixture.manifest.facts["registration"]
    assert judge(fixture) == "pass"
    assert judge(fitted(held).bundle()) == "fail"
    assert fitted(held, "auto", mode="paper").manifest.registration is None  # it registers nothing


def test_a_held_part_that_looks_nearly_the_same_in_several_turns_keeps_its_own() -> None:
    """A cross with one higher arm passes as it lies in the fixture, and fails turned by a quarter."""
    (x, y, radius, height), *others = parts.CROSS
    keyed = ((x, y, radius, 1.04 * height), *others)
    held = nominal(parts.anywhere(keyed, 12, shift_px=2.0, turn_rad=0.01)[1])
    bundle = fitted(held, "auto").bundle()
    scorer = Scorer(bundle)

    still, turned = (
        bundle.manifest.decide(scorer.score(parts.press(keyed, Pose(5.0, -4.0, turn), seed=99)).anomaly_score)
        for turn in (0.03, math.pi / 2)
    )
    assert bundle.registration is not None
    assert bundle.registration.is_held
    assert (still.kind, turned.kind) == ("pass", "fail")


def test_damage_is_found_where_it_lies_in_the_press() -> None:
    """The highest score of a press anywhere lies on its damage, in the press's own pixels."""
    scorer = Scorer(registered().bundle())
    pose = Pose(9.0, -7.0, 1.9)
    damaged = parts.press((*parts.BLOCK, (10.0, -2.0, 4.0, 9.0)), pose, seed=99)
    x, y = pose.matrix((parts.SIDE, parts.SIDE)) @ [10 + (parts.SIDE - 1) / 2, -2 + (parts.SIDE - 1) / 2, 1]
    found = scorer.score(damaged)
    row, column = np.unravel_index(int(found.score_map.argmax()), found.score_map.shape)

    assert np.hypot(column - x, row - y) < 12
    assert registered().manifest.decide(found.anomaly_score).kind == "fail"


def test_sound_presses_anywhere_pass_and_golden_frames_hold() -> None:
    """At most one of ten new ones fails, at a promised rate of 5 %. A press without the part is an error, never a pass;
    golden frames lie as the bank does and are scored without a search."""
    scorer, manifest = Scorer(registered().bundle()), registered().manifest
    sound = parts.anywhere(parts.BLOCK, 10, 400)[1]
    kinds = [manifest.decide(scorer.score(rgb).anomaly_score).kind for rgb in sound]

    assert kinds.count("fail") <= 1
    with pytest.raises(PoseNotFound, match="not recognised"):
        scorer.score(parts.press(parts.OTHER, Pose(2.0, 3.0, 0.2)))
    assert scorer.check_golden() < 1e-4


def test_presses_are_held_out_as_the_gateway_shows_them() -> None:
    """What a press does not show is the mean press there and does not count. As the bank learns it, it is other
    presses with seams, which would rule the limit. Damage is put into the press as it lies, and counts where it is
    seen."""
    rendered = nominal(parts.anywhere(parts.BLOCK, 8)[1])
    learnt = learnt_from(parts.BLOCK)
    choice = PoseChoice(learnt)
    unused = Nominal({"rgb": np.zeros((8, 1, 1, 1), np.float32)})
    shown = choice.show(unused, take, rendered)
    at_gateway = [Registrar(learnt.part).register(rgb) for rgb in rendered.frames]
    assert np.array_equal(shown.features["rgb"], np.stack([one.rgb for one in at_gateway]))
    assert shown.seen is not None
    assert np.array_equal(shown.seen, np.stack([one.seen for one in at_gateway]))
    assert not shown.seen.all()

    masks = np.zeros(rendered.frames.shape[:3], np.bool_)
    masks[:, 60:64, 60:64] = True
    foreign = parts.press(parts.OTHER, Pose(), seed=5)
    frames = np.stack([*rendered.frames[:7], foreign])
    taken = choice.take_shown(take)(rendered.frames)
    assert np.array_equal(taken["rgb"], shown.features["rgb"])
    posed, damaged = choice.show_damage(DamagedPresses(frames, np.arange(8), masks), take)
    assert posed.press.tolist() == list(range(7))
    assert damaged.seen is not None
    assert all((mask <= seen).all() for mask, seen in zip(posed.masks, damaged.seen, strict=True))
    for mask, one in zip(posed.masks, at_gateway, strict=False):
        found = warp(mask.astype(np.float32), one.pose.inverse())
        assert found[61:63, 61:63].min() > 0.5

    still = PoseChoice(None).show(unused, take, rendered)
    assert still.seen is None
    assert still.features is unused.features
    assert PoseChoice(None).take_shown(take) is take


def test_a_scar_under_which_a_station_did_not_judge_raises_no_limit() -> None:
    """Nor does the bank learn it: the places are those of other presses. Elsewhere these presses are learnt."""
    old = registered().bundle().registration
    assert old is not None
    frames = parts.anywhere(parts.BLOCK, 14)[1]
    scarred, places = frames.copy(), np.zeros(frames.shape[:3], np.bool_)
    scarred[:2, 60:68, 50:58] = 255
    places[:2, 48:80, 38:70] = True

    shown, hidden, clean = (
        fitted(nominal(rgb, unjudged=unjudged), "auto", pose=old)
        for rgb, unjudged in ((scarred, None), (scarred, places), (frames, None))
    )

    highest = [one.manifest.threshold.nominal_scores[-1] for one in (shown, hidden, clean)]
    assert highest[0] > 5 * highest[1]
    assert highest[1] < 1.1 * highest[2]
    learnt = keep_pose(old, scarred, places)
    assert max(abs(learnt.frames.astype(int) - keep_pose(old, frames).frames).max(axis=(1, 2, 3))) < 60


def test_the_bank_of_presses_as_they_lie_learns_no_scar_either() -> None:
    """They are judged with it, as a station does; also their rendered copies have none."""
    frames = np.stack([parts.press(parts.BLOCK, seed=k) for k in range(6)])
    scarred, places = frames.copy(), np.zeros(frames.shape[:3], np.bool_)
    scarred[:2, 60:68, 50:58] = 255
    places[:2, 44:84, 34:74] = True
    asked, choice = [], PoseChoice(None)
    presses = nominal(scarred, unjudged=places)

    posed = choice.apply(presses)
    shown = choice.show(
        Nominal({"rgb": posed.frames}), lambda rgb: asked.append(rgb) or {"rgb": rgb}, presses
    )
    bundle = fitted(presses, "never", limit="plain").bundle()

    assert max(abs(posed.frames.astype(int) - frames).max(axis=(1, 2, 3))) < 60
    assert np.array_equal(posed.frames[2:], frames[2:])
    assert np.array_equal(asked[0], scarred)
    assert shown.seen is not None
    assert np.array_equal(~shown.seen, places)
    limit = bundle.manifest.threshold.value
    assert Scorer(bundle).score(scarred[0]).anomaly_score > 2 * limit
    assert Scorer(bundle).score(frames[0]).anomaly_score < limit


def test_the_limit_is_higher_at_a_cut_of_the_gel_wherever_the_part_lies() -> None:
    """Map and score of a press are divided by the limits of the gel where it lay, and a bundle keeps them."""
    part = registered().bundle().registration
    assert part is not None
    limits = np.ones(part.learnt.shape, np.float32)
    limits[80:, :] = 4
    rgb = parts.anywhere(parts.BLOCK, 1, 77)[1][0]
    plain, cut = (Registrar(one).register(rgb) for one in (part, replace(part, gel_limits=limits)))
    score_map = np.random.default_rng(0).uniform(1, 2, part.learnt.shape).astype(np.float32)
    above, below = ((slice(a, b), slice(20, 100)) for a, b in ((20, 70), (90, 110)))
    seen = ~plain.unseen_in_press
    lies, lower = plain.in_press(score_map), cut.in_press(score_map)
    assert lower[above][seen[above]].max() > 1.2
    assert lower[below][seen[below]].max() < 0.7 < lies[below][seen[below]].max()
    assert cut.score(score_map) <= plain.score(score_map)
    with pytest.raises(ValueError, match="at least 1"):
        replace(part, gel_limits=limits - 1)


def head_of_nothing() -> bytes:
    """A head that reads the tap and scores 0 everywhere."""
    graph = Graph("nothing")
    tap = graph.input("layer1", ("n", 3, 16, 16))
    score = graph.op("Mul", graph.op("ReduceMax", tap, graph.ints(1, 2, 3), keepdims=1), graph.scalar(0))
    score = graph.op("ReduceMax", score, graph.ints(3), keepdims=0)
    side = parts.SIDE
    score_map = graph.op("Mul", score, graph.constant(np.ones((side, side), np.float32)))
    graph.output("score_map", score_map, ("n", side, side))
    graph.output("score", graph.op("ReduceMax", score_map, graph.ints(1, 2), keepdims=0), ("n",))
    return graph.serialise()


def test_missing_relief_counts_where_its_peak_is_not_seen() -> None:
    """The whole press lacks it, so its score is that of the whole map, and shows where most is missing of what is seen.
    All of it counts where nothing of it is seen."""
    whole = registered().bundle()
    assert whole.registration is not None
    expected = np.zeros((16, 16))
    expected[0, 0] = 9  # where nothing is learnt
    one, raised = np.ones((1, 1)), upsampling_matrix(16, parts.SIDE, "sampled")
    relief = {
        "relief_free": np.zeros((3, 1, 1)),
        "relief_level": 0.1 * one,
        "relief_weights": np.zeros((1, 3, 1, 1)),
        "relief_middle": np.full(1, 2.0),
        "relief_weakest": 0.1 * one,
        "relief_expected": expected,
        "relief_rows": raised,
        "relief_columns": raised.T,
        "relief_unit": 7 * one,
    }
    head, bank = append(head_of_nothing(), Bank({}), relief, "layer1")
    facts = Facts(**{name: getattr(whole.manifest, name) for name in Facts.model_fields})
    graphs = Graphs(whole.graphs.trunk, head)
    files = bundle_files(facts, graphs, bank, backbone="tiny", registration=whole.registration)
    scorer, rgb = Scorer(Bundle.in_memory(*files)), parts.anywhere(parts.BLOCK, 1, 77)[1][0]

    found = scorer.score(rgb)
    assert found.registered is not None
    in_pose, seen = scorer.score_in_pose(found.registered.rgb), found.registered.seen
    assert in_pose.score_map[~seen].max() > 2 * in_pose.score_map[seen].max()
    assert found.anomaly_score == found.score_map.max() == pytest.approx(in_pose.anomaly_score)
    assert (
        found.registered.score(
            found.registered.show_missing(
                np.zeros(seen.shape, np.float32), np.where(seen, 0, 3).astype(np.float32)
            )
        )
        == 3
    )


def store(part: PartInPose) -> PartInPose:
    """Write a bundle with this part, and read it again."""
    bundle = registered().bundle()
    facts = Facts(**{name: getattr(bundle.manifest, name) for name in Facts.model_fields})
    manifest, files = bundle_files(
        facts, bundle.graphs, Bank(dict(bundle.bank)), backbone="tiny", registration=part
    )
    read = Bundle.in_memory(manifest, files).registration
    assert read is not None
    return read


def test_what_is_stored_is_what_was_learnt() -> None:
    """A bundle read again registers as the fitted one did, and keeps the limits of the gel and the turns to tell."""
    learnt = learnt_from(parts.BLOCK)
    limits = (1 + np.indices(learnt.part.learnt.shape)[0] / 16).astype(np.float32)
    part = replace(learnt.part, gel_limits=limits, nearly=3)
    read = store(part)
    assert (read.gel_limits is not None, read.nearly) == (True, 3)
    for one, other in ((read.gel_limits, limits), (read.template, part.template), (read.learnt, part.learnt)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(in_pose_of(read, parts.anywhere(parts.BLOCK, 8)[1]), learnt.frames)


@pytest.mark.parametrize(
    ("part", "symmetry"),
    [
        (parts.BLOCK, 1),
        pytest.param(parts.KEYED, 1, marks=pytest.mark.lab),
        *(pytest.param(parts.ring(n), n, marks=[pytest.mark.lab] * (n in (3, 6))) for n in (2, 3, 4, 6, 10)),
        (parts.BALL, 0),
    ],
    ids=["block", "keyed", "2", "3", "4", "6", "10", "ball"],
)
def test_how_often_a_part_looks_the_same_in_a_turn(part: parts.Bumps, symmetry: int) -> None:
    """Its turn is then found but for steps of that, for each press, and the bundle says so; a nearly round part keeps
    all of its turn."""
    n = 6 if symmetry > 1 else 8
    poses, learnt = parts.poses(n), learnt_from(part, n)

    assert learnt.part.symmetry == symmetry
    assert store(learnt.part).symmetry == symmetry
    if symmetry:
        apart = np.array(
            [pose.turn_rad - one.pose.turn_rad for pose, one in zip(poses, learnt.registered, strict=True)]
        )
        assert abs(np.exp(1j * symmetry * apart).mean()) > np.cos(min(symmetry * np.radians(5), 1))
        assert all(abs(one.turn_rad or 0) <= np.pi / symmetry for one in learnt.registered)


@pytest.mark.lab
def test_one_asymmetric_damage_among_nominal_presses_of_a_symmetric_part_is_named() -> None:
    """The part keeps its symmetry, and the press stands apart."""
    poses, presses = parts.anywhere(parts.CROSS, 10)
    presses[9] = parts.press((*parts.CROSS, (10.0, 12.0, 4.0, 5.0)), poses[9], seed=10)
    manifest = fitted(nominal(presses), "auto").manifest

    assert "the part looks the same 4 times in a full turn" in manifest.facts["registration"]
    assert any("'press 9' stands apart from the others" in said for said in manifest.provenance.warnings)


def test_a_turn_that_some_presses_do_not_show_is_said() -> None:
    """Two presses without the mark that breaks a symmetry agree as well at its other turns; the others are sure."""
    marked = (*parts.ring(3), (8.0, 12.0, 3.0, 4.0))
    shown, plain = parts.anywhere(marked, 6)[1], parts.anywhere(parts.ring(3), 2, 50)[1]
    sure, doubtful = (learn_pose(rgb, parts.free_gel()) for rgb in (shown, np.concatenate([plain, shown])))

    assert (sure.part.symmetry, sure.part.nearly) == (1, 1)
    assert (doubtful.part.symmetry, doubtful.part.nearly) == (1, 3)
    said = PoseChoice(doubtful).find_warnings([*"abcdefgh"])
    assert (
        "turn of presses is not sure: 2 of 8 presses ('a', 'b') agree nearly as well turned by 120" in said[0]
    )
    assert not PoseChoice(sure).find_warnings([""] * 6)


def test_a_press_in_which_the_part_is_not_recognised_is_named() -> None:
    """A gateway rejects it, and so the next one like it."""
    frames = np.concatenate([parts.anywhere(parts.BLOCK, 8)[1], parts.free_gel()[None]])
    choice = PoseChoice(learn_pose(frames, parts.free_gel()))
    said, *_ = choice.find_warnings([*"abcdefgh", "empty"])
    after, *_ = choice.find_warnings([*"abcdefgh", "empty"], ["the dots of a marker gel in 1 of 9 presses"])
    assert (
        "the part is not recognised in 1 of 9 presses ('empty'): a gateway rejects such presses; press"
        in said
    )
    assert "a gateway rejects such presses; mend first what is said before of presses; else press" in after


def test_one_damage_of_a_symmetric_part_fails_at_each_of_its_turns() -> None:
    """A bump too many or too few lies at one of four places that look the same: no turn hides it."""
    symmetric = fitted(nominal(parts.anywhere(parts.ring(4), 6)[1]), "always")
    scorer = Scorer(symmetric.bundle())
    assert scorer.bundle.registration is not None
    assert scorer.bundle.registration.symmetry == 4
    for damaged in ((*parts.ring(4), (10.0, -2.0, 4.0, 9.0)), parts.ring(4)[1:]):
        for turn in range(4):
            rgb = parts.press(damaged, Pose(4.0, -3.0, 0.3 + turn * np.pi / 2), seed=90 + turn)
            assert symmetric.manifest.decide(scorer.score(rgb).anomaly_score).kind == "fail"


@pytest.mark.parametrize(
    ("ball", "first", "after"),
    [("6.310mm", 4, 20), pytest.param("6.310mm", 0, 24, marks=pytest.mark.lab), ("9.500mm", 0, 12)],
)
def test_a_real_ball_has_no_turn(real_tactile: Path, ball: str, first: int, after: int) -> None:
    """Its light differs over the gel, which looks like turns: small ones by the mirror image of its colours, and others
    on which sixteen presses settle."""
    files = sorted(
        (real_tactile / "rpl-cmu__gelslam" / ball).glob("*/gelsight.png"), key=lambda f: int(f.parent.name)
    )
    presses = np.stack([cv2.resize(cv2.imread(str(f)), (224, 224))[..., ::-1] for f in files[first:after]])

    assert learn_pose(presses, np.median(presses, axis=0).astype(np.uint8)).part.symmetry == 0


@pytest.mark.parametrize(("part", "expected"), [("BLOCK", True), ("BALL", False)])
def test_a_round_part_keeps_the_seam_unscored(part: str, expected: bool) -> None:
    """It shows other light at the end of the field; other parts are scored up to there."""
    assert learnt_from(getattr(parts, part)).part.scores_relief_to_end == expected


def test_a_bundle_that_states_no_seam_keeps_that_of_its_fit() -> None:
    """It leaves all of the seam unscored; one whose colours cannot tell slopes apart is corrupt."""
    manifest, files = registered().manifest, dict(registered().files)
    entry = manifest.registration
    assert entry is not None
    older = type(entry).model_validate(entry.model_dump(exclude={"scores_relief_to_end"}))
    assert (entry.scores_relief_to_end, older.scores_relief_to_end) == (True, False)

    wrong = entry.model_copy(update={"colours": ((1.0, 2.0), (1.0, 2.0), (1.0, 2.0))})
    with pytest.raises(BundleCorrupt, match="registration: the colours of the two slopes are the same"):
        Bundle.in_memory(manifest.model_copy(update={"registration": wrong}), files)


def test_the_example_refuses_a_registered_bundle(tmp_path: Path) -> None:
    """It would score presses as they lie."""
    bundle = registered().write(tmp_path / "block")
    assert "this program cannot, fit the bundle again with --set register=never" in refuse_by_example(bundle)


def test_presses_without_relief_cannot_be_registered() -> None:
    flat = np.stack([parts.press((), seed=k) for k in range(3)])
    with pytest.raises(FitError, match="registered"):
        learn_pose(flat, parts.free_gel())


@pytest.mark.parametrize(
    ("presses", "sentence"),
    [
        (
            nominal(parts.anywhere(parts.BLOCK, 8)[1], no_contact=None),
            "needs a picture of the free gel; give one with --no-contact",
        ),
        (nominal(parts.anywhere(parts.BLOCK, 4)[1]), "at least 6 presses, found 4"),
    ],
)
def test_registration_that_is_asked_for_in_vain_is_refused(presses: NominalPresses, sentence: str) -> None:
    """Without the free gel, of too few to hold one out; optional, there is none."""
    with pytest.raises(FitError, match=sentence):
        fitted(presses, "always")
    assert fitted(presses, "auto").manifest.registration is None
