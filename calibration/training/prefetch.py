"""Batches drawn in advance, in a second process, while the network learns from the previous one.

A batch depends only on the recipe and the step, so it has the same bytes in any process. Each process uses one thread.
On shared cores, two threads of one process wait for each other by spinning, and a step takes four times as long
(measured on two shared cores).
"""

import multiprocessing
import queue
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.queues import Queue

import numpy as np
import torch
from numpy.typing import NDArray

from calibration.training.random_sensors import RandomSensors
from calibration.training.render import Spacing
from calibration.training.train_config import TrainConfig
from calibration.training.training_pairs import Pairs, draw_pairs
from edge.core.errors import GelgateError

__all__ = ["draw_step", "drawn_ahead"]

_DEPTH = 4
_PATIENCE_S = 5.0
_SENSORS = RandomSensors()

Packed = tuple[int, NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32], Spacing]


def draw_step(
    recipe: TrainConfig, step: int, device: torch.device, sensors: RandomSensors = _SENSORS
) -> Pairs:
    """The training batch of one step. sensors: how those of the batch are drawn."""
    return draw_pairs(
        recipe.seed,
        "train",
        step,
        pairs=recipe.pairs,
        side=recipe.side,
        device=device,
        high_resolution=recipe.high_resolution,
        effects=recipe.effects,
        sensors=sensors,
    )


@contextmanager
def drawn_ahead(recipe: TrainConfig, first: int) -> Iterator[Callable[[int], Pairs]]:
    """Gives the batches of the steps from `first` on, in order, on the CPU.

    Errors: GelgateError when the drawing process has died.
    """
    # A forked copy of torch's thread pool would hang.
    context = multiprocessing.get_context("spawn")
    batches: Queue[Packed] = context.Queue(_DEPTH)
    drawer = context.Process(target=_draw, args=(recipe, first, batches), daemon=True)
    drawer.start()

    def take(step: int) -> Pairs:
        while True:
            try:
                found, frames, surface, change, spacing = batches.get(timeout=_PATIENCE_S)
                break
            except queue.Empty:
                if not drawer.is_alive():
                    raise GelgateError(
                        f"the drawing process ended with exit code {drawer.exitcode} before step {step}; "
                        "resume, with --no-ahead if it happens again"
                    ) from None
        if found != step:
            raise GelgateError(f"drawn ahead was step {found}, wanted step {step}; resume the run")
        return Pairs(
            torch.from_numpy(frames).float(), torch.from_numpy(surface), torch.from_numpy(change), spacing
        )

    try:
        yield take
    finally:
        drawer.terminate()
        drawer.join()
        batches.close()


def _draw(recipe: TrainConfig, first: int, batches: "Queue[Packed]") -> None:
    """The drawing process: runs until the recipe's last step, or until the parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    parent = multiprocessing.parent_process()
    for step in range(first, recipe.steps):
        drawn = draw_step(recipe, step, torch.device("cpu"))
        # Frames are whole grey levels: nothing is lost in a byte.
        packed = (
            step,
            drawn.frames.byte().numpy(),
            drawn.surface_mm.numpy(),
            drawn.change_mm.numpy(),
            drawn.spacing,
        )
        while True:
            try:
                batches.put(packed, timeout=_PATIENCE_S)
                break
            except queue.Full:
                if parent is None or not parent.is_alive():
                    return
    # The queue's own thread sends what is still in the pipe before the process ends.
