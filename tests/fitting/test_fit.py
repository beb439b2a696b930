"""From presses to a bundle: what is learnt, promised and refused."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import onnx.parser
import pytest
import tiny
from numpy.typing import NDArray
from tiny_fit import config, presses

from calibration.fitting.fit import fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import scatter_warnings
from calibration.fitting.trunks import Trunk
from edge import registry
from edge.core.contact.mask import Touch
from edge.core.detector import Bank, Grid, KeepsMean, Nominal, Progress
from edge.core.errors import BundleCorrupt, FitError
from edge.core.imaging.smoothing import smooth
from edge.model.bundle import Bundle
from edge.model.manifest_facts import promise
from edge.model.scorer import Scorer


def painted(n: int, where: Any, level: Any) -> NominalPresses:
    """n presses, some of their pixels replaced."""
    nominal = presses(n)
    nominal.frames[where] = level
    return nominal


class WatchedDetector(tiny.TinyDetector):
    """Keeps what each of its fits was given."""

    def __init__(self) -> None:
        self.fitted: list[Nominal] = []

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: object, rng: np.random.Generator, progress: Progress
    ) -> Bank:
        self.fitted.append(nominal)
        return super().fit(nominal, grid, parameters, rng, progress)  # type: ignore[arg-type]


def test_the_bank_is_the_mean_of_the_presses() -> None:
    """Worked by hand: the tiny detector's bank is the mean colour of each 8x8 cell over all presses, smoothed."""
    nominal = presses(6)
    smoothed = np.stack([smooth(rgb) for rgb in nominal.frames])
    bank = fit_files(nominal, config(), created="2026-01-01").bundle().bank["mean"]
    cells = smoothed.reshape(6, 4, 8, 4, 8, 3).astype(np.float64).mean(axis=(0, 2, 4)) / 255
    np.testing.assert_allclose(bank, cells.transpose(2, 0, 1), rtol=1e-6)


def test_people_are_shown_what_the_bank_holds() -> None:
    """The nominal presses by their names, or their mean where the method holds a mean and says so."""

    class MeanDetector(tiny.TinyDetector):
        keeps_mean = True

    nominal = presses(6)
    shown = [
        fit_files(nominal, config(detector=detector), created="").bundle().nominal_pictures
        for detector in (tiny.TINY, MeanDetector())
    ]

    assert [one and one.names for one in shown] == [
        tuple(f"nominal press {name}" for name in nominal.names),
        ("the mean of 6 nominal presses",),
    ]
    assert all(isinstance(registry.detector(name), KeepsMean) for name in ("padim", "fapm", "subspace"))
    assert not any(
        isinstance(registry.detector(name), KeepsMean) for name in ("spade", "patchcore", "inreach")
    )


def test_a_marked_press_fails_and_a_new_nominal_one_passes() -> None:
    """The bundle does its job: threshold from nominal presses alone, a painted square is far above it."""
    bundle = fit_files(presses(40), config(), created="2026-01-01").bundle()
    limit, scorer = bundle.manifest.threshold, Scorer(bundle)
    fresh = tiny.presses(50, seed=7)
    marked = fresh[0].copy()
    marked[4:12, 4:12] = 0
    alarms = sum(scorer.score(rgb).anomaly_score > limit.value for rgb in fresh)
    assert alarms <= 8  # 5 % of 50 expected; more than 8 happens once in 500
    assert scorer.score(marked).anomaly_score > 2 * limit.value


def test_scores_for_the_threshold_are_out_of_fold() -> None:
    """A press unlike all others scores high, because the bank that scored it is without it."""
    frames = np.full((10, 32, 32, 3), 100, np.uint8)
    frames[4] = 200
    manifest = fit_files(NominalPresses(frames, ("",) * 10), config(), created="").manifest
    assert manifest.threshold.nominal_scores[-1] == pytest.approx(np.sqrt(3) * 100 / 255, rel=1e-4)


def test_a_specimen_is_held_out_whole() -> None:
    """Two presses of one odd specimen both score high; as two specimens, each is in the bank of the other."""
    frames = np.full((10, 32, 32, 3), 100, np.uint8)
    frames[4:6] = 200
    stranger = np.sqrt(3) * 100 / 255
    grouped = NominalPresses(frames, ("",) * 10, tuple("aabbooccdd"))
    scores = fit_files(grouped, config(), created="").manifest.threshold.nominal_scores
    assert scores[-2:] == pytest.approx((stranger, stranger), rel=1e-4)
    apart = fit_files(NominalPresses(frames, ("",) * 10), config(seed=3), created="").manifest
    assert apart.threshold.nominal_scores[-1] < 0.9 * stranger


