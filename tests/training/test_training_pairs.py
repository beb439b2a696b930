"""Training pairs: the right differences, effects that agree with the simulator's, and no evaluation data."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from calibration.simulator import gel, gel_surface, optics, sensor_appearance
from calibration.simulator.field_of_view import LR, Field, grids
from calibration.training import render
from calibration.training.losses import cell_distances, find_changed_cells, separation, window_cells
from calibration.training.random_parts import draw_parts
from calibration.training.random_sensors import TRAINING_UNITS, draws_for, under_dots
from calibration.training.train_config import TrainConfig
from calibration.training.training_pairs import Pairs, compress, draw_pairs

CPU = torch.device("cpu")
SPACING = LR.mm_per_px


def pairs(step: int = 0, **changes: object) -> Pairs:
    settings: dict[str, object] = {"pairs": 3, "side": 64, "device": CPU, "high_resolution": 0.0}
    return draw_pairs(0, "train", step, **(settings | changes))  # type: ignore[arg-type]


def imprint(field: Field) -> np.ndarray:
    """An obstacle with flats, steep flanks and a dome, in mm."""
    x, y = grids(field)
    block = np.clip(0.5 - np.maximum(abs(x + 3), abs(y - 1)) * 0.25, 0, 0.4)
    dome = np.sqrt(np.maximum(9.0 - (x - 3) ** 2 - (y + 1) ** 2, 0)) - 2.6
    groove = 0.15 * (np.sin(4 * x) > 0) * (y > 4)
    return np.maximum(np.maximum(block, dome), groove).astype(np.float32).clip(0)


def test_the_dots_of_a_tracking_gel_are_where_the_simulator_has_them() -> None:
    """On a flat gel the same cells are dark, to the farthest dot."""
    x, y = (torch.tensor(np.broadcast_to(axis, (240, 320))) for axis in grids(LR))
    flat = np.zeros((240, 320), np.float32)
    expected = gel_surface.markers(np.full((3, 240, 320), 100, np.float32), flat, LR)

    planes = torch.full((1, 3, 240, 320), 100.0)
    found = under_dots(planes, torch.from_numpy(flat)[None], x, y, SPACING)

    assert expected.min() < 30
    np.testing.assert_allclose(found[0].numpy(), expected, atol=0.1)


@pytest.mark.parametrize("field", [LR, Field((320, 256), (0.02, 0.026))])
def test_the_gel_agrees_with_the_simulator(field: Field) -> None:
    """On one height map the two surfaces differ by at most 2 micrometres."""
    obstacle = imprint(field)
    expected = gel.deformation(obstacle, field)
    found = render.deform(torch.from_numpy(obstacle)[None], field.mm_per_px)[0].numpy()
    assert np.abs(found - expected).max() < 0.002


def test_light_agrees_with_the_simulator() -> None:
    """On one surface and appearance, slopes agree to 1e-5, lit planes to 0.01 and shadows and gloss to 1 grey level."""
    surface = gel.deformation(imprint(LR), LR)
    z = torch.from_numpy(surface)[None]
    nx, ny = optics.normals(surface, LR)
    fx, fy = render.normals(*render.slopes(z, SPACING))
    assert np.abs(fx[0].numpy() - nx).max() < 1e-5
    assert np.abs(fy[0].numpy() - ny).max() < 1e-5

    unit = sensor_appearance.SENSORS["unit_a"]
    u, v = sensor_appearance.unit_grids(LR)
    u, v = torch.tensor(u.tolist()), torch.tensor(v.tolist())
    free = render.free_gel(torch.tensor(unit.free_gel.tolist())[None], u, v)
    assert np.abs(free[0].numpy() - sensor_appearance.background(unit, LR)).max() < 0.01
    answers = torch.tensor(unit.slope_response.tolist())[None]
    per = render.per_normal(answers, u, v)
    lit = render.shade(fx, fy, render.BatchAppearance(free, per, answers[:, :, 12:]))
    expected = optics.illumination(
        nx,
        ny,
        sensor_appearance.background(unit, LR),
        sensor_appearance.response(unit, LR),
        unit.slope_response[:, 12:].astype(np.float32),
    )
    assert np.abs(lit[0].numpy() - expected).max() < 0.01

    shaded = optics.shadows(expected.copy(), surface, LR)
    found = render.shadows(lit, z, torch.tensor([0.65]), SPACING)
    assert np.abs(found[0].numpy() - shaded).max() < 1.0
    glossy = optics.specular(expected.copy(), nx, ny)
    found = render.gloss(lit, fx, fy, torch.tensor([22.0]))
    assert np.abs(found[0].numpy() - glossy).max() < 1.0


def test_a_batch_is_a_function_of_seed_purpose_and_step() -> None:
    """Equal words give equal bytes; another step or purpose gives other frames."""
    first = pairs(1)
    assert torch.equal(first.frames, pairs(1).frames)
    assert not torch.equal(first.frames, pairs(2).frames)
    other = draw_pairs(0, "validate", 1, pairs=3, side=64, device=CPU, high_resolution=0.0)
    assert not torch.equal(first.frames, other.frames)


def test_frames_are_whole_grey_levels_with_contact_and_damage() -> None:
    """Whole numbers 0 to 255, neither black nor blown out; every view touches, and some damage changes the imprint."""
    batch = pairs(0, pairs=8)
    assert torch.equal(batch.frames, batch.frames.round().clamp(0, 255))
    assert 30 < batch.frames.mean() < 200
    assert (batch.surface_mm.amax(dim=(1, 2)) > 0.02).all()
    changed = (batch.change_mm > 0.02).flatten(1).any(dim=1)
    assert int(changed.sum()) >= 2
    assert (batch.change_mm >= 0).all()
    assert torch.isfinite(batch.frames).all()


def test_a_frame_is_sent_as_jpeg() -> None:
    """A grey frame stays; a drawn one changes by some levels, by more the lower the quality, and colours stay."""
    grey = torch.full((3, 32, 32), 119.0)
    assert torch.equal(compress(grey, 75), grey)
    frame = pairs(3, pairs=1).frames[0]
    fine, coarse = (compress(frame, quality) - frame for quality in (95, 60))
    assert 0 < fine.abs().mean() < coarse.abs().mean() < 5
    assert coarse.mean(dim=(1, 2)).abs().max() < 1


def test_fine_spacings_are_drawn_when_requested() -> None:
    """A high-resolution batch has 0.0145 to 0.045 mm per pixel, square or squeezed 16:9."""
    for step in range(4):
        x, y = pairs(step, pairs=1, high_resolution=1.0).spacing
        assert 0.0145 <= x <= 0.045
        assert math.isclose(y / x, 1.0) or math.isclose(y / x, 4 / 3)


def test_changed_and_unfind_changed_cells_never_meet() -> None:
    """One changed pixel marks its cell; its neighbours are neither changed nor unchanged."""
    change = torch.zeros(1, 32, 32)
    change[0, 9, 9] = 0.1
    changed, unchanged = find_changed_cells(change, 8, TrainConfig.shipped())
    assert changed[0].nonzero().tolist() == [[1, 1]]
    assert unchanged[0].sum() == 16 - 9
    distance = torch.zeros(1, 4, 4)
    distance[0, 1, 1] = 1.0
    assert separation(distance, changed, unchanged) == 1.0
    assert separation(-distance, changed, unchanged) == 0.0
    assert math.isnan(separation(distance, torch.zeros_like(changed), unchanged))


def test_euclidean_distances_are_in_units_of_the_features_own_length() -> None:
    """Features 1 and 7 times a vector are 6 of 5 root mean squares apart, whatever the vector's length."""
    first = torch.ones(1, 4, 2, 2)
    for scale in (1e-3, 1.0, 1e3):
        found = cell_distances(scale * torch.cat([first, 7 * first]))
        assert torch.allclose(found, torch.full_like(found, 6 / 5), atol=1e-5)


