"""PaDiM: the graph is the float64 oracle, for every choice, and each repair. Hazard H1 has the dense inverse."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from heads import LIKE_RESNET, features, fit, head_scores, largest_error, run_head, stored, stored_bytes

from edge.core.detector import Grid, Nominal, ScoreMaps
from edge.core.errors import FitError
from plugins.detectors.padim import PadimParameters, padim

QUERY = features(3, seed=7)
EXACT = padim.parameters("corrected", projection="all", rank=None, packing="none")
DEEP = ("layer1", "layer2", "layer3")
TOUCHED = np.zeros((48, 48), bool)
TOUCHED[20:26, 22:30] = True


@pytest.mark.parametrize("touched", [None, TOUCHED], ids=["everywhere", "partly"])
@pytest.mark.parametrize(
    "choice",
    [
        {},
        {"taps": ("layer1", "layer2")},
        {"rank": None},
        {"rank": 3, "neighbours": 1},
        {"block": 1},
        {"block": 5, "taps": ("layer1",)},
        {"block": 2, "neighbours": 0, "grid_tap": "layer3"},
        {"projection": "all"},
        {"projection": "random", "channels": 17},
        {"projection": "random", "channels": 2},
        {"grid_tap": "layer2"},
        {"grid_tap": "layer2", "projection": "all", "is_balanced": False},
        {"grid_tap": "layer3", "taps": ("layer2", "layer3")},
        {"is_sampled": False, "sigma": 3.0, "sigma_unit": "px"},
        {"is_ridge_twice": True, "ridge": 1e-4},
    ],
    ids=str,
)
@pytest.mark.parametrize("n", [1, 2, 30])
def test_the_graph_equals_the_oracle(n: int, choice: dict[str, Any], touched: np.ndarray | None) -> None:
    """Map and score within 1e-4 of float64 (found: below 2e-6), for every choice, also from one or two presses."""
    parameters = padim.parameters("corrected", **{"taps": DEEP, **choice})
    nominal = Nominal(features(n, seed=1), touched, features(2, seed=2))
    bank = fit(padim, parameters, nominal)
    oracle = padim.reference_score(QUERY, LIKE_RESNET, bank, parameters)
    assert largest_error(head_scores(padim, parameters, QUERY, bank), oracle) < 2e-6


@pytest.mark.parametrize(("packing", "bound"), [("float16", 2e-3), ("int8", 2e-2)])
def test_stored_banks_stay_within_their_bound(packing: str, bound: float) -> None:
    """float16 costs at most 0.2 % of the largest distance, int8 at most 2 %; the stored size follows."""
    parameters = padim.parameters(packing=packing)
    bank = fit(padim, parameters, Nominal(features(30, seed=1)))
    oracle = padim.reference_score(QUERY, LIKE_RESNET, bank, parameters)
    assert largest_error(head_scores(padim, parameters, QUERY, stored(bank)), oracle) < bound
    assert bank.packing["basis"] == packing
    assert bank.packing["mean"] == "float16"


@pytest.mark.parametrize("packing", ["none", "float16", "int8"])
def test_the_bank_stays_within_its_megabytes(packing: str) -> None:
    """The requested rank is lowered until the bank fits, which the manifest records; the graph is the same."""
    deep: dict[str, Any] = {"taps": DEEP, "grid_tap": "layer2", "block": 1, "rank": 32, "packing": packing}
    parameters = padim.parameters(bank_mb=0.03, **deep)
    bank = fit(padim, parameters, Nominal(features(30, seed=1)))
    size = stored_bytes(bank)
    projections = sum(array.nbytes for name, array in bank.arrays.items() if name.startswith("projection_"))
    assert size - projections <= 30_000
    assert 2 < bank.facts["rank"] < 20
    assert any("directions per place" in warning for warning in bank.facts["warnings"])
    oracle = padim.reference_score(QUERY, LIKE_RESNET, bank, parameters)
    assert largest_error(head_scores(padim, parameters, QUERY, bank), oracle) < 2e-6
    whole = fit(padim, padim.parameters(bank_mb=None, **deep), Nominal(features(30, seed=1)))
    assert whole.facts["rank"] > bank.facts["rank"]
    assert whole.facts["warnings"] == []


def test_one_head_serves_parts_touched_in_different_places() -> None:
    """The head fitted on one part scores another part's bank, touched elsewhere and in fewer cells."""
    parameters = padim.parameters(margin_mm=0.0)
    other = np.zeros((48, 48), bool)
    other[0:2, 0:2] = True
    first = fit(padim, parameters, Nominal(features(20, seed=1), TOUCHED))
    second = fit(padim, parameters, Nominal(features(20, seed=3), other))
    assert first.facts["locations"] != second.facts["locations"]
    found = run_head(padim.head(LIKE_RESNET, first, parameters), QUERY, second)
    oracle = padim.reference_score(QUERY, LIKE_RESNET, second, parameters)
    assert largest_error(ScoreMaps(found["score_map"], found["score"]), oracle) < 2e-6


