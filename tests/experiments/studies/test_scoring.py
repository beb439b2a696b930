"""One cell's work: fit, score, measure."""

from typing import Any

import numpy as np
import pytest
from tiny import TINY, tiny_grid

from calibration.experiments.harness.scoring import MEASURES, TestPresses, fit_and_score
from calibration.fitting.limits.held_out import Learner
from calibration.metrics.summary import recall_at
from edge.core.detector import Nominal
from edge.core.errors import FitError


def maps(values: list[float]) -> dict[str, np.ndarray]:
    """layer1 of presses that are constant but for one cell of the given value."""
    layer = np.full((len(values), 3, 4, 4), 0.5, np.float32)
    layer[:, :, 1, 2] = np.array(values, np.float32)[:, None]
    return {"layer1": layer}


def test_presses(values: list[float], is_defective: list[bool]) -> TestPresses:
    masks = np.zeros((len(values), 32, 32), np.bool_)
    masks[np.array(is_defective), 8:16, 16:24] = True
    return TestPresses(maps(values), np.arange(len(values)), masks, np.array(is_defective))


test_presses.__test__ = False  # type: ignore[attr-defined]


def measure(test: TestPresses, nominal: list[float], seed: int = 0, **overrides: object) -> dict[str, Any]:
    """The row of the tiny detector."""
    learner = Learner(TINY, tiny_grid(), TINY.parameters("corrected", **overrides), seed, 1)
    return fit_and_score(learner, Nominal(maps(nominal)), [test])


def test_a_clear_defect_has_perfect_measures() -> None:
    """The cell of the mask alone differs, so every measure is 1; and the costs are there."""
    test = test_presses([0.5, 0.5, 0.9], [False, False, True])
    found = measure(test, [0.5, 0.5])

    assert {name: found[name] for name in MEASURES} == dict.fromkeys(MEASURES, 1.0)
    assert found["presses"] == 2
    assert (found["test_nominal"], found["test_defective"]) == (2, 1)
    assert found["bank_bytes"] == 3 * 4 * 4 * 4
    assert min(found["fit_s"], found["score_ms"], found["cpu_fit_s"], found["measure_s"]) >= 0


def test_equal_results_have_equal_digests() -> None:
    """The seed does not matter to this detector, the training presses do."""
    test = test_presses([0.5, 0.9], [False, True])
    found = [
        measure(test, nominal, seed)["scores_sha256"]
        for nominal, seed in (([0.5, 0.5], 0), ([0.5, 0.5], 1), ([0.5, 0.6], 0))
    ]

    assert found[0] == found[1] != found[2]


def test_a_parameter_is_changed() -> None:
    """The bank's packing is one of the detector's parameters."""
    test = test_presses([0.5, 0.9], [False, True])
    assert measure(test, [0.5], packing="float16")["bank_bytes"] == 3 * 4 * 4 * 2


def test_a_press_that_the_head_cannot_take_is_a_refusal() -> None:
    """With the detector's name, not an error of the runtime."""
    test = TestPresses(
        {"layer1": np.zeros((2, 3, 5, 5), np.float32)},
        np.arange(2),
        np.zeros((2, 32, 32), np.bool_),
        np.array([False, True]),
    )
    with pytest.raises(FitError, match="the head of tiny does not run on a press"):
        measure(test, [0.5])


@pytest.mark.parametrize(
    ("nominal", "defective", "rate", "share"),
    [
        ([1, 2, 3], [4, 5, 3], 0.01, 2 / 3),
        ([1, 2, 3], [3, 3], 0.01, 0.0),
        ([1, 2, 3], [2.5, 1], 0.34, 0.5),
        (list(range(100)), [98.5, 99.5], 0.01, 1.0),
        (list(range(100)), [97.5, 99.5], 0.01, 0.5),
    ],
)
def test_recall_by_hand(nominal: list[float], defective: list[float], rate: float, share: float) -> None:
    """20 nominal presses allow no false alarm at 1 %, 100 allow one; a tie is not found."""
    scores = np.array([*nominal, *defective], np.float64)
    label = np.arange(len(scores)) >= len(nominal)

    assert recall_at(scores, label, np.ones((1, len(scores))), rate) == pytest.approx(share)
