"""Every method, in both modes, on every backbone: the graph against the float64 oracle, end to end from frames.

Relative error below 1e-4 of the map's maximum with the bank as fitted. tests/backbones compares trunks with their own
float64 reference; here their taps are given, so that only the head differs.
"""

from functools import cache

import numpy as np
import pytest
from presses import fitted, head_scores, largest_error

from calibration.fitting.features import extract, trunk_grid
from edge import registry
from edge.core.detector import Features, Grid, Nominal
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
    ("inreach", "paper", "wide_resnet50_2"): LOOSE,
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
    """Every registered detector is tested here."""
    assert set(METHODS) <= set(registry.names("detectors"))
    assert {"tiny", *METHODS} >= set(registry.names("detectors"))


def error(method: str, mode: str, topology: str, touched: np.ndarray | None = None) -> float:
    """The largest relative error of map and score; the press with the defect scores higher in the oracle."""
    detector = registry.detector(method)
    nominal, asked, grid = seen(topology)
    parameters = detector.parameters(mode, **CHOICES.get((method, mode, topology), {}))
    bank = fitted(detector, parameters, Nominal(nominal, touched), grid)
    oracle = detector.reference_score(asked, grid, bank, parameters)
    assert oracle.score[1] > oracle.score[0]
    return largest_error(head_scores(detector, parameters, asked, bank, grid), oracle)


@pytest.mark.parametrize("topology", ["resnet18", "resnet50", "wide_resnet50_2"])
@pytest.mark.parametrize("mode", ["paper", "corrected"])
@pytest.mark.parametrize("method", METHODS)
def test_the_graph_equals_the_oracle(method: str, mode: str, topology: str) -> None:
    """Map and score within 1e-4."""
    assert error(method, mode, topology) < 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_the_graph_equals_the_oracle_where_the_touch_is_known(method: str) -> None:
    """The same with cells that no nominal press touches."""
    assert error(method, "corrected", "resnet18", TOUCHED) < 1e-4