def test_the_maximum_is_where_the_features_were_changed() -> None:
    """A deviation in one cell of layer1 is the peak of the map, at the pixel that the cell represents."""
    parameters = padim.parameters(grid_tap="layer1", neighbours=0, sigma=2.0, sigma_unit="px")
    bank = fit(padim, parameters, Nominal(features(30, seed=1)))
    odd = {tap: value[:1].copy() for tap, value in QUERY.items()}
    odd["layer1"][0, :, 4, 9] += 5
    score_map = head_scores(padim, parameters, odd, bank).score_map[0]
    assert np.unravel_index(score_map.argmax(), score_map.shape) == (16, 36)


# --- the repairs of the corrected mode, switch by switch


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_repair_balanced_taps(scale: float) -> None:
    """is_balanced: the scores do not depend on the features' scale; in the paper's form the ridge decides."""

    def score(parameters: PadimParameters, by: float) -> np.ndarray:
        bank = fit(padim, parameters, Nominal(features(20, seed=1, scale=by)))
        query = features(3, seed=7, scale=by)
        found = head_scores(padim, parameters, query, bank)
        assert largest_error(found, padim.reference_score(query, LIKE_RESNET, bank, parameters)) < 1e-4
        return found.score

    balanced, paper = padim.parameters(), padim.parameters("paper", channels=40)
    np.testing.assert_allclose(score(balanced, scale), score(balanced, 1.0), rtol=1e-4)
    assert not np.allclose(score(paper, scale), score(paper, 1.0), rtol=0.5)


def test_repair_balance_between_taps() -> None:
    """is_balanced: one tap at a thousand times the scale of the others does not hide them."""
    loud = {tap: value * (1000 if tap == "layer3" else 1) for tap, value in features(20, seed=1).items()}
    query = {tap: value * (1000 if tap == "layer3" else 1) for tap, value in QUERY.items()}
    odd = {tap: value.copy() for tap, value in query.items()}
    odd["layer1"][:, :, 4, 4] += 5

    def rise(parameters: PadimParameters) -> float:
        bank = fit(padim, parameters, Nominal(loud))
        a, b = (padim.reference_score(each, LIKE_RESNET, bank, parameters) for each in (odd, query))
        return float((a.score_map / b.score_map).max())

    assert rise(padim.parameters(taps=DEEP, neighbours=0)) > 1.3
    assert rise(padim.parameters(taps=DEEP, neighbours=0, is_balanced=False)) < 1.15


