"""The checks of a fit's result: what is not proven, and outliers among the presses."""

import cv2
import numpy as np
import pytest
import turned_parts as parts
from registered_bundle import fitted, nominal

from calibration.fitting.limits.limit_choice import DamageFound
from calibration.fitting.self_check import apart_warnings, standing_apart, unproven_warnings


def scores(n: int, *high: tuple[int, float]) -> np.ndarray:
    """n scores between 9 and 11, but for those that are given."""
    found = np.random.default_rng(n).uniform(9, 11, n)
    for number, score in high:
        found[number] = score
    return found


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        *((scores(n, (3, 30)), [3]) for n in (8, 19, 24, 60)),
        (scores(24, (5, 28), (7, 30)), [7, 5]),
        (scores(24, *((k, 30) for k in range(4))), []),
        (np.full(12, 3.0), []),
    ],
)
def test_a_press_far_above_all_others_stands_apart(given: np.ndarray, expected: list[int]) -> None:
    """Two do not hide each other; a group of four is another way to look; copies of one press are all alike."""
    assert standing_apart(given) == expected


@pytest.mark.parametrize("draw", ["normal", "exponential", "lognormal"])
def test_sound_presses_seldom_stand_apart(draw: str) -> None:
    """1,000 sets of 24 scores, also with long tails: fewer than one in ten has an outlier."""
    rng = np.random.default_rng(1)
    sets = {
        "normal": rng.normal,
        "exponential": rng.exponential,
        "lognormal": lambda size: rng.lognormal(0, 0.5, size),
    }
    assert np.mean([bool(standing_apart(drawn)) for drawn in sets[draw](size=(1000, 24))]) < 0.1


def test_the_warning_names_the_press_and_the_way_out() -> None:
    """With its score and the highest of the others."""
    high = np.linspace(9, 11, 20)
    high[4] = 90
    (said,) = apart_warnings(high, [f"good/{k}.png" for k in range(20)])
    assert "press 'good/4.png' stands apart" in said
    assert "90 where they reach 11" in said
    assert "--leave-out 'good/4.png'" in said


@pytest.mark.parametrize(
    ("separated", "found", "said"),
    [
        (None, None, []),
        (0.84, DamageFound(11, 48), []),
        (0.51, DamageFound(20, 48), ["0.51 is separated from sound presses, as by chance"]),
        (
            None,
            DamageFound(1, 48, "dent of 0.1 mm: 1 of 6; with --alpha 0.2 9 would fail"),
            [
                "finds 1 of 48 small pieces of damage rendered into its own presses (dent of 0.1 mm: 1 of 6; with"
            ],
        ),
        (0.51, DamageFound(0, 48), ["0.51 is separated", "finds 0 of 48"]),
    ],
)
def test_evidence_that_shows_nothing_is_said(
    separated: float | None, found: DamageFound | None, said: list[str]
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
