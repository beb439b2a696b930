"""Feature maps: the same in memory and on disk, for any batch size."""

import numpy as np
import tiny
from heads import LIKE_RESNET, features, fit
from tiny_fit import config

from calibration.fitting.features import extract, feature_warnings, trunk_grid
from calibration.fitting.fit import fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.detector import Nominal
from edge.model.session import open_session
from plugins.detectors.padim import padim


def test_the_grid_is_what_the_trunk_gives() -> None:
    """Shapes come from running it, not from its strides."""
    session = open_session(tiny.tiny_trunk(), 1, "trunk")
    assert trunk_grid(session, ("layer1", "layer2"), (32, 32), 15.77) == tiny.tiny_grid()
    assert trunk_grid(session, ("layer1",), (64, 48), 15.77).taps == {"layer1": (3, 8, 6)}


def test_features_too_large_for_memory_lie_in_a_file() -> None:
    """Seven frames in batches of four: the mean colour of each cell, equal in memory and in a temporary file."""
    session, frames, done = open_session(tiny.tiny_trunk(), 1, "trunk"), tiny.presses(7), []
    in_memory = extract(session, frames, tiny.tiny_grid(), done.append)
    on_disk = extract(session, frames, tiny.tiny_grid(), done.append, memory_bytes=0)
    truth = frames.reshape(7, 4, 8, 4, 8, 3).astype(np.float64).mean(axis=(2, 4)).transpose(0, 3, 1, 2) / 255
    np.testing.assert_allclose(in_memory["layer1"], truth, rtol=1e-6)
    np.testing.assert_array_equal(in_memory["layer1"], on_disk["layer1"])
    assert isinstance(on_disk["layer1"], np.memmap)
    assert done[1] == done[-1] == 1.0


def test_one_channel_that_hides_the_others_is_named() -> None:
    """One channel of each tap deviates 100 times more: damage in others scores like a fresh press, and it is said."""
    margins = []
    for times in (1.0, 100.0):
        rng, nominal, asked = np.random.default_rng(5), features(20, seed=1), features(10, seed=7)
        for part, (tap, maps) in enumerate(nominal.items()):
            for shown in (maps, asked[tap]):
                shown[:, 7] += (times * rng.normal(0, 0.3, shown[:, 7].shape)).astype(np.float32)
            cells = slice(4 >> part, 8 >> part)
            asked[tap][5:, :6, cells, cells] += 2
        parameters = padim.parameters()
        bank = fit(padim, parameters, Nominal(nominal))
        scores = padim.reference_score(asked, LIKE_RESNET, bank, parameters).score
        margins.append(scores[5:].min() / scores[:5].max())
        said = feature_warnings(Nominal(nominal), LIKE_RESNET)
        assert len(said) == (3 if times > 1 else 0)
    assert margins[0] > 2
    assert margins[1] < 1.1
    assert "channel 7 of 'layer1' has more than 90% of what differs between nominal presses" in said[0]


def test_a_fit_of_any_method_says_what_hardly_differs() -> None:
    """Frames of 200 or 201 levels: the bundle of a method of another package has the warning."""
    frames = np.random.default_rng(0).integers(200, 202, (8, 32, 32, 3)).astype(np.uint8)
    manifest = fit_files(NominalPresses(frames, ("",) * 8), config(), created="").manifest
    assert any(
        "'layer1' differs between nominal presses by less than 1%" in w for w in manifest.provenance.warnings
    )
