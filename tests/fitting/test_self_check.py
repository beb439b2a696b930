"""The checks of a fit's result: what is not proven, and outliers among the presses."""

import cv2
import numpy as np
import pytest
import turned_parts as parts
from registered_bundle import fitted, nominal

from calibration.fitting.self_check import apart_warnings, standing_apart, unproven_warnings


@pytest.mark.parametrize("n", [8, 19, 24, 60])
def test_a_press_far_above_all_others_stands_apart(n: int) -> None:
    """One of n scores lies twenty times as far above the median as the others do."""
    scores = np.random.default_rng(n).uniform(9, 11, n)
    scores[3] = 30
    assert standing_apart(scores) == [3]


def test_two_presses_do_not_hide_each_other() -> None:
    """Two of 24; each is compared with the other 22."""
    scores = np.random.default_rng(0).uniform(9, 11, 24)
    scores[[5, 7]] = 28, 30
    assert standing_apart(scores) == [7, 5]


@pytest.mark.parametrize("draw", ["normal", "exponential", "lognormal"])
def test_sound_presses_seldom_stand_apart(draw: str) -> None:
    """1,000 sets of 24 scores, also with long tails: fewer than one in ten has an outlier."""
    rng = np.random.default_rng(1)
    sets = {
        "normal": rng.normal,
        "exponential": rng.exponential,
        "lognormal": lambda size: rng.lognormal(0, 0.5, size),
    }
    assert np.mean([bool(standing_apart(scores)) for scores in sets[draw](size=(1000, 24))]) < 0.1


def test_a_group_that_is_another_way_to_look_does_not_stand_apart() -> None:
    """Four of 24 score high: too many to be called strays."""
    scores = np.random.default_rng(0).uniform(9, 11, 24)
    scores[:4] = 30
    assert standing_apart(scores) == []


def test_equal_scores_do_not_stand_apart() -> None:
    """Copies of one press."""
    assert standing_apart(np.full(12, 3.0)) == []


def test_the_warning_names_the_press_and_the_way_out() -> None:
    """With its score and the highest of the others."""
    scores = np.linspace(9, 11, 20)
    scores[4] = 90
    (said,) = apart_warnings(scores, [f"good/{k}.png" for k in range(20)])
    assert "press 'good/4.png' stands apart" in said
    assert "90 where they reach 11" in said
    assert "--leave-out 'good/4.png'" in said


@pytest.mark.parametrize(
    ("separated", "found", "said"),
    [
        (None, None, []),
        (0.84, (11, 48), []),
        (0.51, (20, 48), ["0.51 is separated from sound presses, as by chance"]),
        (None, (1, 48), ["finds 1 of 48 small pieces of damage rendered into its own presses"]),
        (0.51, (0, 48), ["0.51 is separated", "finds 0 of 48"]),
    ],
)
def test_evidence_that_shows_nothing_is_said(
    separated: float | None, found: tuple[int, int] | None, said: list[str]
) -> None:
    """A bundle that does not see its own damage is not proven, chance before few; one with evidence has no warning."""
    warned = unproven_warnings(separated, found)
    assert len(warned) == len(said)
    for sentence, words in zip(warned, said, strict=True):
        assert sentence.startswith("not proven: ")
        assert words in sentence


def test_a_bundle_that_misses_its_own_damage_says_so_first() -> None:
    """Presses with blots larger than the damage rendered into them: 0 of 48 found; without blots no such warning."""
    frames = np.stack([parts.press(parts.BLOCK, seed=k) for k in range(12)])
    rng = np.random.default_rng(0)
    blots = np.stack([cv2.GaussianBlur(rng.normal(0, 540, frames.shape[1:3]), (0, 0), 6) for _ in frames])
    blotted = np.clip(frames + blots[..., None], 0, 255).astype(np.uint8)
    for pictures, is_proven in ((frames, True), (blotted, False)):
        first = fitted(nominal(pictures), "never").manifest.provenance.warnings[0]
        assert ("not proven: the bundle finds 0 of 48" in first) is not is_proven
