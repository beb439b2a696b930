"""Ideas for real touch: each changes one thing of a batch, real frames give pairs, further losses reach the trunk."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from calibration.benchmark.idea_frames import FREE_GELS, PRESSES, free_gels, presses
from calibration.benchmark.idea_lessons import LESSONS
from calibration.benchmark.idea_losses import Distilled, NextToPhotograph, RealPairs, real_pairs, together
from calibration.benchmark.idea_sensors import (
    RealGels,
    RealNoise,
    differences_to_free_gel,
    other_dots,
    other_units,
    wandering_gains,
)
from calibration.benchmark.ideas import BASE, IDEAS
from calibration.benchmark.sets import SENSORS
from calibration.simulator.constants import DOT_PITCH_MM, DOT_RADIUS_MM
from calibration.training.network import TrunkNetwork
from calibration.training.prefetch import draw_step
from calibration.training.random_sampling import Draws, draws_for
from calibration.training.random_sensors import RandomSensors, appearance, gains
from calibration.training.train_config import EFFECTS, TrainConfig
from calibration.training.training_pairs import Pairs
from edge.core.errors import DatasetError

CPU = torch.device("cpu")
TINY = TrainConfig.shipped(
    steps=1,
    pairs=5,
    side=64,
    precision="float32",
    stages=1,
    effects=tuple(name for name in EFFECTS if name != "pose_jitter"),
)
RED = np.full((240, 320, 3), (240, 5, 5), np.float32)


def draws() -> Draws:
    return draws_for(0, "test", 0, CPU)


def pictures() -> list[np.ndarray]:
    """Two noisy grey pictures."""
    rng = np.random.default_rng(0)
    return [np.float32(120) + rng.normal(0, 3, (240, 320, 3)).astype(np.float32) for _ in range(2)]


@pytest.fixture(scope="module")
def usual() -> Pairs:
    """The batch of the base."""
    return draw_step(TINY, 0, CPU)


@pytest.mark.parametrize(
    "sensors",
    [
        RandomSensors(appearance=other_units),
        RandomSensors(gains=wandering_gains),
        RandomSensors(dots=other_dots),
        RandomSensors(appearance=RealGels([RED])),
        RandomSensors(noise=RealNoise([RED + np.arange(320, dtype=np.float32)[:, None] % 7])),
    ],
    ids=["units", "exposure", "dots", "gels", "noise"],
)
def test_other_sensors_change_nothing_but_the_frames(sensors: RandomSensors, usual: Pairs) -> None:
    """The parts, presses and damage of the batch are those of the base."""
    found = draw_step(TINY, 0, CPU, sensors)

    assert torch.equal(found.surface_mm, usual.surface_mm)
    assert torch.equal(found.change_mm, usual.change_mm)
    assert not torch.equal(found.frames, usual.frames)


@pytest.mark.parametrize(
    ("other", "own", "given"),
    [
        (other_units, appearance, (4, torch.zeros(8, 8), torch.zeros(8, 8))),
        (RealGels([RED]), appearance, (4, torch.zeros(8, 8), torch.zeros(8, 8))),
        (wandering_gains, gains, (4,)),
        (other_dots, RandomSensors().dots, (4,)),
        (
            RealNoise([RED + np.arange(320, dtype=np.float32)[:, None] % 7]),
            RandomSensors().noise,
            (2, 3, 8, 8),
        ),
    ],
    ids=["units", "gels", "exposure", "dots", "noise"],
)
def test_what_is_drawn_next_is_the_base_s(
    other: Callable[..., object], own: Callable[..., object], given: Any
) -> None:
    """What another sensor adds comes from a stream of its own, and what it replaces is drawn all the same."""
    one, base = draws(), draws()
    other(one, *given)
    own(base, *given)

    assert torch.equal(one.uniform(0, 1, 5), base.uniform(0, 1, 5))


def test_other_dots_change_the_marker_gels_alone(usual: Pairs) -> None:
    """One pair in five has dots; the frames of the other four are those of the base."""
    found = draw_step(TINY, 0, CPU, RandomSensors(dots=other_dots))

    same = [torch.equal(a, b) for a, b in zip(found.frames, usual.frames, strict=True)]
    assert same == 2 * [False, True, True, True, True]


def test_other_units_answer_more_strongly_on_the_same_free_gel() -> None:
    """Each gel's answer is 1 to 1.7 times the base's, the same for every colour and place."""
    at = torch.linspace(-1, 1, 8).expand(8, 8)
    usual, found = appearance(draws(), 20, at, at.T), other_units(draws(), 20, at, at.T)

    times = (found.per_normal / usual.per_normal).flatten(1)
    assert torch.equal(found.free, usual.free)
    assert times.min() >= 0.999
    assert times.max() <= 1.701
    assert times.mean(dim=1).std() > 0.05
    assert (times - times.mean(dim=1, keepdim=True)).abs().max() < 1e-3
    torch.testing.assert_close((found.curvature / usual.curvature).mean(dim=(1, 2)), times.mean(dim=1))


def test_exposure_wanders_by_up_to_a_fifth() -> None:
    """More than the lamps drift, and colours together: at most a quarter."""
    wander = (wandering_gains(draws(), 400) / gains(draws(), 400)).log()

    assert 0.15 < wander.abs().max() <= 0.25
    assert torch.corrcoef(wander.T).min() > 0.9


def test_the_dots_of_other_gels_have_any_pitch_and_offset() -> None:
    """Pitch and radius about the maker's; the offset is less than half a pitch."""
    found = other_dots(draws(), 200)

    pitch = found.pitch / torch.tensor(DOT_PITCH_MM)
    radius = found.radius / DOT_RADIUS_MM
    assert 0.6 <= pitch.min() < 0.7
    assert 1.3 < pitch.max() <= 1.5
    assert 0.5 <= radius.min() < 0.6
    assert 1.2 < radius.max() <= 1.4
    assert (found.offset.abs() <= found.pitch / 2).all()
    assert found.offset.std() > 0.1