def test_repair_physical_blur() -> None:
    """sigma_unit: in millimetres the blur follows the resolution; in pixels it does not."""
    fine = dataclasses.replace(LIKE_RESNET, pixels_per_mm=4 * LIKE_RESNET.pixels_per_mm)
    for mode, factor in (("paper", 1), ("corrected", 4)):
        parameters = padim.parameters(mode)
        low, high = (parameters.smoothing(grid, (12, 12)).sigma_px for grid in (LIKE_RESNET, fine))
        assert high == pytest.approx(factor * low)
        assert low == pytest.approx(4.0 if mode == "paper" else 0.19 * 15.77, rel=1e-6)


def test_repair_sampled_cells() -> None:
    """is_sampled: a cell of layer3 is drawn around the centre of its convolution (16 i), not 7.5 px off."""
    odd = {tap: value[:1].copy() for tap, value in QUERY.items()}
    odd["layer3"][0, :, 1, 1] += 20

    def centre(is_sampled: bool) -> float:
        parameters = padim.parameters(
            taps=("layer2", "layer3"), grid_tap="layer2", is_sampled=is_sampled, sigma=0.1
        )
        bank = fit(padim, parameters, Nominal(features(30, seed=1)))
        rows = head_scores(padim, parameters, odd, bank).score_map[0].max(axis=1)
        hot = np.flatnonzero(rows > 0.9 * rows.max())
        return float(hot.mean())

    assert abs(centre(True) - 16) <= 4.5
    assert abs(centre(False) - 23.5) <= 2


def test_repair_untouched_cells_need_no_bank() -> None:
    """is_touched_only: cells that no press touches hold a mean and no eigenvectors, and still detect a stray touch."""
    nominal = Nominal(features(30, seed=1), TOUCHED, features(3, seed=2))
    for block, covariances, cells in ((1, 2 * 3, 6), (2, 2 * 2, 16)):
        parameters = padim.parameters(margin_mm=0.0, block=block)
        bank = fit(padim, parameters, nominal)
        assert bank.facts["covariances"] == len(bank.arrays["basis"]) == covariances
        assert bank.facts["locations"] == cells
        assert bank.facts["locations_shared"] == 144 - cells
    stray = {tap: value.copy() for tap, value in QUERY.items()}
    stray["layer1"][:, :, 1, 1] += 5
    plain, odd = (head_scores(padim, parameters, each, bank) for each in (QUERY, stray))
    assert (odd.score_map[:, 4, 4] > 1.5 * plain.score_map[:, 4, 4]).all()


def test_neighbours_tolerate_a_shift() -> None:
    """neighbours=1: presses shifted by one cell score lower than with a Gaussian per single cell."""
    train = features(30, seed=1)
    shifted = {tap: np.roll(value[:5], 1, axis=3) for tap, value in train.items()}

    def score(parameters: PadimParameters) -> np.ndarray:
        bank = fit(padim, parameters, Nominal(train))
        return padim.reference_score(shifted, LIKE_RESNET, bank, parameters).score_map[:, 12:36, 12:36].mean()

    exact: dict[str, Any] = {"rank": None, "ridge": 0.05}
    assert score(padim.parameters(neighbours=1, **exact)) < 0.7 * score(
        padim.parameters(neighbours=0, **exact)
    )


def test_unfit_presses_are_refused() -> None:
    """No press, a missing tap, a wrong shape, a value that is not finite, a wrong mask, no touch: FitError."""
    train = features(4, seed=1)
    spoilt = {tap: value.copy() for tap, value in train.items()}
    spoilt["layer2"][3, 0, 0, 0] = np.nan
    cases = {
        "there are no nominal presses": Nominal({tap: value[:0] for tap, value in train.items()}),
        "needs the tap 'layer3'": Nominal({"layer1": train["layer1"], "layer2": train["layer2"]}),
        "the grid says": Nominal({**train, "layer1": train["layer1"][:, :3]}),
        r"not finite in nominal presses \[3\]": Nominal(spoilt),
        "touched mask": Nominal(train, np.ones((3, 3), bool)),
        "different numbers": Nominal({**train, "layer1": train["layer1"][:2]}),
        "no nominal press touches": Nominal(train, np.zeros((48, 48), bool)),
        "not finite in no-contact frames": Nominal(train, TOUCHED, spoilt),
    }
    for says, nominal in cases.items():
        with pytest.raises(FitError, match=says):
            fit(padim, padim.parameters(taps=DEEP), nominal)


