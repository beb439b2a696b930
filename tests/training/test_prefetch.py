"""Batches drawn in another process equal those drawn in this one, and its death is reported."""

import multiprocessing
import os
import signal

import pytest
import torch

from calibration.training import prefetch
from calibration.training.prefetch import draw_step, drawn_ahead
from calibration.training.train_config import TrainConfig
from edge.core.errors import GelgateError

SMALL = TrainConfig.shipped(steps=4, pairs=1, side=64, high_resolution=0.5)
CPU = torch.device("cpu")


def test_drawn_ahead_is_drawn_in_place() -> None:
    """Steps 1 and 2 have the same bytes either way; a step out of order is refused; the process ends with the run."""
    torch.set_num_threads(1)
    others = set(multiprocessing.active_children())
    with drawn_ahead(SMALL, 1) as take:
        for step in (1, 2):
            found, expected = take(step), draw_step(SMALL, step, CPU)
            assert found.spacing == expected.spacing
            for name in ("frames", "surface_mm", "change_mm"):
                assert torch.equal(getattr(found, name), getattr(expected, name))
        with pytest.raises(GelgateError, match="was step 3, wanted step 7"):
            take(7)
    assert set(multiprocessing.active_children()) <= others


def test_a_dead_drawing_process_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed, usually before its first batch: the first step that it has not drawn reports its exit code."""
    monkeypatch.setattr(prefetch, "_PATIENCE_S", 0.2)
    others = set(multiprocessing.active_children())
    with drawn_ahead(SMALL, 0) as take:
        (drawer,) = set(multiprocessing.active_children()) - others
        assert drawer.pid is not None
        os.kill(drawer.pid, signal.SIGKILL)
        drawer.join()
        # A busy machine kills it after some steps.
        with pytest.raises(GelgateError, match=r"ended with exit code -9 before step \d"):
            list(map(take, range(SMALL.steps + 1)))
