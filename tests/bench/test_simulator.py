"""The cost and the change of each effect, and frames per second for each set of effects.

The cost of an effect is the processor time of a press with all effects less that without it; what it changes is the
mean absolute difference of the two pictures in grey levels. One thread, least of several rounds in turn.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from calibration.simulator.effects import DEFAULT_EFFECTS, EFFECTS
from calibration.simulator.field_of_view import HR, LR, Field, native_field
from calibration.simulator.parts import PARTS
from calibration.simulator.plan import recording_plan
from calibration.simulator.pose import Pose, sample
from calibration.simulator.record import press_frames
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.scene import load_scene
from edge.core.arrays import U8

_PART = PARTS["PZ3"].positions["pos1"]
_DEPTH_MM, _WORN = 0.4, 600
SETS = {
    "none": (),
    "shape and light": ("deformation", "illumination"),
    "default": DEFAULT_EFFECTS,
    "all": tuple(EFFECTS),
}


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


@pytest.mark.bench
def test_frames_a_second_for_each_effect_set() -> None:
    """Budget on two cores: 20 LR and 3 HR frames a second with the default effects; printed, not asserted."""
    with one_thread():
        print("\nframes per second of one processor (every frame another press)")
        print(f"{'effects':<18}" + "".join(f"{name:>14}" for name in ("320x240", "1280x720", "native/4")))
        columns = []
        for field in (LR, HR, native_field()):
            renderers = [Renderer(field, effects) for effects in SETS.values()]
            works = [lambda k, r=renderer: press(r, k) for renderer in renderers]  # type: ignore[misc]
            columns.append([1000 / ms for ms in best_ms(*works)])
        for name, *rates in zip(SETS, *columns, strict=True):
            print(f"{name:<18}" + "".join(f"{rate:>14.1f}" for rate in rates))


@pytest.mark.bench
@pytest.mark.parametrize("field", [LR, HR], ids=["320x240", "1280x720"])
def test_what_each_effect_costs_and_changes(field: Field) -> None:
    """The time of each effect and its change of the picture."""
    with one_thread():
        names = tuple(EFFECTS)
        renderers = [Renderer(field, names)]
        renderers += [Renderer(field, tuple(other for other in names if other != name)) for name in names]
        whole, *rest = best_ms(*[lambda k, r=renderer: press(r, k) for renderer in renderers])  # type: ignore[misc]
        print(f"\n{field.size[0]}x{field.size[1]}: all effects {whole:.1f} ms")
        print(f"{'effect':<18}{'ms':>8}{'share':>8}{'levels changed':>16}")
        picture = press(renderers[0], 1).astype(np.float32)
        for name, less, renderer in zip(names, rest, renderers[1:], strict=True):
            change = np.abs(picture - press(renderer, 1)).mean()
            print(f"{name:<18}{whole - less:>8.2f}{(whole - less) / whole:>8.1%}{change:>16.2f}")


@pytest.mark.bench
def test_a_recordings_frames_a_second() -> None:
    """The demo's native frames with complete press motions, camera bytes included, one thread."""
    scene = load_scene("demo")
    plans = recording_plan(scene, scene.runs[1], 0, 0.8)
    with one_thread():
        list(press_frames(scene, 0, 0, 0, plans[0], None))
        start = time.process_time()
        frames = sum(len(list(press_frames(scene, 0, k, 100 * k, plans[k], plans[k - 1]))) for k in (1, 2, 3))
        print(
            f"\ndemo recording: {frames / (time.process_time() - start):.1f} native frames per second of one processor"
        )
