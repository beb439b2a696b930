"""A bank is checked with the nominal presses from which it was learnt."""

import numpy as np
import pytest
import tiny

from calibration.fitting.limits.held_out import HeldOut, Learner, ScoredPresses, covering_bank, is_covered
from calibration.fitting.limits.threshold import conformal_threshold
from edge.core.detector import Bank, Nominal

GRID = tiny.tiny_grid()
PRESSES = Nominal(
    {"layer1": np.random.default_rng(0).uniform(0.4, 0.6, (20, *GRID.taps["layer1"])).astype(np.float32)}
)
LEARNER = Learner(tiny.TINY, GRID, tiny.TinyParameters(), 0, 1)


FEW = np.linspace(5, 8, 40)


@pytest.mark.parametrize(
    ("known", "held_out", "limit", "expected"),
    [
        # Presses score at most the same with a bank that has them.
        (0.9 * np.linspace(8, 14, 40), np.linspace(8, 14, 40), 13.8, True),
        # Measured with 40 presses of a part: most of them fail by their own bank.
        (np.linspace(12.9, 15.8, 40), np.linspace(8.4, 13.8, 40), 13.7, False),
        # All score a half higher than unknown, though one stray keeps the threshold above them.
        (np.append(np.linspace(12, 13, 19), 5.0), np.append(np.linspace(8, 9, 19), 40.0), 40.0, False),
        # Three of 40 fail, as InReaCh leaves out strays.
        (np.append(0.9 * FEW[:37], [8.7, 8.8, 8.9]), FEW, 7.9, True),
        # A place that every press has makes most of them fail: the limit of the share is a quarter.
        *((np.where(np.arange(40) < 40 - n, FEW, 8.5), FEW, 7.99, n == 10) for n in (10, 11)),
    ],
)
def test_a_bank_covers_its_presses_where_few_of_them_fail_by_it(
    known: np.ndarray, held_out: np.ndarray, limit: float, expected: bool
) -> None:
    assert is_covered(known, held_out, limit) == expected


def test_the_higher_of_the_two_scores_counts_for_the_threshold() -> None:
    """Three presses score low unknown: by the final bank they score as it does, and no more fail than promised."""
    held_out = LEARNER.score(LEARNER.bank(PRESSES), PRESSES.features, range(20)).scores
    known = held_out.copy()
    held_out[:3] *= 0.5
    covered = covering_bank(LEARNER, PRESSES, lambda roomy: (LEARNER.bank(roomy), shown(held_out)), threshold)
    assert covered.room == 1
    np.testing.assert_array_equal(covered.scores, known)


def test_where_no_threshold_is_wanted_no_press_is_scored() -> None:
    """A given threshold needs no scores, and no check."""
    covered = covering_bank(LEARNER, PRESSES, lambda roomy: (LEARNER.bank(roomy), None), threshold)
    assert (covered.scores, covered.room) == (None, 1)


def test_a_bank_grows_until_it_covers_its_presses() -> None:
    """Twice the usual room is enough here."""
    rooms: list[float] = []

    def learn(roomy: Nominal) -> tuple[Bank, HeldOut]:
        rooms.append(roomy.room)
        bank = LEARNER.bank(roomy)
        spare = {"spare": np.zeros(round(100 * roomy.room), np.float32)}
        return Bank({**bank.arrays, **spare}), shown(np.full(20, 0.01 if roomy.room < 2 else 9.0))

    assert (covering_bank(LEARNER, PRESSES, learn, threshold).room, rooms) == (2, [1, 1.5, 2])


def shown(scores: np.ndarray) -> HeldOut:
    presses = ScoredPresses(np.empty((len(scores), 0, 0), np.float32), scores)
    return HeldOut(presses, presses)


def threshold(scores: np.ndarray) -> float:
    return conformal_threshold(scores, 0.05).value
