"""Feature maps: the same in memory and on disk, for any batch size."""

import numpy as np
import tiny

from calibration.fitting.features import extract, trunk_grid
from edge.model.session import open_session


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
