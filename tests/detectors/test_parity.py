"""What every method does, in both modes: the graph is the float64 oracle, and the cheapest truths hold.

On a backbone of plain blocks and one of bottlenecks, end to end from frames, the relative error is below 1e-4 of the
map's maximum with the bank as fitted. tests/backbones compares trunks with their own float64 reference; here their taps
are given, so that only the head differs. The methods that compare with a memory are tried on small taps as well.
"""

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from heads import fit, hard_presses, head_scores, largest_error, parity, presses_of, run_head, with_spot
from heads import grid as small_grid
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.fitting.features import extract, trunk_grid
from edge import registry
from edge.core.detector import Features, Grid, Nominal
from edge.core.errors import FitError, NotScorable
from edge.model.session import open_session
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.detectors.inreach.paper import PAPER_TAPS

METHODS = ("fapm", "inreach", "padim", "patchcore", "spade", "subspace")
TAPS = ("layer1", "layer2", "layer3", "avgpool")
# InReaCh's published dispersion is for trained features; with random weights no channel is below it. ResNet-18 has not
# its published taps.
LOOSE: dict[str, object] = {"max_dispersion": 1e6}
CHOICES: dict[tuple[str, str, str], dict[str, object]] = {
    ("inreach", "paper", "resnet18"): {**LOOSE, "taps": TAPS[:3], "grid_tap": "layer1"},
    ("inreach", "paper", "resnet50"): LOOSE,
}
SIDE, NOMINAL, ASKED = 64, 6, 2
TOUCHED = np.zeros((SIDE, SIDE), bool)
TOUCHED[14:46, 20:54] = True


@cache
def seen(topology: str) -> tuple[Features, Features, Grid]:
    """Taps of nominal presses and of others, the last with a defect; made once for all methods."""
    taps = TAPS if topology == "resnet18" else (*TAPS, *PAPER_TAPS)
    session = open_session(build_trunk(random_state(topology), topology, taps), 1, topology)
    grid = trunk_grid(session, taps, (SIDE, SIDE), 15.77)
    rng = np.random.default_rng(0)
    base = rng.integers(60, 200, (1, SIDE // 8, SIDE // 8, 3)).repeat(8, 1).repeat(8, 2)
    frames = np.clip(base + rng.normal(0, 6, (NOMINAL + ASKED, SIDE, SIDE, 3)), 0, 255).astype(np.uint8)
    frames[-1, 28:38, 30:40] = 255
    features = extract(session, frames, grid, lambda done: None)
    nominal, asked = (
        {tap: maps[rows] for tap, maps in features.items()} for rows in (slice(NOMINAL), slice(NOMINAL, None))
    )
    return nominal, asked, grid


def test_every_method_is_compared() -> None:
    assert set(METHODS) <= set(registry.names("detectors"))
    assert {"tiny", *METHODS} >= set(registry.names("detectors"))


def error(method: str, mode: str, topology: str, touched: np.ndarray | None = None) -> float:
    """The largest relative error of map and score; the press with the defect scores higher in the oracle."""
    detector = registry.detector(method)
    nominal, asked, grid = seen(topology)
    parameters = detector.parameters(mode, **CHOICES.get((method, mode, topology), {}))
    bank = fit(detector, parameters, Nominal(nominal, touched), grid)
    oracle = detector.reference_score(asked, grid, bank, parameters)
    assert oracle.score[1] > oracle.score[0]
    return largest_error(head_scores(detector, parameters, asked, bank, grid), oracle)


@pytest.mark.parametrize("topology", ["resnet18", pytest.param("resnet50", marks=pytest.mark.lab)])
@pytest.mark.parametrize("mode", ["paper", "corrected"])
@pytest.mark.parametrize("method", METHODS)
def test_the_graph_equals_the_oracle(method: str, mode: str, topology: str) -> None:
    assert error(method, mode, topology) < 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_the_graph_equals_the_oracle_where_the_touch_is_known(method: str) -> None:
    """The same with cells that no nominal press touches."""
    assert error(method, "corrected", "resnet18", TOUCHED) < 1e-4


MODES = ("paper", "corrected")
MEMORIES = ("spade", "fapm", "inreach", "patchcore")
KEEPS_ALL = {
    "spade": {"image_neighbours": 1, "pixel_neighbours": 1},
    "fapm": {"near_fraction": 1.0, "is_calibrated": False},
    "inreach": {"is_fallback": True, "most_rows": None},
    "patchcore": {"coreset_fraction": 1.0, "most_rows": None},
}
EACH = pytest.mark.parametrize(("method", "mode"), list(product(MEMORIES, MODES)))


def on_small_taps(method: str, mode: str, **changes: object) -> Any:
    """Return parameters for the small taps: InReaCh has a bank of few presses, and FAPM's weight is finite."""
    fixed: dict[str, object] = {"weighting": "none"} if method == "fapm" else {}
    if method == "inreach":
        fixed |= {"is_fallback": True}
    if (method, mode) == ("inreach", "paper"):
        fixed |= {"taps": TAPS[:3], "grid_tap": "layer1"}
    return registry.detector(method).parameters(mode, **fixed | changes)


@EACH
@pytest.mark.parametrize("n", [1, 2, 14])
def test_few_presses_have_the_oracles_scores(method: str, mode: str, n: int) -> None:
    """Map and score agree to 1e-5, also with fewer presses than neighbours, for several presses at once."""
    p = on_small_taps(method, mode)
    errors = parity(registry.detector(method), p, presses_of(n), presses_of(3, 1), small_grid())[1:]
    assert max(errors) < 1e-5


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 5), st.sampled_from([1e-6, 1.0, 1e6]), st.sampled_from(["noise", "same", "constant", "dead"]),
    st.sampled_from(MEMORIES), st.sampled_from(MODES), st.integers(0, 10_000),
)  # fmt: skip
def test_hard_sets_keep_bounds(n: int, scale: float, kind: str, method: str, mode: str, seed: int) -> None:
    """Few, equal, constant and all-zero presses at any scale: finite, and the graph equals the oracle to 1e-4."""
    asked = with_spot(presses_of(1, seed + 1, scale=scale))
    nominal, p = hard_presses(n, kind, seed, scale), on_small_taps(method, mode)
    oracle, *errors = parity(registry.detector(method), p, nominal, asked, small_grid())
    assert np.isfinite(oracle.score_map).all()
    assert max(errors) < 1e-4