def test_a_shift_within_the_window_costs_nothing() -> None:
    """A cell moved by one column is found at distance 0 one column away, not beyond the window nor outside the map."""
    cells = torch.rand(2, 8, 6, 6, generator=torch.Generator().manual_seed(0))
    moved = torch.cat([cells, cells.roll(1, 3)])
    assert float(cell_distances(moved, (0, 1))[:, :, 1:].max()) < 2e-3
    assert float(cell_distances(moved, (1, 0)).min()) > 0.1
    # Values that left at the right came in at the left, where they have no neighbour within one column.
    assert float(cell_distances(moved, (0, 1))[:, :, 0].min()) > 0.1


@pytest.mark.parametrize("reach", [(0, 0), (1, 2), (3, 0)])
def test_distances_agree_with_a_search_in_float64(reach: tuple[int, int]) -> None:
    """The distances equal those of a search over every place of the window."""
    features = torch.rand(4, 6, 5, 7, generator=torch.Generator().manual_seed(1))
    found = cell_distances(features, reach).numpy()
    wide = features.double().numpy()
    first, second = np.split(wide / np.sqrt((wide**2).sum(axis=1).mean()), 2)
    for n, row, column in np.ndindex(*found.shape):
        rows = slice(max(0, row - reach[0]), row + reach[0] + 1)
        columns = slice(max(0, column - reach[1]), column + reach[1] + 1)
        apart = first[n, :, rows, columns] - second[n, :, row, column, None, None]
        nearest = np.sqrt((apart**2).sum(axis=0).min() + 1e-6)
        assert abs(found[n, row, column] - nearest) < 1e-5


