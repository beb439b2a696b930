"""Effects cost time only when a scene names them, and each one changes the picture."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest

from calibration.simulator import dataset_writer, plan, record
from calibration.simulator.effects import DEFAULT_EFFECTS, EFFECTS, check_effects
from calibration.simulator.field_of_view import LR, Field
from calibration.simulator.parts import PARTS
from calibration.simulator.plan import recording_plan
from calibration.simulator.pose import Jitter, Pose, sample
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.scene import Scene, load_scene
from calibration.simulator.streams import Streams

SMALL = Field((160, 120), (0.12, 0.12))
THREAD = PARTS["PZ1"].positions["pos1"]
KEY = ("PZ1", "pos1", 1, 1)


class Listening:
    """Streams that record the requested words."""

    def __init__(self) -> None:
        self.asked: list[tuple[str | int, ...]] = []
        self._inner = Streams(7)

    def __call__(self, *words: str | int) -> np.random.Generator:
        self.asked.append(words)
        return self._inner(*words)

    def __hash__(self) -> int:
        return id(self)


def picture(names: tuple[str, ...], streams: Callable[..., np.random.Generator] | None = None) -> np.ndarray:
    """A press on which every effect acts: worn gel, a previous press, a warm lamp, a slide."""
    renderer = Renderer(SMALL, names, streams=streams or Streams(7))
    placed = renderer.place(Pose(), KEY)
    imprint = renderer.imprint(sample(THREAD, placed, SMALL), 0.5 * placed.depth_factor)
    surface = renderer.surface(imprint, 500, (np.roll(imprint, 25, axis=1), 0.5))
    return renderer.expose(renderer.light(surface, 500), KEY, Exposure(3, 5.0, (12.0, 6.0)))


def without(name: str) -> tuple[str, ...]:
    return tuple(other for other in EFFECTS if other != name)


SCENE = """version = 1
name = "every"
part = "PZ5"
effects = {effects}
[camera]
modes = ["lr"]
fps = 8
[motion]
idle_s = 0.25
approach_s = 0.125
settle_s = 0.125
hold_s = 0.125
tail_s = 0.125
[[runs]]
name = "line"
presses = 2
faulty = 1
"""


def everything(scene: Scene) -> list[bytes]:
    """Bytes of one press by the renderer, one of a dataset, and one of a damaged piece in a recording."""
    plans = recording_plan(scene, scene.runs[0], 7, 1.0)
    pictures = [picture(scene.effects).tobytes()]
    pictures += [rgb.tobytes() for _, rgb in dataset_writer.press_pictures(scene, plans[0], 7)]
    return pictures + [payload for _, payload, _ in record.press_frames(scene, 7, 1, 5, plans[1], plans[0])]


@pytest.mark.parametrize("name", EFFECTS)
def test_left_out_it_is_not_called(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Renderer, dataset and recording make what they make in a program without its function."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.format(effects=list(without(name))))
    scene = load_scene(path)

    def gone(*_: object) -> object:
        raise AssertionError(f"{name} does not exist")

    function = EFFECTS[name]
    assert isinstance(function, FunctionType)
    monkeypatch.setattr(sys.modules[function.__module__], function.__name__, gone)
    for cached in (dataset_writer._renderer, record._renderer, plan._damage):
        cached.cache_clear()
    assert all(everything(scene))


@pytest.mark.parametrize("name", EFFECTS)
def test_switching_an_effect_never_shifts_another_ones_random_numbers(name: str) -> None:
    """Without it, exactly its own streams are not requested; every other stream has the same words."""
    everything, rest = Listening(), Listening()
    picture(tuple(EFFECTS), everything)
    picture(without(name), rest)
    own = [words for words in everything.asked if words[0] == name]
    assert [words for words in everything.asked if words not in own] == rest.asked


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_that_is_named_changes_the_picture(name: str) -> None:
    """With all others on, adding it changes bytes, so every name in the list has an effect."""
    assert not np.array_equal(picture(tuple(EFFECTS)), picture(without(name)))


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    """Equal streams, equal bytes; the order of the names does not matter."""
    again = picture(tuple(reversed(EFFECTS)))
    assert np.array_equal(picture(tuple(EFFECTS)), again)
    assert not np.array_equal(again, picture(tuple(EFFECTS), Streams(8)))


def test_an_unknown_effect_is_refused_with_the_nearest_name() -> None:
    """Misspelt names are reported together, each with the nearest known one."""
    with pytest.raises(ValueError, match=r"did you mean 'noise'.* did you mean 'shadows'"):
        check_effects(["shadow", "nois"])


def test_neighbouring_frames_differ_by_noise_alone() -> None:
    """Two exposures of the same light differ a little everywhere."""
    renderer = Renderer(LR, DEFAULT_EFFECTS)
    light = renderer.light(renderer.surface(np.zeros(LR.shape, np.float32)))
    first, second = (
        renderer.expose(light, KEY, Exposure(k, 100.0, (0.0, 0.0))).astype(np.int16) for k in (0, 1)
    )
    difference = np.abs(first - second)
    assert 0.5 < difference.mean() < 4
    assert difference.max() < 30
    filmed = renderer.film(light, (KEY, ("another", 1)), Exposure(1, 100.0, (0.0, 0.0)))
    assert np.array_equal(next(filmed), second)
    assert np.array_equal(
        next(filmed), renderer.expose(light, ("another", 1), Exposure(1, 100.0, (0.0, 0.0)))
    )


def test_pose_jitter_has_the_given_size() -> None:
    """Over many presses the shift's standard deviation is the stated one, cut at 2.5."""
    renderer = Renderer(SMALL, ("pose_jitter",), jitter=Jitter(0.2, 1.0, 0.5, 0.05))
    poses = [renderer.place(Pose(), (k,)) for k in range(400)]
    shifts = np.array([placed.shift_mm for placed in poses])
    assert 0.17 < shifts.std() < 0.23
    assert np.abs(shifts).max() <= 0.5 + 1e-9
    assert abs(np.mean([placed.depth_factor for placed in poses]) - 1) < 0.01


def test_partial_contact_lifts_one_side_of_a_part() -> None:
    """A tilted flat plate has contact on one side only; a level one has contact everywhere."""

    def plate(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(np.maximum(np.abs(x), np.abs(y)) < 5, np.float32(0), np.float32(-3))

    level, leaning = (
        (renderer.imprint(sample(plate, renderer.place(Pose(), KEY), SMALL), 0.05) > 0).mean()
        for renderer in (Renderer(SMALL, ()), Renderer(SMALL, ("partial_contact",)))
    )
    assert 0.3 * level < leaning < 0.95 * level