def test_presses_of_few_pieces_promise_what_pieces_do() -> None:
    """24 presses of 6 pieces: 1/7 at best, in the manifest and in words. A bundle of an older version keeps its range,
    in the words of its version."""
    limit = fit_files(presses(24, specimens=tuple("abcdef" * 4)), config(), created="").manifest.threshold
    assert (limit.n, limit.pieces) == (24, 6)
    assert limit.alpha_floor == pytest.approx(1 / 7)
    assert promise(limit) == (
        "24 presses of 6 pieces: at best 14 % (1 in 7), not 5 %, of sound presses of new pieces fail, "
        "on average over bundles; with this bundle at most 32 % of new pieces and 9.2 % of presses of these pieces, "
        "90 % sure"
    )
    older = limit.model_copy(update={"by_press": None})
    assert promise(older).endswith("on average over bundles; of this bundle alone 0 % to 39 % (95 %)")
    assert promise(older.model_copy(update={"rate_range": None})).endswith("on average over bundles")


def test_presses_of_unknown_pieces_are_said_to_count_as_pieces() -> None:
    """All may be of one piece: what is promised rests on it that they are not."""
    limit = fit_files(presses(19), config(), created="").manifest.threshold
    assert promise(limit).startswith("19 presses, counted as 19 pieces: at most 5 % of sound presses fail, ")
    assert promise(limit.model_copy(update={"pieces": None})).startswith("19 presses: at most 5 %")


def frames_of(*levels: int) -> NDArray[np.uint8]:
    """Twelve frames of each of these pieces, whose grey differs from piece to piece more than from press to press."""
    rng = np.random.default_rng(1)
    pieces = [np.clip(rng.normal(level, 1, (12, 32, 32, 3)), 0, 255) for level in levels]
    return np.concatenate(pieces).astype(np.uint8)


def test_sound_presses_of_a_third_piece_pass() -> None:
    """Two pieces are held out in turn, so the limit is as wide as pieces differ. Held out press by press, 12 of 12
    presses of the third fail. Nothing is promised of it."""
    nominal = NominalPresses(frames_of(100, 120), ("",) * 24, tuple("a" * 12 + "b" * 12))
    bundle = fit_files(nominal, config(), created="").bundle()
    scores = [one.anomaly_score for one in Scorer(bundle).score_batch(frames_of(125))]
    assert max(scores) < bundle.manifest.threshold.value
    assert bundle.manifest.threshold.alpha_floor == 1


@pytest.mark.parametrize(
    ("specimens", "counted", "whose"),
    [("a" * 12, "1 piece", "this piece"), ("a" * 10 + "bc", "3 pieces", "these pieces")],
)
def test_pieces_not_held_out_promise_nothing_of_others(specimens: str, counted: str, whose: str) -> None:
    """One piece, and one that is nearly all presses: no rate by piece, in the manifest and in words."""
    limit = fit_files(presses(12, specimens=tuple(specimens)), config(), created="").manifest.threshold
    assert (limit.alpha_floor, limit.rate_range, limit.by_piece) == (1, None, None)
    assert promise(limit) == (
        f"12 presses of {counted}: at most 18 % of presses of {whose} fail, 90 % sure; of other pieces nothing is "
        "promised, their sound presses may all fail"
    )


CUT = "recording a ends within a line of its index: what came later is not learnt"


@pytest.mark.parametrize(
    ("nominal", "said"),
    [
        (presses(24), None),
        (presses(19), None),  # promise 0.05 exactly
        (presses(24, faults=(CUT,)), CUT),
        (painted(24, np.s_[7, 4:12, 4:12], 60), "'press 7' stands apart"),
        (presses(24, specimens=("a",) * 24), "of 1 piece: the limit is for presses of this alone"),
        (presses(24, specimens=tuple("abcdef" * 4)), "24 presses of 6 pieces promise"),
        (presses(4), "1/5 at best; 19 presses are needed"),
        (painted(24, 7, presses(1).frames[0]), "are exact copies of another"),
    ],
)
def test_what_is_doubtful_of_the_presses_is_a_warning(nominal: NominalPresses, said: str | None) -> None:
    """The bundle has it; sound presses that are enough have none."""
    warnings = fit_files(nominal, config(limit="plain"), created="").manifest.provenance.warnings
    doubts = [warning for warning in warnings if not warning.startswith("'layer1' differs")]
    assert any(said in doubt for doubt in doubts) if said else doubts == []


