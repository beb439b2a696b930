"""What each effect of the simulator costs: processor time of a press with every effect less that without one."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from calibration.simulator.effects import EFFECTS
from calibration.simulator.field_of_view import LR, Field
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Pose, sample
from calibration.simulator.renderer import U8, Exposure, Renderer

__all__ = ["best_ms", "effect_costs", "one_thread", "press"]

_PART = PARTS["PZ3"].positions["pos1"]
_DEPTH_MM, _WORN = 0.4, 600


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV in one thread, so that processor time is comparable."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def best_ms(*works: Callable[[int], object], rounds: int = 10) -> list[float]:
    """The smallest processor time of each in ms, measured in turn under equal conditions, after one turn to warm up."""
    best = [float("inf")] * len(works)
    for k in range(rounds + 1):
        for which, work in enumerate(works):
            start = time.process_time()
            work(k)
            if k:
                best[which] = min(best[which], time.process_time() - start)
    return [1000 * seconds for seconds in best]


def press(renderer: Renderer, k: int) -> U8:
    """One press on a worn gel, with a residual imprint, warm lamps and a slide."""
    key = ("bench", k)
    placed = renderer.place(Pose(), key)
    imprint = renderer.imprint(sample(_PART, placed, renderer.field), _DEPTH_MM * placed.depth_factor)
    surface = renderer.surface(imprint, _WORN, (np.roll(imprint, imprint.shape[1] // 8, axis=1), 0.5))
    return renderer.expose(renderer.light(surface, _WORN), key, Exposure(0, 5.0, (4.0, 2.0)))


def effect_costs(field: Field = LR, rounds: int = 30) -> tuple[float, dict[str, float]]:
    """Processor time in ms of a press with every effect, and how much of it each effect takes."""
    names = tuple(EFFECTS)
    renderers = [Renderer(field, names)]
    renderers += [Renderer(field, [other for other in names if other != name]) for name in names]
    with one_thread():
        complete, *rest = best_ms(
            *[lambda k, r=renderer: press(r, k) for renderer in renderers],
            rounds=rounds,
        )
    return complete, {name: complete - less for name, less in zip(names, rest, strict=True)}
