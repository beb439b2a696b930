"""What `fit` states for one more press of a piece: scores of pieces pressed twice, and of rendered damage."""

from dataclasses import replace

import numpy as np
import pytest
import turned_parts as parts
from registered_bundle import fitted, nominal

from calibration.fitting.fit import Fitted
from edge.core.press_again import Costs
from edge.model.again_facts import PRESS_AGAIN, again_sentence, plan_for

PRESSES = 16


@pytest.fixture(scope="module")
def fit() -> Fitted:
    """Eight pieces, each pressed twice at one place."""
    frames = np.stack([parts.press(parts.BLOCK, seed=k) for k in range(PRESSES)])
    pieces = tuple(f"piece {k // 2}" for k in range(PRESSES))
    return fitted(nominal(frames, specimens=pieces), "never")


def test_a_fit_states_the_scores_of_its_pieces(fit: Fitted) -> None:
    """Those of the threshold, piece by piece: each was pressed twice."""
    sound = fit.manifest.facts[PRESS_AGAIN]["sound"]

    assert [len(scores) for scores in sound] == [2] * 8
    assert sorted(score for scores in sound for score in scores) == list(
        fit.manifest.threshold.nominal_scores
    )


def test_a_fit_states_the_scores_of_rendered_damage(fit: Fitted) -> None:
    """Three sizes of each kind, in units of the threshold: the largest damage lies above what the smallest does."""
    damaged = fit.manifest.facts[PRESS_AGAIN]["damaged"]
    kinds = {name.partition(" of ")[0] for name in damaged}
    medians = {name: float(np.median(scores)) for name, scores in damaged.items()}

    assert len(damaged) == 3 * len(kinds)
    for kind in kinds:
        ordered = [medians[name] for name in damaged if name.startswith(f"{kind} of ")]
        assert ordered[0] <= ordered[-1]
    assert max(medians.values()) > fit.manifest.threshold.value


def test_a_plan_follows_from_them(fit: Fitted) -> None:
    """Where misses cost nothing, a second press pays; the sentence has presses and both error rates."""
    found = plan_for(fit.manifest, Costs(missed=0, false_alarm=1e6, press=1, defect_rate=0.01))

    assert found.bound is not None
    assert found.false_alarms[1] <= found.false_alarms[0]
    assert "presses a piece, false alarms at most" in again_sentence(found)
    rounded = replace(found, false_alarms=(0.05001, 0.0123))
    assert "false alarms at most 5.1 % -> 1.3 %, rendered" in again_sentence(rounded)


def test_without_a_picture_of_the_free_gel_there_are_none() -> None:
    """Then the station never asks, and says why."""
    frames = np.stack([parts.press(parts.BLOCK, seed=k) for k in range(6)])
    found = fitted(nominal(frames, no_contact=None), "never")

    assert PRESS_AGAIN not in found.manifest.facts
    assert again_sentence(plan_for(found.manifest, Costs(1, 1, 1, 0.1))).startswith(
        "never: the bundle has no scores"
    )


def test_without_scores_or_a_rate_no_press_can_be_planned(fit: Fitted) -> None:
    """A damaged manifest does not end the station; a threshold that was given promises no rate."""
    facts = {**fit.manifest.facts, PRESS_AGAIN: {"sound": "all"}}
    of_one_piece = fit.manifest.threshold.model_copy(update={"alpha_floor": 1.0})
    given = of_one_piece.model_copy(update={"nominal_scores": ()})
    for changes, why in (
        ({"facts": facts}, "cannot be read"),
        ({"threshold": given}, "the threshold was given"),
        ({"threshold": of_one_piece}, "of new pieces"),
    ):
        found = plan_for(fit.manifest.model_copy(update=changes), Costs(1, 1, 1, 0.1))
        assert found.bound is None
        assert why in found.why