def test_the_window_keeps_its_width_in_mm() -> None:
    """Half a millimetre is two cells of layer1 at 320x240, one of layer2, none of layer3; three at most anywhere."""
    found = [window_cells(0.5, stride, (0.0634, 0.0634)) for stride in (4, 8, 16)]
    assert found == [(2, 2), (1, 1), (0, 0)]
    assert window_cells(0.5, 4, (0.045, 0.06)) == (2, 3)
    assert window_cells(0.5, 4, (0.015, 0.02)) == (3, 3)


def test_no_evaluated_part_scene_or_sensor_is_drawn(tmp_path: Path) -> None:
    """While training draws, no scene file is opened and no part, defect, sensor or development part is touched."""
    program = """
import sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == 'open' else None)
from calibration.simulator import defects, parts, random_parts, sensor_appearance
def forbidden(*args, **kwargs):
    raise AssertionError('evaluation geometry was drawn in training')
class Guarded(dict):
    __getitem__ = get = values = items = __iter__ = forbidden
parts.PARTS = Guarded(); defects.DEFECTS = Guarded()
for name in ('_thread', '_connector', '_grooves', '_bracket', '_pinion', 'specimen'):
    assert hasattr(parts, name)
    setattr(parts, name, forbidden)
for name in [n for n in vars(random_parts) if n.startswith('_') and callable(getattr(random_parts, n))]:
    setattr(random_parts, name, forbidden)
random_parts.random_part = random_parts.RandomPart = forbidden
asked = []
class Units(dict):
    def __getitem__(self, name):
        asked.append(name)
        return dict.__getitem__(self, name)
import calibration.training.random_sensors as sensors
import calibration.training.training_pairs as presses
sensors.SENSORS = Units(sensor_appearance.SENSORS)
import torch
presses.draw_pairs(0, 'train', 0, pairs=2, side=64, device=torch.device('cpu'))
assert set(asked) == {'unit_a', 'unit_b'}, asked
assert not [name for name in opened if '/scenes/' in name], opened
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert set(TRAINING_UNITS) < set(sensor_appearance.SENSORS)


def test_random_parts_are_not_the_evaluated_ones() -> None:
    """Of 64 random parts none has the height map of an analogue or of one of six development parts: all correlate below
    0.95 at any quarter turn."""
    from calibration.simulator.parts import PARTS
    from calibration.simulator.pose import Pose, sample
    from calibration.simulator.random_parts import random_part

    field = Field((48, 48), (0.3, 0.3))
    x, y = (torch.tensor(grid.tolist()).expand(64, 48, 48) for grid in grids(field))
    drawn = draw_parts(draws_for(0, "train", 0, CPU), 64, 14.2).height(x, y)
    drawn = (drawn - drawn.amax(dim=(1, 2), keepdim=True)).clamp(min=-0.6).numpy().reshape(64, -1)
    drawn = drawn - drawn.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(drawn, axis=1) + 1e-9
    evaluated = [geometry for part in PARTS.values() for geometry in part.positions.values()]
    for geometry in evaluated + [random_part(np.random.default_rng([99, number])) for number in range(6)]:
        known = sample(geometry, Pose(), field).clip(-0.6)
        for turn in range(4):
            flat = np.rot90(known - known.mean(), turn).ravel()
            assert (drawn @ flat / norms / np.linalg.norm(flat)).max() < 0.95
