"""Presses of two parts in one fit are named; those of one part are not, wherever they lie."""

import numpy as np
import pytest
import turned_parts as parts
from registered_bundle import fitted, nominal

from calibration.fitting.pose.registration import learn_pose
from calibration.fitting.pose.two_parts import find_two_parts


def mix(part: parts.Bumps, count: int, other: parts.Bumps, others: int) -> np.ndarray:
    return np.concatenate([parts.anywhere(part, count)[1], parts.anywhere(other, others, seed=50)[1]])


def find(frames: np.ndarray) -> list[str]:
    return find_two_parts(learn_pose(frames, parts.free_gel()), [f"p{k}" for k in range(len(frames))])


def test_a_few_presses_of_another_part_are_named() -> None:
    (said,) = find(mix(parts.BLOCK, 8, parts.OTHER, 3))
    assert "two parts: 3 of 11 presses ('p8', 'p9', 'p10') differ from the others" in said
    assert "--leave-out 'p8'" in said


@pytest.mark.parametrize(
    ("part", "count"),
    [
        (parts.BLOCK, 8),
        (parts.CROSS, 6),
        *(pytest.param(part, 14, marks=pytest.mark.lab) for part in (parts.KEYED, parts.TEETH)),
        (parts.BALL, 6),
    ],
)
def test_presses_of_one_part_are_not(part: parts.Bumps, count: int) -> None:
    assert find(parts.anywhere(part, count)[1]) == []


def test_a_fit_says_so() -> None:
    warnings = fitted(nominal(mix(parts.BLOCK, 8, parts.OTHER, 6)), "auto").manifest.provenance.warnings
    assert any("look like two parts: 6 of 14 presses" in said for said in warnings)
