"""H18: zero padding makes features near the border differ from the same content in the middle.

Guard: PaDiM's mean and span belong to a location, borders included. Checked by removal: with the mean and span of
all locations averaged at fit, the border scores half as much again as the middle and the test fails.
"""

import numpy as np
from presses import fitted

from edge.core.detector import Features, Grid, Nominal
from plugins.backbones.random import random_state
from plugins.backbones.reference import forward, normalise
from plugins.detectors.padim import padim

STATE = random_state("resnet18")


def flat_frames(n: int, seed: int) -> Features:
    """Features of an even grey with faint noise, 96x96: the content is the same everywhere."""
    rgb = np.random.default_rng(seed).normal(128, 4, (n, 96, 96, 3)).astype(np.uint8)
    taps = forward(STATE, "resnet18", normalise(rgb), ("layer1", "layer2", "layer3"))
    return {tap: value.astype(np.float32) for tap, value in taps.items()}


def border_to_middle(score_map: np.ndarray) -> float:
    """The mean of the outermost 8 pixels by the mean of the middle."""
    inside = score_map[:, 24:-24, 24:-24].mean()
    edge = np.concatenate([score_map[:, :8].ravel(), score_map[:, -8:].ravel()]).mean()
    return float(edge / inside)


def test_an_even_surface_has_an_even_map() -> None:
    """On nominal content the border scores like the middle, though its features differ from those of the middle."""
    train, query = flat_frames(10, 0), flat_frames(3, 1)
    grid = Grid((96, 96), {tap: value.shape[1:] for tap, value in train.items()}, 15.77)
    layer1 = train["layer1"].mean(axis=0)
    assert np.abs(layer1[:, 0] - layer1[:, 12]).max() > 5 * train["layer1"].std(axis=0).mean()
    parameters = padim.parameters(grid_tap="layer1")
    bank = fitted(padim, parameters, Nominal(train), grid)
    found = padim.reference_score(query, grid, bank, parameters).score_map
    assert 0.7 < border_to_middle(found) < 1.4

    middle = 12 * 24 + 12
    arrays = {**bank.arrays, "mean": np.broadcast_to(bank.arrays["mean"][middle], bank.arrays["mean"].shape)}
    shared = padim.reference_score(query, grid, type(bank)(arrays), parameters).score_map
    assert border_to_middle(shared) > 1.5
