"""A fit learns from its own presses what a smoother object lacks, and refuses none for light or depth."""

from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from pressed_dome import DEPTH_MM, PROFILE, REGION, Bench, dome_bench, dome_presses, pillow

from calibration.fitting import fit
from calibration.fitting.carry import CarryConfig, carry_bundle
from calibration.fitting.damage.conditions import change_presses, dim, relight
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.fit import FitConfig, Fitted, fit_files
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.gel_limits import LimitsChosen, choose_limits
from calibration.fitting.limits.relief_step import (
    USEFUL,
    ReliefChoice,
    choose_relief,
    find_missing,
    finest_tap,
    try_relief,
)
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.trunks import open_trunk
from calibration.simulator.field_of_view import LR
from calibration.simulator.pose import HeightField, sample
from calibration.simulator.renderer import Exposure
from calibration.simulator.reproducible_math import reproducible_opencv
from edge import registry
from edge.clock import SystemClock
from edge.core.arrays import F32
from edge.core.detector import Features, Grid, Nominal
from edge.core.errors import FitError
from edge.core.imaging.frames import CameraFrame
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.manifest_facts import MISSING, choice_sentence
from edge.model.scorer import Scorer

TRUNK = open_trunk("tactile_resnet18", ("layer1",))
LEARNT = 10


def smooth_dome(x_mm: F32, y_mm: F32) -> F32:
    """The dome without its grooves."""
    return np.asarray(np.maximum(-0.06 * (x_mm * x_mm + y_mm * y_mm), -1.0), np.float32)


