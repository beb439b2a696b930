"""Rendered copies of few presses: what they show, when a bank learns them, and the threshold that they allow."""

import numpy as np
import pytest
import tiny
import turned_parts as parts
from registered_bundle import PROFILE, fitted, nominal

from calibration.fitting.limits.held_out import Learner
from calibration.fitting.presses.augmentation import (
    EACH,
    MOST,
    Augment,
    Copies,
    plan_copies,
    render_copies,
)
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.detector import Features, Mode, Nominal
from edge.core.errors import FitError
from edge.core.registration.pose import Pose
from edge.model.manifest_facts import promise
from edge.model.scorer import Scorer

U8 = np.typing.NDArray[np.uint8]


def few(count: int, **changes: object) -> NominalPresses:
    """Presses of one part that lie nearly at one place."""
    return nominal(parts.anywhere(parts.BLOCK, count, shift_px=2.0, turn_rad=0.01)[1], **changes)


def copies(presses: NominalPresses, each: int = 4, seed: int = 0) -> U8:
    return render_copies(presses, each, PROFILE.pixels_per_mm, np.random.default_rng(seed))[0]


def test_a_copy_shows_the_part_elsewhere() -> None:
    """Every copy differs from its press and from the other copies, and the same seed gives the same copies."""
    presses = few(2)
    found, of = render_copies(presses, 4, PROFILE.pixels_per_mm, np.random.default_rng(0))

    assert found.shape == (8, parts.SIDE, parts.SIDE, 3)
    assert of.tolist() == [0] * 4 + [1] * 4
    assert len({rgb.tobytes() for rgb in (*found, *presses.frames)}) == 10
    np.testing.assert_array_equal(found, copies(presses))


def test_what_the_free_gel_shows_stays_where_it_is() -> None:
    """A speck of the gel lies at one place in every copy, where the part moves."""
    free = parts.free_gel().copy()
    free[20:24, 100:104] = 20
    press = parts.press(parts.BLOCK, Pose(), noise=0.0).copy()
    press[20:24, 100:104] = 20
    found = copies(NominalPresses(press[None], ("",), no_contact=free[None]), 8).astype(np.float64)

    ratio = found[:, 20:24, 100:104].mean(axis=(1, 2, 3)) / found[:, 20:24, 90:98].mean(axis=(1, 2, 3))
    assert ratio.max() < 0.3


def test_a_press_that_adds_nothing_is_copied_as_the_free_gel_in_other_light() -> None:
    """Nothing is moved there: every pixel is brighter or darker by one share, within rounding."""
    free = parts.free_gel()
    found = copies(NominalPresses(free[None], ("",), no_contact=free[None]), 6).astype(np.float64)
    gains = found.mean(axis=(1, 2, 3)) / free.mean()

    np.testing.assert_allclose(found, free * gains[:, None, None, None], atol=1.5)
    assert np.ptp(gains) > 0.01