def test_half_of_the_gels_are_real() -> None:
    """Of forty gels some ten to thirty have the colour of the picture, and all answer to a slope as before."""
    at = torch.linspace(-1, 1, 8).expand(8, 8)
    found, usual = (make(draws(), 40, at, at.T) for make in (RealGels([RED]), appearance))

    level = found.free.mean(dim=(2, 3))
    is_real = level[:, 0] > 20 * level[:, 1]
    assert 10 <= is_real.sum() <= 30
    assert torch.equal(found.free[~is_real], usual.free[~is_real])
    assert torch.equal(found.per_normal, usual.per_normal)


def test_real_noise_has_the_grain_of_the_pictures() -> None:
    """Vertical stripes, of unit deviation, in place of white noise."""
    stripes = np.broadcast_to(100 + 5.0 * (np.arange(320) % 2)[None, :, None], (240, 320, 3))
    found = RealNoise([stripes.astype(np.float32)])(draws(), 6, 3, 64, 64)

    assert found.shape == (6, 3, 64, 64)
    assert found.std().item() == pytest.approx(1, abs=0.05)
    assert torch.equal(found[:, :, :1].expand_as(found), found)


def test_a_difference_to_the_free_gel_is_grey_where_nothing_touches() -> None:
    """The light of every gel is gone: the medians of the frames are within a few levels of 128."""
    found, usual = differences_to_free_gel(TINY, 0, CPU), draw_step(TINY, 0, CPU)

    assert torch.equal(found.change_mm, usual.change_mm)
    middle = [batch.frames.flatten(2).median(dim=2).values for batch in (found, usual)]
    assert (middle[0] - 128).abs().mean() < 10 < (middle[1] - 128).abs().mean()


def test_a_pair_of_real_crops_differs_by_light_and_small_edits() -> None:
    """Whole grey levels, equal for a seed and step; most cells are unchanged, and some changed."""
    one, again, later = (real_pairs(pictures(), TINY, step, 6) for step in (0, 0, 1))

    assert one.frames.shape == (12, 3, 64, 64)
    assert torch.equal(one.frames, again.frames)
    assert not torch.equal(one.frames, later.frames)
    assert torch.equal(one.frames, one.frames.round())
    changed = (one.change_mm > TINY.changed_mm).float().mean()
    assert 0.005 < changed < 0.3
    level = one.frames.mean(dim=(2, 3))
    assert (level[:6] - level[6:]).abs().mean() > 3


