"""Training pairs: the right differences, and no evaluation data."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from calibration.simulator import defects, parts, sensor_appearance
from calibration.simulator.field_of_view import LR, Field, grids
from calibration.simulator.pose import Pose, sample
from calibration.training import training_pairs
from calibration.training.losses import cell_distances, find_changed_cells, separation
from calibration.training.train_config import TrainConfig
from calibration.training.training_pairs import TRAINING_UNITS, Pairs, draw_pairs

SPACING = LR.mm_per_px


def pairs(step: int = 0, **changes: object) -> Pairs:
    settings: dict[str, object] = {"pairs": 3, "side": 64, "high_resolution": 0.0}
    return draw_pairs(0, "train", step, **(settings | changes))  # type: ignore[arg-type]


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


def test_no_evaluated_part_defect_scene_or_sensor_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """While training draws, the evaluated parts and defects, the scenes and the reserved sensor are not touched."""

    class Asked(dict[str, object]):
        """Remembers which keys were read."""

        def __getitem__(self, name: str) -> object:
            asked.append(name)
            return super().__getitem__(name)

    asked: list[str] = []
    for module, table in ((parts, "PARTS"), (defects, "DEFECTS"), (training_pairs, "SENSORS")):
        monkeypatch.setattr(module, table, Asked(vars(module)[table]))
    opened: list[str] = []
    monkeypatch.setattr(Path, "read_text", lambda path, **_: opened.append(str(path)))
    pairs(pairs=2)
    assert set(asked) == set(TRAINING_UNITS) < set(sensor_appearance.SENSORS)
    assert opened == []


def test_random_parts_are_not_the_evaluated_ones() -> None:
    """Of 64 random parts none has the height map of an analogue: all correlate below 0.95 at any quarter turn."""
    field = Field((48, 48), (0.3, 0.3))
    drawn = np.stack(
        [
            sample(training_pairs._draw_part(np.random.default_rng(k), 1.0), Pose(), field).ravel()
            for k in range(64)
        ]
    )
    drawn = (drawn - drawn.max(axis=1, keepdims=True)).clip(-0.6)
    drawn = drawn - drawn.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(drawn, axis=1) + 1e-9
    for geometry in (geometry for part in parts.PARTS.values() for geometry in part.positions.values()):
        known = sample(geometry, Pose(), field).clip(-0.6)
        for turn in range(4):
            flat = np.rot90(known - known.mean(), turn).ravel()
            assert (drawn @ flat / norms / np.linalg.norm(flat)).max() < 0.95


@pytest.mark.parametrize("kind", range(4))
def test_each_damage_changes_the_height_where_it_lies(kind: int) -> None:
    """Bell, flattened place, filled relief and rough patch: some of the middle changes, nothing at the far corner."""
    field = Field((64, 64), SPACING)
    x, y = grids(field)
    height = (0.1 * np.sin(3 * x)).astype(np.float32)

    class Chosen:
        """Draws of one kind."""

        def __init__(self) -> None:
            self.rng = np.random.default_rng(0)

        def choice(self, options: object, p: tuple[float, ...]) -> object:
            return kind if options == 4 else self.rng.choice(options, p=p)  # type: ignore[call-overload]

        def __getattr__(self, name: str) -> object:
            return getattr(self.rng, name)

    changed = training_pairs._add_defect(Chosen(), height, x, y, field, 0.3)  # type: ignore[arg-type]
    change = np.abs(changed - height)
    assert change[24:40, 24:40].max() > 0.003
    assert change[:4, :4].max() < 1e-6