@pytest.mark.parametrize(
    ("augment", "count", "method", "mode", "each"),
    [
        ("auto", 1, "padim", "corrected", EACH),
        ("auto", 8, "padim", "corrected", MOST // 8),
        ("auto", 9, "padim", "corrected", 0),
        ("auto", 2, "padim", "paper", 0),
        ("auto", 3, "subspace", "corrected", MOST // 3),
        ("auto", 4, "subspace", "corrected", 0),
        ("auto", 4, "patchcore", "corrected", 0),
        ("never", 1, "padim", "corrected", 0),
        ("always", 2, "padim", "paper", EACH),
        ("always", 4, "subspace", "corrected", MOST // 4),
        ("always", 16, "padim", "corrected", MOST // 16),
        ("always", 2 * MOST, "padim", "corrected", 1),
    ],
)
def test_copies_that_a_bank_learns(augment: Augment, count: int, method: str, mode: Mode, each: int) -> None:
    """`auto` adds them where they pay: few presses, no published settings, methods that gain or a threshold."""
    presses = NominalPresses(
        np.zeros((count, 4, 4, 3), np.uint8), ("",) * count, no_contact=np.zeros((1, 4, 4, 3), np.uint8)
    )
    assert plan_copies(augment, presses, method, mode).each == each


@pytest.mark.parametrize(
    ("changes", "is_registered", "reason"),
    [
        ({"no_contact": None}, False, "they need a picture of the free gel; give one with --no-contact"),
        ({}, True, "the presses are registered, and lie in one pose already"),
    ],
)
def test_copies_that_cannot_be_had(changes: dict[str, object], is_registered: bool, reason: str) -> None:
    """A sentence for the manifest where they are optional, an error where they are asked for."""
    presses = few(2, **changes)

    found = plan_copies("auto", presses, "padim", "corrected", is_registered)
    assert found.each == 0
    assert found.facts["augmentation"]["why"].startswith(f"no copies are added: {reason}")
    with pytest.raises(FitError, match="no copies of the presses can be added"):
        plan_copies("always", presses, "padim", "corrected", is_registered)


def test_a_press_that_is_held_out_takes_its_copies_along() -> None:
    """The bank without press 1 is the mean of presses 0 and 2 and of their copies, worked by hand."""

    def features(values: list[float]) -> Features:
        return {
            "layer1": np.stack([np.full((3, 4, 4), v, np.float32) for v in values]),
            "layer2": np.stack([np.full((3, 2, 2), v, np.float32) for v in values]),
        }

    of = Copies(features([2.0, 50.0, 4.0]), np.array([0, 1, 2]))
    learner = Learner(tiny.TINY, tiny.tiny_grid(), tiny.TinyParameters(), 0, 1, of)
    presses = Nominal(features([0.0, 100.0, 6.0]))

    without = learner.bank_without(presses, np.array([1]))
    assert without.arrays["mean"].mean() == pytest.approx((0 + 2 + 4 + 6) / 4)
    assert learner.bank(presses).arrays["mean"].mean() == pytest.approx((0 + 2 + 4 + 6 + 50 + 100) / 6)


def test_one_press_makes_a_bundle_that_promises_nothing() -> None:
    """The manifest says how the bank was made, where the threshold is from, and that no rate is promised. Another press
    of the part passes, and the same with a dark square fails."""
    found = fitted(few(1), augment="auto")
    manifest, scorer = found.manifest, Scorer(found.bundle())
    sound = parts.anywhere(parts.BLOCK, 1, 77, shift_px=2.0, turn_rad=0.01)[1][0]
    damaged = sound.copy()
    damaged[40:64, 40:64] = 20

    assert "the bank is of 1 press and 32 rendered copies of it" in manifest.facts["augmentation"]["why"]
    assert manifest.threshold.nominal_scores == ()
    assert "highest score of 32 copies of the one press" in manifest.threshold.method
    assert promise(manifest.threshold).startswith("no rate is promised: the threshold is 1.")
    said = "not proven: 1 press promises no false-alarm rate of other pieces, whose sound presses may all fail; 19 "
    assert any(warning.startswith(said) for warning in manifest.provenance.warnings)
    assert manifest.facts["limit"]["why"].startswith("of fewer than 4 presses nothing can be held out")
    kinds = [manifest.decide(scorer.score(rgb).anomaly_score).kind for rgb in (sound, damaged)]
    assert kinds == ["pass", "fail"]


@pytest.mark.parametrize("count", [2, 3])
def test_two_or_three_presses_promise_nothing_of_others(count: int) -> None:
    """Each is scored by a bank of the others and their copies; so few show no outlier among them."""
    manifest = fitted(few(count), augment="auto").manifest
    limit = manifest.threshold

    assert limit.n == count
    assert not any("stands apart" in warning for warning in manifest.provenance.warnings)
    assert limit.alpha_floor == 1
    assert promise(limit).endswith("of other pieces nothing is promised, their sound presses may all fail")
    said = f"not proven: {count} presses promise no false-alarm rate of other pieces"
    unproven = [warning for warning in manifest.provenance.warnings if warning.startswith("not proven: ")]
    assert list(manifest.provenance.warnings[: len(unproven)]) == unproven
    assert any(warning.startswith(said) for warning in unproven)


@pytest.mark.parametrize(
    ("presses", "changes", "sentence"),
    [
        (few(3), {"augment": "never"}, "3 nominal presses give no threshold"),
        (few(1, no_contact=None), {}, "1 nominal press gives no threshold.*need a picture of the free gel"),
        (nominal(np.repeat(few(1).frames, 2, axis=0)), {}, "all 2 presses are one picture"),
        (nominal(few(1).frames[:0]), {}, "give at least 4, or 1 with a picture of the free gel"),
        (
            nominal(parts.anywhere(parts.BLOCK, 6)[1]),
            {"augment": "always", "register": "always"},
            "the presses are registered",
        ),
    ],
)
def test_what_copies_cannot_help(presses: NominalPresses, changes: dict[str, object], sentence: str) -> None:
    """Few presses without copies, one press twice, none at all, and copies of presses that lie in one pose already."""
    with pytest.raises(FitError, match=sentence):
        fitted(presses, **{"augment": "auto", **changes})


def test_many_presses_fit_as_they_always_did() -> None:
    """With more than eight presses `auto` changes no byte of bank, graphs and golden frames."""
    presses = few(9)
    with_auto, without = (fitted(presses, augment=augment).files for augment in ("auto", "never"))
    assert {**with_auto, "manifest.json": b""} == {**without, "manifest.json": b""}