def test_a_small_edit_looks_like_a_bump_under_the_sensor_s_lights() -> None:
    """Where the partner is edited, the two crops differ more than light and noise do."""
    found = real_pairs([np.full((240, 320, 3), 120, np.float32)], TINY, 0, 12)

    first, second = found.frames.chunk(2)
    apart = (second - first - (second - first).mean(dim=(2, 3), keepdim=True)).abs().mean(dim=1)
    assert apart[found.change_mm > 0.03].mean() > 1.5 * apart[found.change_mm < 0.001].mean()


@pytest.fixture
def batch() -> tuple[TrunkNetwork, list[Tensor], Pairs]:
    """A trunk with its maps of a batch."""
    torch.manual_seed(0)
    trunk, drawn = TrunkNetwork(1), draw_step(TINY, 0, CPU)
    return trunk, trunk(drawn.frames), drawn


def slope_of(loss: Tensor, trunk: TrunkNetwork) -> float:
    loss.backward()
    return float(trunk.conv1.weight.grad.abs().max())


def test_real_pairs_teach_the_trunk(batch: tuple[TrunkNetwork, list[Tensor], Pairs]) -> None:
    """The loss of the real crops is finite and has a slope; it holds no weight of its own."""
    lesson = RealPairs(pictures(), TINY, 2)

    assert 0 < slope_of(lesson(*batch, 0), batch[0]) < np.inf
    assert not list(lesson.state_dict())


def photographs(frames: Tensor) -> Tensor:
    """In place of EfficientNet-Lite0: 24 equal channels, the mean level of a cell."""
    return torch.nn.functional.avg_pool2d(frames.mean(dim=1, keepdim=True), 4).expand(-1, 24, -1, -1)


@pytest.mark.parametrize("lesson", [NextToPhotograph(TINY, 2.0, photographs), Distilled(photographs)])
def test_photographs_teach_the_trunk(
    lesson: torch.nn.Module, batch: tuple[TrunkNetwork, list[Tensor], Pairs]
) -> None:
    """The loss next to the network of photographs, or of reading it, has a slope."""
    assert 0 < slope_of(lesson(*batch, 0), batch[0]) < np.inf


def test_next_to_photographs_the_tactile_channels_weigh_half(
    batch: tuple[TrunkNetwork, list[Tensor], Pairs],
) -> None:
    """Over all channels, whatever the trunk's own scale is."""
    _, maps, drawn = batch
    found = together(7 * maps[0].detach(), photographs(drawn.frames), 2.0)

    deviation = [float(part.var(dim=(0, 2, 3)).sum().sqrt()) for part in found.split([64, 24], dim=1)]
    assert deviation[1] == pytest.approx(2 * deviation[0], rel=1e-3)


def test_every_idea_has_a_lesson() -> None:
    """The names of the table are those of the lessons, the base first."""
    assert list(LESSONS) == list(IDEAS)
    assert next(iter(IDEAS)) == BASE


def test_no_frame_is_of_a_sensor_that_is_measured() -> None:
    """What is learnt from is in neither set of real touch."""
    learnt = {name.partition("/")[0] for name in (*PRESSES, *(name for names in FREE_GELS for name in names))}

    assert learnt
    assert not learnt & {sensor for of in SENSORS.values() for sensor in of}


def test_real_frames_are_read_at_one_scale(real_tactile: Path) -> None:
    """320x240 in grey levels; what three presses of one gel hide is filled in without their edges."""
    gels, pressed = free_gels(real_tactile), presses(real_tactile)

    assert [len(gels), len(pressed)] == [len(FREE_GELS), len(PRESSES)]
    assert {rgb.shape for rgb in (*gels, *pressed)} == {(240, 320, 3)}
    edges = [float(np.abs(np.diff(rgb, axis=0)).max()) for rgb in (gels[2], *pressed[:2])]
    assert edges[0] < min(edges[1:]) / 3


def test_absent_frames_are_a_sentence(tmp_path: Path) -> None:
    """Of free gels and of presses."""
    for read in (free_gels, presses):
        with pytest.raises(DatasetError, match=r"is not there; fetch the real tactile frames again"):
            read(tmp_path)