@EACH
def test_a_press_of_the_bank_scores_nothing(method: str, mode: str) -> None:
    """With everything kept, a nominal press is at distance 0 from itself."""
    detector, p = registry.detector(method), on_small_taps(method, mode, packing="none", **KEEPS_ALL[method])
    nominal = presses_of(1 if method == "inreach" else 5)
    bank = fit(detector, p, nominal, small_grid())
    head = detector.head(small_grid(), bank, p)
    own, foreign = (run_head(head, asked, bank)["score_map"] for asked in (nominal, presses_of(1, 9)))
    assert own.max() < 1e-4 * foreign.max()


@EACH
def test_the_maximum_is_where_the_foreign_patch_is(method: str, mode: str) -> None:
    """A patch unlike anything nominal is found at its place."""
    detector, p = registry.detector(method), on_small_taps(method, mode)
    bank = fit(detector, p, presses_of(20), small_grid())
    asked = with_spot(presses_of(1, 3), 0.75)
    spotted = detector.reference_score(asked, small_grid(), bank, p).score_map[0]
    row, column = np.unravel_index(spotted.argmax(), spotted.shape)
    assert min(row, column) >= 16


@pytest.mark.parametrize("method", MEMORIES)
def test_features_that_are_not_finite_are_refused(method: str) -> None:
    """NaN in a nominal press is a FitError; in a press to be scored it is NotScorable, and the graph's map is NaN."""
    detector, p, broken = registry.detector(method), on_small_taps(method, "corrected"), presses_of(3)
    broken["layer1"][1, 0, 0, 0] = np.nan
    with pytest.raises(FitError, match="not finite"):
        fit(detector, p, broken, small_grid())
    bank = fit(detector, p, presses_of(3), small_grid())
    with pytest.raises(NotScorable, match="no score"):
        detector.reference_score(broken, small_grid(), bank, p)
    found = run_head(detector.head(small_grid(), bank, p), broken, bank)["score_map"]
    assert not np.isfinite(found[1]).all()
    assert np.isfinite(found[[0, 2]]).all()


@pytest.mark.parametrize("method", MEMORIES)
def test_presses_that_touch_nothing_are_refused(method: str) -> None:
    """A bank of the free gel would judge nothing of the part."""
    detector, nowhere = registry.detector(method), np.zeros(small_grid().frame, bool)
    nominal = Nominal(presses_of(3), nowhere)
    with pytest.raises(FitError, match="no nominal press touches"):
        detector.fit(
            nominal, small_grid(), detector.parameters(), np.random.default_rng(0), lambda done: None
        )


def louder(features: Features) -> Features:
    """The same presses with one tap a thousand times as strong."""
    return {tap: maps * np.float32(1000 if tap == "layer3" else 1) for tap, maps in features.items()}


@pytest.mark.parametrize(
    ("method", "mode", "choice"),
    [
        ("spade", "paper", {"is_normalised": False, "image_score": "map"}),
        ("patchcore", "corrected", {"layers": TAPS[:3], **KEEPS_ALL["patchcore"]}),
    ],
)
def test_no_tap_rules_by_its_scale(method: str, mode: str, choice: dict[str, object]) -> None:
    """Repair: a tap a thousand times stronger does not change the shape of the balanced map."""
    detector, spot, change = registry.detector(method), with_spot(presses_of(1, 9)), {}
    for is_balanced in (True, False):
        p, shapes = detector.parameters(mode, is_balanced=is_balanced, **choice), []
        for shown in (dict, louder):
            bank = fit(detector, p, shown(presses_of(6)), small_grid())
            score_map = detector.reference_score(shown(spot), small_grid(), bank, p).score_map[0]
            shapes.append(score_map / score_map.max())
        change[is_balanced] = np.abs(shapes[1] - shapes[0]).max()
    assert change[True] < 0.01
    assert change[False] > 0.02
