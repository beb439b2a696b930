"""H18: zero padding makes features near the border differ from the same content in the middle.

Guards: PaDiM's mean and span, FAPM's prototypes and SPADE's window belong to a place; the shared banks of InReaCh,
PatchCore and the subspace hold patches of the border. Checked by removal: with the mean of a cell in the middle for
all of PaDiM's locations at fit, or with a shared bank without the border's patches, the border scores 1.5 times as high
as the middle.
"""

from functools import cache

import numpy as np
import pytest
from heads import fit

from edge.core.detector import Features, Grid, Nominal
from plugins.backbones.input_steps import IMAGENET, apply_steps
from plugins.backbones.random import random_state
from plugins.backbones.reference import forward
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.spade import spade


@cache
def flat_frames(n: int, seed: int) -> Features:
    """Features of an even grey with faint noise, 96x96: the content is the same everywhere."""
    rgb = np.random.default_rng(seed).normal(128, 4, (n, 96, 96, 3)).astype(np.uint8)
    taps = forward(
        random_state("resnet18"), "resnet18", apply_steps(IMAGENET, rgb), ("layer1", "layer2", "layer3")
    )
    return {tap: value.astype(np.float32) for tap, value in taps.items()}


def nominal() -> Features:
    return flat_frames(10, 0)


def asked() -> Features:
    return flat_frames(3, 1)


def grid() -> Grid:
    return Grid((96, 96), {tap: value.shape[1:] for tap, value in nominal().items()}, 15.77)


def border_to_middle(score_map: np.ndarray) -> float:
    """The mean of the outermost 8 pixels by the mean of the middle."""
    inside = score_map[:, 24:-24, 24:-24].mean()
    edge = np.concatenate([score_map[:, :8].ravel(), score_map[:, -8:].ravel()]).mean()
    return float(edge / inside)


def test_the_border_differs_from_the_middle() -> None:
    """The hazard itself: the mean feature of an even grey is different at the border."""
    layer1 = nominal()["layer1"].mean(axis=0)
    assert np.abs(layer1[:, 0] - layer1[:, 12]).max() > 5 * nominal()["layer1"].std(axis=0).mean()


@pytest.mark.parametrize("detector", [padim, spade, fapm, inreach, patchcore, subspace], ids=lambda d: d.name)
def test_an_even_surface_has_an_even_map(detector: object) -> None:
    """On nominal content the border scores like the middle, though its features differ from those of the middle."""
    p = detector.parameters()  # type: ignore[attr-defined]
    bank = fit(detector, p, Nominal(nominal()), grid())
    found = detector.reference_score(asked(), grid(), bank, p).score_map  # type: ignore[attr-defined]
    assert 0.67 < border_to_middle(found) < 1.4


def test_one_mean_for_all_places_sees_a_border() -> None:
    """PaDiM with the mean of a cell in the middle everywhere: the border scores higher."""
    p = padim.parameters()
    bank = fit(padim, p, Nominal(nominal()), grid())
    mean = bank.arrays["mean"]
    arrays = {**bank.arrays, "mean": np.broadcast_to(mean[12 * 24 + 12], mean.shape)}
    assert border_to_middle(padim.reference_score(asked(), grid(), type(bank)(arrays), p).score_map) > 1.5


@pytest.mark.parametrize("detector", [spade, inreach, patchcore, subspace], ids=lambda d: d.name)
def test_a_bank_without_the_border_sees_it(detector: object) -> None:
    """Banks learnt from presses whose border features are those of the middle: the border scores higher."""
    inside = {tap: value.copy() for tap, value in nominal().items()}
    for maps in inside.values():
        ring = max(1, maps.shape[2] // 8)
        for edge in range(ring):
            for here, there in ((edge, ring), (-1 - edge, -1 - ring)):
                maps[:, :, here] = maps[:, :, there]
        for edge in range(ring):
            for here, there in ((edge, ring), (-1 - edge, -1 - ring)):
                maps[..., here] = maps[..., there]
    p = detector.parameters()  # type: ignore[attr-defined]
    bank = fit(detector, p, Nominal(inside), grid())
    assert border_to_middle(detector.reference_score(asked(), grid(), bank, p).score_map) > 1.5  # type: ignore[attr-defined]
