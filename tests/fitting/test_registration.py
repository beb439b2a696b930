"""Whether a fit registers presses, what the bundle keeps of it, and how the bundle then scores."""

import numpy as np
import pytest
import tiny
import turned_parts as parts
from registered_bundle import fitted, nominal, registered

from calibration.fitting.pose.pose_decision import Register
from calibration.fitting.pose.registration import in_pose_of, learn_pose
from edge.core.errors import BundleCorrupt, FitError, PoseNotFound
from edge.core.registration.pose import Pose
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer


def test_parts_anywhere_are_registered_and_the_bundle_says_why() -> None:
    """The spread of the presses and the proof on rendered damage are in the manifest."""
    assert registered().manifest.registration is not None
    why = registered().manifest.facts["registration"]
    assert "presses are registered: in the median presses lie" in why
    assert "of rendered damage" in why


def test_parts_in_a_fixture_are_compared_as_they_lie() -> None:
    """Where presses lie within the tolerated spread nothing is registered, and the manifest says so."""
    still = parts.anywhere(parts.BLOCK, 12, shift_px=2.0, turn_rad=0.01)[1]
    manifest = fitted(nominal(still), "auto").manifest

    assert manifest.registration is None
    assert "compared as they lie" in manifest.facts["registration"]
    assert "0.5 mm are tolerated" in manifest.facts["registration"]


@pytest.mark.parametrize("register", ["auto", "never"])
def test_a_method_that_compares_no_places_needs_no_registration(register: Register) -> None:
    """Neither picture nor number of a registration is stored; the manifest is as it always was."""
    presses = nominal(parts.anywhere(parts.BLOCK, 8)[1])
    found = fitted(presses, register, tiny.TINY)

    assert found.manifest.registration is None
    assert b'"registration"' not in found.files["manifest.json"]


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


def test_sound_presses_anywhere_pass() -> None:
    """At most one of ten new ones fails, at a promised rate of 5 %."""
    scorer, manifest = Scorer(registered().bundle()), registered().manifest
    kinds = [
        manifest.decide(scorer.score(rgb).anomaly_score).kind
        for rgb in parts.anywhere(parts.BLOCK, 10, 400)[1]
    ]

    assert kinds.count("fail") <= 1


def test_a_press_without_the_part_has_no_score() -> None:
    """It is an error with a sentence, never a pass."""
    with pytest.raises(PoseNotFound, match="not recognised"):
        Scorer(registered().bundle()).score(parts.press(parts.OTHER, Pose(2.0, 3.0, 0.2)))


def test_golden_frames_are_scored_without_a_search() -> None:
    """They lie as the bank does, so a difference is one of the graphs."""
    assert Scorer(registered().bundle()).check_golden() < 1e-4


def test_what_is_stored_is_what_was_learnt() -> None:
    """A bundle read again registers as the fitted one did."""
    part = registered().bundle().registration
    presses = parts.anywhere(parts.BLOCK, 20)[1]
    learnt = learn_pose(presses, parts.free_gel())

    assert part is not None
    np.testing.assert_array_equal(part.template, learnt.part.template)
    np.testing.assert_array_equal(part.learnt, learnt.part.learnt)
    np.testing.assert_array_equal(in_pose_of(part, presses), learnt.frames)


def test_a_bundle_that_states_no_seam_keeps_that_of_its_fit() -> None:
    """It leaves all of the seam unscored, as when it was fitted; a new one scores the relief in it."""
    entry = registered().manifest.registration
    assert entry is not None
    older = type(entry).model_validate(entry.model_dump(exclude={"scores_relief_to_end"}))

    assert (entry.scores_relief_to_end, older.scores_relief_to_end) == (True, False)


@pytest.mark.parametrize(("part", "expected"), [("BLOCK", True), ("BALL", False)])
def test_a_round_part_keeps_the_seam_unscored(part: str, expected: bool) -> None:
    """It shows other light at the end of the field; other parts are scored up to there."""
    presses = parts.anywhere(getattr(parts, part), 8)[1]

    assert learn_pose(presses, parts.free_gel()).part.scores_relief_to_end == expected


def test_a_picture_of_another_size_is_refused() -> None:
    """A bundle whose mean press does not fit its region is corrupt."""
    manifest, files = registered().manifest, dict(registered().files)
    entry = manifest.registration
    assert entry is not None
    wrong = entry.model_copy(update={"template": manifest.golden[0].image, "learnt": entry.template})
    wrong = wrong.model_copy(update={"colours": ((1.0, 2.0), (1.0, 2.0), (1.0, 2.0))})

    with pytest.raises(BundleCorrupt, match="registration: the colours of the two slopes are the same"):
        Bundle.in_memory(manifest.model_copy(update={"registration": wrong}), files)


def test_registration_is_asked_for_in_vain_without_the_free_gel() -> None:
    """The message says what to give."""
    with pytest.raises(FitError, match="needs a picture of the free gel; give one with --no-contact"):
        fitted(nominal(parts.anywhere(parts.BLOCK, 8)[1], no_contact=None), "always")


def test_presses_without_a_common_relief_cannot_be_registered() -> None:
    """Presses of the free gel alone: an error where it is asked for, and no registration where it is optional."""
    flat = np.stack([parts.press((), seed=k) for k in range(8)])

    with pytest.raises(FitError, match="registered"):
        fitted(nominal(flat), "always")
    assert fitted(nominal(flat), "auto").manifest.registration is None


def test_too_few_presses_are_not_registered() -> None:
    """Nothing could be held out to prove it."""
    with pytest.raises(FitError, match="at least 6 presses, found 4"):
        fitted(nominal(parts.anywhere(parts.BLOCK, 4)[1]), "always")
