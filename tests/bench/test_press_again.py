"""One more press of a piece: presses and error rates as a bundle states them, and as new pieces show them."""

from dataclasses import dataclass

import numpy as np
import pytest
import turned_parts as parts
from numpy.typing import NDArray
from registered_bundle import PROFILE, nominal

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge import registry
from edge.core.imaging.region import Region
from edge.core.press_again import Costs, is_asked, second_verdict, unsure
from edge.core.registration.pose import Pose
from edge.core.verdict import Kind
from edge.model.again_facts import again_sentence, plan_for
from edge.model.scorer import Scorer

PIECES, NEW = 60, 300
# Height of the bump on damaged pieces, in the units of the part's own bumps of 4 to 9.
DAMAGE = 0.6
COSTS = Costs(missed=300, false_alarm=300, press=1, defect_rate=0.02)


@dataclass(frozen=True)
class Seen:
    """Of new pieces: the shares that fail by the first press alone and by two, and presses a piece."""

    first: float
    both: float
    presses: float


def config() -> FitConfig:
    return FitConfig(
        part="block",
        position="top",
        profile=PROFILE,
        region=Region(0, 0, parts.SIDE, parts.SIDE),
        detector=registry.detector("padim"),
        trunk=open_trunk(DEFAULT_BACKBONE),
    )


def piece(rng: np.random.Generator, spread: float, damage: float = 0.0) -> parts.Bumps:
    """A part whose bumps differ in height from the next one's, with a bump more where it is damaged."""
    bumps = [(x, y, r, h * float(rng.normal(1, spread))) for x, y, r, h in parts.BLOCK]
    if damage:
        x, y = rng.uniform(-25, 25, 2)
        bumps.append((float(x), float(y), 3.0, damage))
    return bumps


def pressed(rng: np.random.Generator, one: parts.Bumps) -> NDArray[np.uint8]:
    """Put down a little shifted."""
    x, y = rng.normal(0, 0.7, 2)
    return parts.press(one, Pose(float(x), float(y), 0.0), seed=int(rng.integers(2**31)))


def judged(scorer: Scorer, bound: float | None, presses: list[list[NDArray[np.uint8]]]) -> Seen:
    """As the station decides."""
    decide = scorer.bundle.manifest.decide
    first_fails, fails, count = [], [], []
    for one, two in presses:
        first = decide(scorer.score(one).anomaly_score)
        final, used = first, 1
        if is_asked(first, bound) and first.score is not None:
            assert unsure(first).kind is Kind.UNSURE
            second = decide(scorer.score(two).anomaly_score)
            assert second.score is not None
            final, used = second_verdict(second, first.score, None, decide), 2
        first_fails.append(first.kind is not Kind.PASS)
        fails.append(final.kind is not Kind.PASS)
        count.append(used)
    return Seen(float(np.mean(first_fails)), float(np.mean(fails)), float(np.mean(count)))


@pytest.mark.bench
@pytest.mark.parametrize("spread", [0.0, 0.02, 0.05])
def test_stated_and_seen(spread: float) -> None:
    """Prints, for pieces that differ by this share in height, what the bundle states and what new pieces show."""
    rng = np.random.default_rng(11)
    made = [piece(rng, spread) for _ in range(PIECES)]
    frames = np.stack([pressed(rng, one) for one in made for _ in range(2)])
    names = tuple(f"piece {k // 2}" for k in range(2 * PIECES))
    fit = fit_files(nominal(frames, specimens=names), config(), created="2026-01-01")
    found = plan_for(fit.manifest, COSTS)
    scorer = Scorer(fit.bundle(), 2)
    sound = [[pressed(rng, one) for _ in range(2)] for one in (piece(rng, spread) for _ in range(NEW))]
    damaged = [
        [pressed(rng, one) for _ in range(2)] for one in (piece(rng, spread, DAMAGE) for _ in range(NEW))
    ]
    bound = found.bound
    sound_seen, damaged_seen = judged(scorer, bound, sound), judged(scorer, bound, damaged)

    rate = COSTS.defect_rate
    presses = (1 - rate) * sound_seen.presses + rate * damaged_seen.presses
    print(
        f"\npieces that differ by {spread:.0%} in height; stated: {again_sentence(found)}"
        f"\n  seen of {NEW} new sound and {NEW} damaged pieces: {presses:.3f} presses a piece, false alarms "
        f"{sound_seen.first:.2%} -> {sound_seen.both:.2%}, damage missed {1 - damaged_seen.first:.1%} -> "
        f"{1 - damaged_seen.both:.1%}"
    )
