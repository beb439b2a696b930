"""A press that another bundle has just scored, scored by that one's pose and features: as it would be alone."""

import dataclasses
from collections.abc import Callable
from unittest.mock import Mock

import numpy as np
import pytest
import tiny
import turned_parts as parts
from numpy.typing import NDArray
from registered_bundle import fitted, nominal, registered

from edge.core.errors import NotScorable
from edge.core.registration.pose import Registered
from edge.model.bundle import Bundle
from edge.model.scorer import Scored, Scorer

Rgb = NDArray[np.uint8]


def plain(value: float = 0.5) -> Bundle:
    return Bundle.in_memory(*tiny.tiny_files(bank=tiny.tiny_bank(value)))


def alone(scorer: Scorer, rgb: Rgb) -> Scored:
    return Scorer(scorer.bundle).score(rgb)


def trunk_runs(scorer: Scorer) -> Callable[[], int]:
    """Count the runs of its trunk from now on."""
    scorer._pipe._trunk = Mock(wraps=scorer._pipe._trunk)
    return lambda: scorer._pipe._trunk.run_with_iobinding.call_count


def test_the_features_of_the_other_are_taken() -> None:
    """Bit for bit as alone, and its own trunk does not run."""
    rgb = tiny.presses(1)[0]
    other, scorer = Scorer(plain()), Scorer(plain(0.4))
    runs = trunk_runs(scorer)
    for _ in range(2):
        registered_by = other.score(rgb).registered
        found = scorer.score_beside(other, rgb, registered_by)
        np.testing.assert_array_equal(found.score_map, alone(scorer, rgb).score_map)
        assert found.anomaly_score == alone(scorer, rgb).anomaly_score != other.score(rgb).anomaly_score
    assert runs() == 0


def test_what_is_prepared_is_not_prepared_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A press is brought to another light after its dots are filled, so filling again would change it."""
    prepared = tiny.presses(1)[0]
    other, scorer = Scorer(plain()), Scorer(plain(0.4))
    expected = alone(scorer, prepared).anomaly_score
    monkeypatch.setattr(Bundle, "prepare", prepare := Mock())
    other.score_prepared(prepared)

    assert scorer.score_beside(other, prepared, None).anomaly_score == expected
    assert not prepare.called


@pytest.mark.parametrize("between", ["another frame", "a batch", "nothing at all", "a fault"])
def test_features_of_another_frame_are_not_taken(between: str) -> None:
    """As after a golden frame, and where the trunk has failed."""
    rgb, another = tiny.presses(2)
    other, scorer = Scorer(plain()), Scorer(plain(0.4))
    if between != "nothing at all":
        other.score(rgb)
    if between == "another frame":
        other.score(another)
    elif between == "a batch":
        other.score_batch(np.stack([rgb, another]))
    elif between == "a fault":
        other._pipe._trunk = Mock()
        other._pipe._trunk.run_with_iobinding.side_effect = RuntimeError("no room")
        with pytest.raises(NotScorable):
            other.score(rgb)

    found = scorer.score_beside(other, rgb, None)

    assert found.anomaly_score == alone(scorer, rgb).anomaly_score


def test_where_the_two_would_compute_others_it_is_scored_alone() -> None:
    """Here the other one has registration."""
    press = parts.anywhere(parts.BLOCK, 20)[1][3]
    other, scorer = (
        Scorer(registered().bundle()),
        Scorer(fitted(nominal(parts.anywhere(parts.BLOCK, 8)[1])).bundle()),
    )
    prepared = scorer.bundle.prepare(press)
    found = scorer.score_beside(other, prepared, other.score(press).registered)

    assert found.anomaly_score == alone(scorer, press).anomaly_score
    assert found.registered is None


def test_the_pose_of_the_other_is_taken_where_it_is_sought_alike() -> None:
    press = parts.anywhere(parts.BLOCK, 20)[1][3]
    other, scorer = Scorer(registered().bundle()), Scorer(registered().bundle())
    scorer._registrar = Mock()
    runs, pose = trunk_runs(scorer), other.score(press).registered
    assert isinstance(pose, Registered)

    found = scorer.score_beside(other, press, pose)

    expected = other.score(press)
    assert found.anomaly_score == expected.anomaly_score
    assert found.registered is not None
    assert found.registered.pose == pose.pose
    np.testing.assert_array_equal(found.score_map, expected.score_map)
    assert runs() == 0
    assert not scorer._registrar.register.called


def test_a_bundle_that_was_learnt_in_the_same_pose_takes_pose_and_features() -> None:
    """With its own limits of the gel: as alone, and without a run of its trunk."""
    old = registered().bundle()
    presses = parts.anywhere(parts.BLOCK, 20)[1]
    assert old.registration is not None
    kept = dataclasses.replace(old.registration, gel_limits=None)
    new = fitted(nominal(presses[:14]), "auto", pose=kept).bundle()
    assert new.registration is not None
    limits = np.full(new.manifest.frame, 1.5, np.float32)
    new = dataclasses.replace(new, registration=dataclasses.replace(new.registration, gel_limits=limits))
    other, scorer = Scorer(old), Scorer(new)
    runs = trunk_runs(scorer)

    found = scorer.score_beside(other, presses[17], other.score(presses[17]).registered)

    expected = alone(scorer, presses[17])
    assert runs() == 0
    assert found.anomaly_score == expected.anomaly_score
    np.testing.assert_array_equal(found.score_map, expected.score_map)


def test_a_copy_scores_as_its_original_and_shares_the_trunk() -> None:
    rgb = tiny.presses(1)[0]
    scorer = Scorer(plain())
    copy = scorer.copy()
    slim = dataclasses.replace(scorer.bundle, graphs=dataclasses.replace(scorer.bundle.graphs, trunk=None))

    assert copy.score(rgb).anomaly_score == scorer.score(rgb).anomaly_score
    assert copy._trunk is scorer._trunk
    assert Scorer(slim, 1, scorer._trunks).copy()._trunk is scorer._trunk