class Forgetful(tiny.TinyDetector):
    """Its bank is right where it has more than `least` times the usual room, or less than the usual."""

    def __init__(self, least: float) -> None:
        self.least = least

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: object, rng: np.random.Generator, progress: Progress
    ) -> Bank:
        bank = super().fit(nominal, grid, parameters, rng, progress)  # type: ignore[arg-type]
        mean = bank.arrays["mean"].copy()
        if nominal.presses == 20 and nominal.room < self.least:
            mean[:, 1, 1] = 0.9  # a place that every press has
        spare = np.zeros(round(100 * nominal.room), np.float32)
        return Bank({"mean": mean, "spare": spare}, bank.packing, bank.facts)


def test_a_bank_that_lacks_a_place_gets_more_room() -> None:
    """Twice the usual room is enough here, with a warning in the bundle; its own presses pass."""
    nominal = presses(20)
    fitted = fit_files(nominal, config(detector=Forgetful(2.0)), created="")
    assert any("2 times its usual room" in warning for warning in fitted.manifest.provenance.warnings)
    scored = Scorer(fitted.bundle()).score_batch(nominal.frames)
    assert sum(s.anomaly_score > fitted.manifest.threshold.value for s in scored) <= 1


def test_copies_of_one_press_give_no_threshold() -> None:
    """Of one picture n times no threshold can be learnt: refused, unless one is given."""
    frames = np.repeat(tiny.presses(1), 5, axis=0)
    with pytest.raises(FitError, match=r"all 5 presses are one picture.*state a threshold"):
        fit_files(NominalPresses(frames, ("",) * 5), config(), created="")
    manifest = fit_files(NominalPresses(frames, ("",) * 5), config(threshold=0.25), created="").manifest
    assert "4 of 5 presses ('', '', '', '') are exact copies" in manifest.provenance.warnings[0]
    assert (manifest.threshold.value, manifest.threshold.method) == (0.25, "given by hand")


class Deep(tiny.TinyDetector):
    def taps(self, parameters: tiny.TinyParameters) -> tuple[str, ...]:
        return ("layer1", "layer4")


BROKEN = """
    < ir_version: 8, opset_import: ["" : 17] >
    broken (uint8[n, h, w, 3] frames) => (float[n, 3, h8, w8] layer1)
    {
        pixels = Cast <to = 1> (frames)
        zero = Sub (pixels, pixels)
        odd = Div (pixels, zero)
        planes = Transpose <perm = [0, 3, 1, 2]> (odd)
        layer1 = AveragePool <kernel_shape = [8, 8], strides = [8, 8]> (planes)
    }
"""


@pytest.mark.parametrize(
    ("nominal", "changes", "reason"),
    [
        (presses(1), {}, "1 nominal press gives no threshold"),
        (presses(3), {}, "3 nominal presses give no threshold: with one held out fewer than 3 are left"),
        (NominalPresses(np.zeros((0, 32, 32, 3), np.uint8), ()), {}, "no nominal press"),
        (presses(3), {"alpha": 1.5}, "false-alarm rate"),
        (presses(3), {"alpha": 0.0}, "false-alarm rate"),
        (presses(3), {"threshold": float("inf")}, "a threshold is a finite number, found inf"),
        (presses(3), {"overrides": {"gian": 2.0}}, "no such parameter"),
        (presses(20), {"detector": Forgetful(9.0)}, "lacks what its own nominal presses show"),
        (painted(12, 3, 0), {}, r"a black frame scores .* and would pass: press 'press 3' stands apart"),
        (presses(4), {"detector": Deep()}, "trunk gives layer1, layer2; export a trunk with layer4"),
        (presses(4), {"trunk": Trunk("x", b"not a graph")}, "trunk 'x' is refused"),
        (
            presses(4),
            {"trunk": Trunk("broken", onnx.parser.parse_model(BROKEN).SerializeToString())},
            "not finite at layer1",
        ),
        (
            NominalPresses(np.zeros((3, 32, 31, 3), np.uint8), ("",) * 3),
            {},
            r"presses are \(32, 31\), the region",
        ),
    ],
)
def test_what_cannot_be_fitted_is_a_sentence(nominal: NominalPresses, changes: dict, reason: str) -> None:
    """Before any long work, where it can be known then."""
    with pytest.raises((FitError, BundleCorrupt), match=reason):
        fit_files(nominal, config(**changes), created="")


@pytest.mark.parametrize(("n", "folds", "learnt"), [(20, 5, 16), (6, 6, 5)])
def test_a_fold_has_the_room_of_its_share_of_the_presses(n: int, folds: int, learnt: int) -> None:
    """The bank of all has 1, that of four fifths four fifths; as many folds as presses leave one out each."""
    watched = WatchedDetector()
    fit_files(presses(n), config(detector=watched, folds=folds), created="")
    assert [nominal.presses for nominal in watched.fitted] == [n] + [learnt] * folds
    assert [nominal.room for nominal in watched.fitted] == pytest.approx([1.0] + [learnt / n] * folds)
    with pytest.raises(FitError, match="at least 2 folds"):
        config(folds=1)
    with pytest.raises(FitError, match="a seed is 0 or more, found -1"):
        config(seed=-1)