def test_a_published_choice_of_channels_is_taken() -> None:
    """A list counted through all taps replaces the draw, whatever the seed: the bank keeps exactly those channels, and
    scores equal those of taps with only these channels."""
    listed = (39, 3, 8, 19, 0)
    parameters = padim.parameters("paper", channel_list=listed)
    train = features(6, seed=1)
    bank = fit(padim, parameters, Nominal(train), seed=5)
    kept = [bank.arrays[f"channels_{tap}"].tolist() for tap in DEEP]
    assert kept == [[0, 3], [0, 11], [19]]
    few = {tap: value[:, chosen] for (tap, value), chosen in zip(train.items(), kept, strict=True)}
    asked = {tap: value[:, chosen] for (tap, value), chosen in zip(QUERY.items(), kept, strict=True)}
    at = Grid((48, 48), {tap: value.shape[1:] for tap, value in few.items()}, LIKE_RESNET.pixels_per_mm)
    every = padim.parameters("paper", projection="all", channels=None)
    alone = padim.reference_score(asked, at, fit(padim, every, Nominal(few), at), every)
    assert largest_error(padim.reference_score(QUERY, LIKE_RESNET, bank, parameters), alone) < 1e-9
    assert largest_error(head_scores(padim, parameters, QUERY, bank), alone) < 2e-6
    with pytest.raises(FitError, match="names channel 40, the taps have 40 together, 0 to 39"):
        fit(padim, padim.parameters("paper", channel_list=(3, 40)), Nominal(train))


@pytest.mark.parametrize("block", [1, 2])
def test_a_block_has_the_mean_of_its_cells_covariances(block: int) -> None:
    """Mean and covariance of a cell's 3x3 neighbourhood, borders repeated, from nine cells' moments, are those of all
    their samples. The cells of a block share the mean of their covariances; each keeps its own mean."""
    parameters = padim.parameters(projection="all", is_balanced=False, rank=None, block=block)
    train = {"layer1": features(4, seed=1)["layer1"]}
    bank = fit(padim, parameters, Nominal(train), Grid((48, 48), {"layer1": (8, 12, 12)}, 15.77))
    padded = np.pad(train["layer1"].astype(np.float64), ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")
    for row, column in ((0, 0), (4, 6), (10, 2)):
        covariances = []
        for cell_row, cell_column in np.ndindex(block, block):
            top, left = row + cell_row, column + cell_column
            samples = padded[:, :, top : top + 3, left : left + 3].transpose(0, 2, 3, 1).reshape(-1, 8)
            np.testing.assert_allclose(bank.arrays["mean"][top * 12 + left], samples.mean(axis=0), rtol=1e-5)
            covariances.append(np.cov(samples, rowvar=False))
        number = row // block * (12 // block) + column // block
        basis, values = bank.arrays["basis"][number], 1 / bank.arrays["weights"][number] - parameters.ridge
        found = basis.T * values @ basis
        np.testing.assert_allclose(found, np.mean(covariances, axis=0), rtol=1e-3, atol=1e-5)


def test_the_bank_says_what_was_repaired() -> None:
    """A manifest lists each switch that differs from the publication; the paper's mode has none."""
    bank = fit(padim, padim.parameters("corrected"), Nominal(features(6)))
    paper = fit(padim, padim.parameters("paper", channels=20), Nominal(features(6)))

    assert {"is_ridge_twice=False", "sigma_unit=mm"} <= set(bank.facts["repairs"])
    assert paper.facts["repairs"] == []
    assert [padim.parameters(mode, ridge=0.01).total_ridge for mode in ("paper", "corrected")] == [0.02, 0.01]