class Presses:
    """Presses of the dome, of a smoother one, and a lighter press, by the same station."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.learnt = dome_presses(LEARNT)
        numbers = range(LEARNT, LEARNT + 4)
        self.sound = np.stack([self.of(pillow, k) for k in numbers])
        self.smooth = np.stack([self.of(smooth_dome, k) for k in numbers])
        self.lighter = np.stack([self.of(pillow, k, 0.75) for k in numbers])

    def of(self, part: HeightField, number: int, depth: float = 1.0) -> np.ndarray:
        return np.ascontiguousarray(REGION.crop(self.picture(part, number, depth)))

    def picture(self, part: HeightField, number: int, depth: float = 1.0) -> np.ndarray:
        gel, placed = self.bench.gel, self.bench.placed(number)
        imprint = gel.imprint(sample(part, placed, LR), depth * DEPTH_MM * placed.depth_factor)
        return gel.expose(gel.light(gel.surface(imprint)), ("press", number), Exposure())


@pytest.fixture(scope="module")
def presses() -> Presses:
    with reproducible_opencv():
        return Presses(dome_bench())


class Taken:
    """The features of the finest tap."""

    def __init__(self) -> None:
        from edge.model.session import open_session

        self.session = open_session(TRUNK.graph, 1, "trunk")
        self.grid = trunk_grid(self.session, ["layer1"], (REGION.height, REGION.width), PROFILE.pixels_per_mm)

    def __call__(self, frames: np.ndarray) -> Features:
        return extract(self.session, frames, self.grid, lambda fraction: None)


@pytest.fixture(scope="module")
def take() -> Taken:
    return Taken()


def chosen(learnt: NominalPresses, take: Taken) -> ReliefChoice:
    assert learnt.no_contact is not None
    nominal = Nominal(take(learnt.frames), learnt.touched, take(learnt.no_contact))
    changed = change_presses(learnt, PROFILE, REGION, np.random.default_rng(0))
    assert changed is not None
    folds, _ = divide_presses((None,) * len(learnt), 5, np.random.default_rng(0))
    return choose_relief(nominal, changed, take, folds, take.grid, "layer1")


@pytest.fixture(scope="module")
def choice(presses: Presses, take: Taken) -> ReliefChoice:
    return chosen(presses.learnt, take)


def missing(choice: ReliefChoice, take: Taken, frames: np.ndarray) -> np.ndarray:
    assert choice.relief is not None
    return find_missing(choice.relief, take(frames)["layer1"])


def test_an_object_without_grooves_lacks_relief(choice: ReliefChoice, presses: Presses, take: Taken) -> None:
    """Every press of it lies above the limit, though no such object was ever shown."""
    assert (missing(choice, take, presses.smooth) > 1).all()


def test_what_shows_the_grooves_lacks_nothing(choice: ReliefChoice, presses: Presses, take: Taken) -> None:
    """Learnt presses are far below the limit, and so are others; three quarters of the depth, other colours and four
    fifths of the exposure are no other object. The free gel lacks everything."""
    rng = np.random.default_rng(3)
    assert presses.learnt.no_contact is not None
    for limit, frames in (
        (0.9, presses.learnt.frames),
        (0.9, presses.sound),
        (1, presses.lighter),
        (1, np.stack([relight(rgb, rng) for rgb in presses.sound])),
        (1, np.stack([dim(rgb, 0.8) for rgb in presses.sound])),
    ):
        assert (missing(choice, take, frames) < limit).all()
    assert (missing(choice, take, presses.learnt.no_contact) > 2).all()


def test_where_nothing_can_be_learnt_nothing_is_checked(presses: Presses, take: Taken) -> None:
    """Of a smooth part little can be missing; where a learnt press shows the free gel no contact is too weak; without
    the free gel no object can be made smoother."""
    with reproducible_opencv():
        smooth = np.stack([presses.of(smooth_dome, k) for k in range(LEARNT)])
    assert presses.learnt.no_contact is not None
    hardly = presses.learnt.frames.copy()
    hardly[0] = presses.learnt.no_contact[0]
    for frames, why in ((smooth, "little can be missing"), (hardly, "a learnt press hardly touches")):
        found = chosen(replace(presses.learnt, frames=frames), take)
        assert found.relief is None
        assert why in found.why
    without = replace(presses.learnt, no_contact=None)
    assert change_presses(without, PROFILE, REGION, np.random.default_rng(0)) is None


def test_the_finest_tap_is_the_one_with_the_most_cells() -> None:
    """Of those that the head reads."""
    grid = Grid((96, 96), {"layer1": (64, 24, 24), "layer2": (128, 12, 12)}, 16.0)
    assert finest_tap(grid, ["layer2", "bank", "layer1"]) == "layer1"
    assert finest_tap(grid, ["layer2", "bank"]) == "layer2"
    assert finest_tap(grid, ["bank"]) is None


def dome_config(**changes: object) -> FitConfig:
    """How a method that knows no smoother object is fitted."""
    detector = registry.detector("subspace")
    trunk = open_trunk("tactile_resnet18", detector.taps(detector.parameters("corrected")))
    whole = FitConfig("dome", "top", PROFILE, REGION, detector, trunk, threads=1)
    return replace(whole, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def fitted(presses: Presses) -> Fitted:
    return fit_files(presses.learnt, dome_config(), created="")


def test_a_bundle_says_what_it_checks(fitted: Fitted) -> None:
    """The manifest has the reason and the tap, and the arrays are in the bank."""
    facts = fitted.manifest.facts
    assert choice_sentence(facts, MISSING).startswith("checked: ")
    assert facts["missing_relief"]["tap"] == "layer1"
    assert facts["missing_relief"]["found"] >= USEFUL
    assert {"relief_free", "relief_weights", "relief_unit"} <= set(fitted.manifest.bank)


def test_a_bundle_without_a_limit_above_0_says_that_it_checks_nothing(
    presses: Presses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no unit in which missing relief could count."""
    monkeypatch.setattr(LimitsChosen, "highest_limit", 0.0)
    manifest = fit_files(presses.learnt, dome_config(), created="").manifest
    assert "relief_unit" not in manifest.bank
    assert (
        choice_sentence(manifest.facts, MISSING)
        == "not checked: the limit is 0, and only in units of one above 0 it counts"
    )


def test_a_bundle_fails_a_smoother_object_and_passes_the_part(fitted: Fitted, presses: Presses) -> None:
    """Its score is the highest value of its map, which shows where; learnt presses keep their scores."""
    scorer, threshold = Scorer(fitted.bundle(), 1), fitted.manifest.threshold
    for rgb in presses.smooth:
        found = scorer.score(rgb)
        assert found.anomaly_score == pytest.approx(float(found.score_map.max()))
        assert found.anomaly_score > threshold.value
    known = [scorer.score(rgb).anomaly_score for rgb in presses.learnt.frames]
    assert max(known) <= max(threshold.nominal_scores) * (1 + 1e-4)