def test_equal_presses_and_seed_give_an_equal_bundle() -> None:
    """Everything but the times that were measured."""
    first, second = (fit_files(presses(8), config(), created="2026-01-01") for _ in range(2))
    untimed = [each.manifest.model_copy(update={"cost": None}) for each in (first, second)]
    assert untimed[0] == untimed[1]
    assert {**first.files, "manifest.json": b""} == {**second.files, "manifest.json": b""}


@pytest.mark.parametrize("packing", ["none", "float16", "int8"])
def test_golden_frames_hold_on_the_written_bundle(tmp_path: Path, packing: str) -> None:
    """Two nominal frames and a marked one are scored again after loading, whatever the packing."""
    fitted = fit_files(presses(8), config(overrides={"packing": packing}), created="")
    path = fitted.write(tmp_path / "bolt.zip")
    bundle = Bundle.load(path)
    assert len(bundle.golden) == 3
    assert bundle.golden[2].score > bundle.manifest.threshold.value
    assert Scorer(bundle).check_golden() <= bundle.manifest.tolerance.around(1.0)


def test_a_bundle_without_its_trunk_is_written_and_found(tmp_path: Path) -> None:
    """The zip is small; the store holds the trunk under its hash."""
    path = fit_files(presses(4), config(with_trunk=False), created="").write(tmp_path / "bolt.zip")
    (tmp_path / "trunks").mkdir()
    (tmp_path / "trunks" / f"{Trunk('', tiny.tiny_trunk()).sha256}.onnx").write_bytes(tiny.tiny_trunk())
    assert Scorer(Bundle.load(path)).check_golden() == 0.0


def test_the_detector_is_given_touch_and_free_gel() -> None:
    """The detector gets all data: the touched area and the features of the free gel, in folds as well."""
    watched = WatchedDetector()
    area = np.zeros((32, 32), bool)
    area[8:24, 8:24] = True
    shown = presses(5, touched=area, no_contact=tiny.presses(2, seed=3))
    fit_files(shown, config(detector=watched), created="")
    assert [nominal.presses for nominal in watched.fitted] == [5, 4, 4, 4, 4, 4]
    for nominal in watched.fitted:
        np.testing.assert_array_equal(nominal.touched, area)
        assert nominal.no_contact is not None
        assert nominal.no_contact["layer1"].shape == (2, 3, 4, 4)


def test_presses_that_lie_anywhere_are_refused_by_the_methods_that_mind() -> None:
    """Contacts 8 mm apart: PaDiM refuses, or warns where they are meant; InReaCh says nothing, nor does anyone to a
    millimetre or where no touch is known."""

    class Padim(tiny.TinyDetector):
        name = "padim"
        compares_places = True

    wide = dataclasses.replace(tiny.PROFILE, pixels_per_mm=2.0)
    anywhere, fixed = (
        presses(4, touches=tuple(Touch(0.2, 0.5 + side * mm / 48, 0.5) for side in (-1, 1, -1, 1)))
        for mm in (8.0, 1.0)
    )
    (said,) = scatter_warnings(anywhere, wide, Padim(), is_scattered=True)
    assert said.startswith(
        "half of the contacts lie more than 4.0 mm from their common middle: padim compares"
    )
    assert "fit inreach" in said
    with pytest.raises(FitError, match=r"inreach; --set scattered=true fits padim all the same"):
        fit_files(anywhere, config(detector=Padim(), profile=wide), created="test")
    with pytest.raises(FitError, match=r"all the same \(no gain; see --set register\)$"):
        scatter_warnings(anywhere, wide, Padim(), why_unregistered="no gain")
    guessed = dataclasses.replace(anywhere, touches=(), guessed=anywhere.touches)
    (doubted,) = scatter_warnings(guessed, wide, Padim())  # by a free gel in doubt: nothing is refused
    assert doubted == f"not proven: as far as a free gel in doubt shows it, {said}"
    for given, method in ((anywhere, tiny.TINY), (fixed, Padim()), (presses(4), Padim())):
        assert scatter_warnings(given, wide, method) == []
    meant = config(detector=Padim(), profile=wide, is_scattered=True)
    warned = fit_files(anywhere, meant, created="test").manifest
    assert said in warned.provenance.warnings