def test_places_of_the_gel_with_a_higher_limit_hide_no_missing_relief(
    presses: Presses, take: Taken, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is four times as high on all of the gel, and the smoother object fails. What a registered part lacks is
    learnt, and its finds are counted, from presses as the gateway shows them to the bank."""
    learn = Mock(wraps=try_relief)
    monkeypatch.setattr(fit, "try_relief", learn)
    four_times = np.full(presses.learnt.frames.shape[1:3], 4, np.float32)
    monkeypatch.setattr(
        fit, "choose_limits", lambda *given: replace(choose_limits(*given), gel_limits=four_times)
    )
    fitted = fit_files(presses.learnt, dome_config(register="always"), created="")
    scorer, threshold = Scorer(fitted.bundle(), 1), fitted.manifest.threshold
    given, _, nominal, take_changed, *_ = learn.call_args.args
    at_gateway = [scorer.score(rgb).registered for rgb in presses.learnt.frames]
    shown = take(np.stack([one.rgb for one in at_gateway if one is not None]))["layer1"]
    np.testing.assert_array_equal(nominal.features["layer1"], shown)
    np.testing.assert_array_equal(take_changed(given.frames)["layer1"], shown)
    assert min(scorer.score(rgb).anomaly_score for rgb in presses.smooth) > threshold.value
    assert max(scorer.score(rgb).anomaly_score for rgb in presses.learnt.frames) <= threshold.value


def test_a_bundle_that_is_carried_over_fails_as_much_missing_relief(
    fitted: Fitted, presses: Presses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a gel of another tint the limit is higher, and what is missing counts in units of it; what was found on the
    old gel is not said of the new one. Presses that lack relief are refused, also where the limit is high."""
    monkeypatch.setattr("calibration.fitting.carry._check_presses", lambda *_: None)
    bundle, config = fitted.bundle(), CarryConfig("2026-02-01", threads=1)
    grain = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(96, 96, 3)), (0, 0), 12)
    other_gel = 5 * grain / grain.std()
    tinted = [
        np.clip(np.rint(frames + other_gel), 0, 255).astype(np.uint8)
        for frames in (presses.sound, presses.smooth)
    ]
    learnt = replace(presses.learnt.choose(range(4)), frames=tinted[0])
    carried = carry_bundle(bundle, learnt, config)
    scorer, limit = Scorer(carried.bundle(), 1), carried.manifest.threshold.value
    assert limit > 1.2 * bundle.manifest.threshold.value
    assert carried.bundle().bank["relief_unit"] == pytest.approx(limit)
    assert min(scorer.score(rgb).anomaly_score for rgb in tinted[1]) > limit
    assert not {"damage_found", "press_again"} & carried.manifest.facts.keys()
    assert "found" not in carried.manifest.facts["missing_relief"]
    assert "found" not in carried.manifest.facts["limit"]
    assert choice_sentence(carried.manifest.facts, MISSING).startswith("checked: as in the bundle before")
    mixed = np.concatenate([tinted[0][:3], tinted[1][:1]])
    with pytest.raises(FitError, match=f"lack relief that the learnt ones have: {learnt.names[3]};"):
        carry_bundle(bundle, replace(learnt, frames=mixed), config)


def answers(bundle: Bundle, free: np.ndarray, pictures: list[np.ndarray]) -> set[str]:
    """What the gateway says of these presses."""
    inspector = Inspector(Scorer(bundle, 1), SystemClock())
    named = {f"{k}": rgb for k, rgb in enumerate(pictures)}
    touches = gather_presses(named, bundle.profile, bundle.region, no_contact=[free]).touches
    frames = [cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1].tobytes() for rgb in pictures]
    return {
        inspector.inspect(CameraFrame(png, 0, number, is_on_demand=True), touch).word
        for number, (png, touch) in enumerate(zip(frames, touches, strict=True))
    }


def test_the_gateway_fails_a_smoother_object(fitted: Fitted, presses: Presses) -> None:
    """From the frame to the verdict. Its score is higher than the method's own; a sound press has the method's own."""
    free, bundle = presses.bench.free(), fitted.bundle()
    with reproducible_opencv():
        smooth, sound = (
            [presses.picture(part, k) for k in range(LEARNT, LEARNT + 4)] for part in (smooth_dome, pillow)
        )
    assert answers(bundle, free, smooth) == {"fail"}
    assert answers(bundle, free, sound) == {"pass"}
    unchecked = replace(bundle, bank={**bundle.bank, "relief_unit": np.zeros((1, 1), np.float32)})
    both, own = Scorer(bundle, 1), Scorer(unchecked, 1)
    with_check, without = (
        np.mean([scorer.score(rgb).anomaly_score for rgb in presses.smooth]) for scorer in (both, own)
    )
    assert with_check > 1.1 * without
    for rgb in presses.sound:
        assert both.score(rgb).anomaly_score == own.score(rgb).anomaly_score
