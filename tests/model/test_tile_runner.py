"""A tiled trunk: one tile after the other, tiles without contact skipped, and every contact inspected."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from unittest.mock import Mock, patch

import numpy as np
import pytest
from command_line import ran
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from calibration.fitting.fit import FitConfig, Fitted, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk
from edge.core.errors import NotScorable
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.imaging.smoothing import smooth
from edge.core.imaging.tiles import tiling
from edge.model.bundle import Bundle
from edge.model.bundle_writer import write_bundle
from edge.model.graph_cut import cut_trunk
from edge.model.manifest import GridEntry
from edge.model.scorer import Scorer
from edge.model.session import open_session
from edge.model.tile_runner import FREE_LEVELS, FreeGel, TiledMaps, TileRunner, most_typical, untouched_tiles
from export.merge import merge_bundle
from plugins.backbones.tactile import tactile_resnet18
from plugins.backbones.tiled import tile_trunk
from plugins.detectors.padim import padim

SIZE = (160, 96)
TILES = tiling((96, 160), 64, 32)
"""Two rows and four columns of tiles; the presses touch the two columns on the left."""
UNTOUCHED = (2, 3, 6, 7)
TRUNK = tile_trunk(cut_trunk(tactile_resnet18.trunk(), ("layer2",)), TILES)
SESSION = open_session(TRUNK, 1, "trunk")
TOUCHED = np.zeros((96, 160), bool)
TOUCHED[10:80, 8:60] = True


def free_gel(n: int, seed: int) -> np.ndarray:
    """Frames of the untouched gel: a gradient and the camera's noise."""
    gel = np.linspace(90, 150, 160)[None, :, None] + np.linspace(0, 30, 96)[:, None, None] + np.zeros(3)
    rgb: np.ndarray = np.clip(
        gel + np.random.default_rng(seed).normal(0, 1.5, (n, 96, 160, 3)), 0, 255
    ).astype(np.uint8)
    return rgb


def presses(n: int, seed: int) -> np.ndarray:
    """The gel pressed on the left: the same relief each time."""
    rgb = free_gel(n, seed)
    relief = np.random.default_rng(3).integers(-40, 40, (70, 52, 3))
    rgb[:, 10:80, 8:60] = np.clip(rgb[:, 10:80, 8:60] + relief, 0, 255).astype(np.uint8)
    return rgb


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    nominal = NominalPresses(presses(8, 0), ("",) * 8, touched=TOUCHED, no_contact=free_gel(3, 1))
    config = FitConfig(
        part="pin",
        position="top",
        profile=SensorProfile("tiled", SIZE, (0.0, 0.0), SIZE, 1, 15.77),
        region=Region.full(SIZE),
        detector=padim,
        trunk=Trunk("tiled", TRUNK),
        overrides={"rank": 4, "channels": 16},
        folds=2,
    )
    return fit_files(nominal, config, created="2026-01-01")


@pytest.fixture(scope="module")
def bundle(fitted: Fitted) -> Bundle:
    return fitted.bundle()


def count_tiles() -> AbstractContextManager[Mock]:
    """Called for each tile that the trunk runs on."""
    return patch.object(TileRunner, "run", autospec=True, side_effect=TileRunner.run)


@pytest.fixture
def ran_tiles() -> Iterator[Mock]:
    with count_tiles() as ran_tiles:
        yield ran_tiles


MAPS = {"layer1": (64, 32, 64), "layer2": (128, 16, 32)}


def test_the_fit_writes_which_tiles_no_press_touches(bundle: Bundle) -> None:
    """The layout, the untouched tiles and a picture of the free gel are in the bundle."""
    assert bundle.manifest.grid is not None
    assert bundle.manifest.grid.tiles is not None
    assert bundle.manifest.grid.tiles.untouched == UNTOUCHED == untouched_tiles(TILES, TOUCHED)
    assert bundle.grid is not None
    assert bundle.grid.tiles == TILES
    assert bundle.free_gel is not None
    assert any((bundle.free_gel == smooth(frame)).all() for frame in free_gel(3, 1))


def test_a_skipped_tile_costs_nothing(bundle: Bundle, ran_tiles: Mock) -> None:
    """A nominal press runs the trunk on its four touched tiles of eight, alone and in a batch."""
    scorer = Scorer(bundle)
    for frames, runs in ((presses(1, 5), 4), (presses(3, 6), 12)):
        scorer.score_batch(frames)  # a new number of frames, new buffers
        ran_tiles.reset_mock()
        scorer.score_batch(frames)
        assert ran_tiles.call_count == runs
    whole = Scorer(bundle, is_skipping=False)
    ran_tiles.reset_mock()
    whole.score(presses(1, 5)[0])
    assert ran_tiles.call_count == 8


def test_beside_a_bundle_with_the_same_tiles_none_is_run(bundle: Bundle, ran_tiles: Mock) -> None:
    """Its mosaics serve both; another free gel would paste other features."""
    frame, other, scorer = presses(1, 8)[0], Scorer(bundle), Scorer(bundle)
    expected = other.score(frame)
    ran_tiles.reset_mock()

    found = scorer.score_beside(other, bundle.prepare(frame), None)

    assert not ran_tiles.called
    np.testing.assert_array_equal(found.score_map, expected.score_map)


def test_kept_tiles_score_the_same(bundle: Bundle) -> None:
    """Outside the blur's reach of skipped tiles the map is the same to the bit."""
    frame = presses(1, 7)[0]
    skipping, whole = Scorer(bundle).score(frame), Scorer(bundle, is_skipping=False).score(frame)
    np.testing.assert_array_equal(skipping.score_map[:, :32], whole.score_map[:, :32])
    assert skipping.score_map.max() == skipping.anomaly_score


@pytest.mark.parametrize("place", [(2, 130), (60, 100), (90, 155), (40, 70)], ids=str)
def test_a_contact_where_none_belongs_is_seen(bundle: Bundle, place: tuple[int, int]) -> None:
    """A press that touches a tile without nominal contact scores as if no tile were skipped. Checked by removal: with
    `matching` answering all untouched tiles, the foreign contact scores like a nominal press."""
    row, column = place
    odd = presses(1, 5)[0]
    plain = Scorer(bundle).score(odd).anomaly_score
    odd[max(0, row - 4) : row + 4, max(0, column - 4) : column + 4] = 20
    skipping, whole = Scorer(bundle).score(odd), Scorer(bundle, is_skipping=False).score(odd)
    assert skipping.anomaly_score > 1.5 * plain
    np.testing.assert_allclose(skipping.anomaly_score, whole.anomaly_score, rtol=1e-6)
    assert np.unravel_index(skipping.score_map.argmax(), (96, 160)) == np.unravel_index(
        whole.score_map.argmax(), (96, 160)
    )


def test_a_foreign_contact_leaves_no_trace(bundle: Bundle) -> None:
    """The press after it scores as it would have scored before."""
    scorer, plain = Scorer(bundle), presses(1, 5)[0]
    before = scorer.score(plain)
    odd = plain.copy()
    odd[20:40, 120:140] = 20
    scorer.score(odd)
    after = scorer.score(plain)
    np.testing.assert_array_equal(after.score_map, before.score_map)


def test_a_run_that_fails_leaves_no_trace(bundle: Bundle, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it had written the features of a touched tile before, the next press has those of the free gel again."""
    scorer, plain = Scorer(bundle), presses(1, 5)[0]
    before, run = scorer.score(plain), TileRunner.run

    def fail(self: TileRunner, frame: np.ndarray, index: int, into: Mapping[str, np.ndarray]) -> None:
        if index == 4:
            raise RuntimeError("no memory")
        run(self, frame, index, into)

    odd = plain.copy()
    odd[20:40, 120:140] = 20  # in tiles 2 and 3
    monkeypatch.setattr(TileRunner, "run", fail)
    with pytest.raises(NotScorable, match="no memory"):
        scorer.score(odd)
    monkeypatch.undo()

    np.testing.assert_array_equal(scorer.score(plain).score_map, before.score_map)


def test_another_light_skips_nothing(bundle: Bundle, ran_tiles: Mock) -> None:
    """A level change above the bound costs time, but every tile is run."""
    scorer = Scorer(bundle)
    ran_tiles.reset_mock()
    scorer.score(np.clip(presses(1, 5)[0].astype(int) + int(FREE_LEVELS), 0, 255).astype(np.uint8))
    assert ran_tiles.call_count == 8


def test_a_press_scores_the_same_alone_and_in_a_batch(bundle: Bundle) -> None:
    """Tile by tile, so to the bit in the maps that the head reads; the head's own tolerance is 1e-6."""
    frames = presses(3, 9)
    frames[1, 20:40, 120:140] = 20
    scorer = Scorer(bundle)
    for one, many in zip(
        [scorer.score_in_pose(frame) for frame in frames], scorer.score_batch(frames), strict=True
    ):
        np.testing.assert_allclose(one.score_map, many.score_map, rtol=1e-6)


@settings(max_examples=12, deadline=None)
@given(
    untouched=st.sets(st.integers(0, 7)),
    marks=st.lists(st.tuples(st.integers(0, 95), st.integers(0, 159)), max_size=3),
)
def test_any_set_of_tiles_may_be_skipped(untouched: set[int], marks: list[tuple[int, int]]) -> None:
    """A tile's features are those of its frame, or of the free gel where it is untouched and looks like it. Whichever
    tiles are left out and wherever something touches, no tile with a mark in it is skipped."""
    runner = TileRunner(SESSION, TILES, MAPS)
    gel, frame = free_gel(2, 1)
    frame = frame.copy()
    for row, column in marks:
        frame[max(0, row - 5) : row + 5, max(0, column - 5) : column + 5] = 250
    free = FreeGel(runner, gel, sorted(untouched))
    whole, of_gel, skipping = (TiledMaps(runner, 1, each) for each in (None, None, free))
    whole.show(frame[None])
    of_gel.show(gel[None])
    with count_tiles() as ran_tiles:
        skipping.show(frame[None])
    matching = free.matching(frame)
    assert ran_tiles.call_count == 8 - len(matching)
    assert matching <= untouched
    for index, (top, left) in enumerate(TILES.places):
        expected = of_gel if index in matching else whole
        for tap in MAPS:
            place = (0, *runner.place(tap, index))
            np.testing.assert_array_equal(skipping.arrays[tap][place], expected.arrays[tap][place])
        if any(top <= row < top + 64 and left <= column < left + 64 for row, column in marks):
            assert index not in matching


def test_a_frame_of_odd_size_is_compared_completely() -> None:
    """Blocks of 8 that the border cuts still count: a mark in the last rows and columns is seen."""
    tiles = tiling((100, 161), 64, 32)
    maps = {"layer1": (64, 16 * len(tiles.rows), 16 * len(tiles.columns))}
    gel = np.full((100, 161, 3), 100, np.uint8)
    free = FreeGel(TileRunner(SESSION, tiles, maps), gel, range(len(tiles)))
    marked = gel.copy()
    marked[97:, 158:] = 255
    assert free.matching(gel) == frozenset(range(len(tiles)))
    assert free.matching(marked) == frozenset(range(13))  # 13 ends one pixel before 14


ROWS, COLUMNS = np.mgrid[:96, :160]
STRUCTURES = {
    "ripples that keep the mean": 20 * np.sign(np.sin(2 * np.pi * (COLUMNS + 0.5) / 8)),
    "a bright and a dark slope": 20 * ((ROWS // 8 == 7) & (COLUMNS // 8 == 5)) * np.where(COLUMNS % 8 < 4, 1, -1),
    "a scratch of one pixel": -20 * ((COLUMNS == 47) & (ROWS > 40) & (ROWS < 60)),
    "a speck": -30 * ((abs(COLUMNS - 47.5) < 1) & (abs(ROWS - 47.5) < 1)),
    "a wide, shallow imprint": 4 * ((COLUMNS > 36) & (ROWS > 36)),
}  # fmt: skip


@pytest.mark.parametrize("prepare", [lambda rgb: rgb, smooth], ids=["as it is", "smoothed"])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_a_tile_with_faint_structure_is_run(
    structure: str, prepare: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Relief that keeps the mean of its surroundings, thin damage and a shallow imprint are no free gel; the free gel
    with the camera's noise is."""
    gel, plain, other = (prepare(rgb) for rgb in free_gel(3, 1))
    free = FreeGel(TileRunner(SESSION, TILES, MAPS), gel, range(8))
    marked = np.clip(free_gel(3, 1)[1] + STRUCTURES[structure][..., None], 0, 255).astype(np.uint8)
    assert free.matching(plain) == free.matching(other) == frozenset(range(8))
    for index, (top, left) in enumerate(TILES.places):
        if STRUCTURES[structure][top : top + 64, left : left + 64].any():
            assert index not in free.matching(prepare(marked))


def test_the_most_typical_frame_is_one_of_them() -> None:
    """The nearest to the mean: an outlier is not chosen."""
    frames = free_gel(4, 2)
    frames[2] += 30
    assert any((most_typical(frames) == frames[k]).all() for k in (0, 1, 3))


def test_a_bundle_survives_writing(fitted: Fitted, tmp_path: Path, ran_tiles: Mock) -> None:
    """Written and loaded it skips the same tiles, says so, and its golden frames agree."""
    loaded = Bundle.load(write_bundle(tmp_path / "pin.zip", fitted.files))
    shown = ran("bundle", "inspect", tmp_path / "pin.zip")
    assert "8 of 64, 4 of them run only when a press touches them" in shown
    scorer = Scorer(loaded)
    assert scorer.check_golden() <= loaded.manifest.tolerance.around(1.0)
    ran_tiles.reset_mock()
    scorer.score(presses(1, 5)[0])
    assert ran_tiles.call_count == 4


@pytest.mark.parametrize("as_bundle", [False, True])
def test_the_merged_graph_sees_every_tile(bundle: Bundle, tmp_path: Path, as_bundle: bool) -> None:
    """One graph for other runtimes: cut, trunk and mosaic inside; equal to the pair that skips nothing."""
    assert merge_bundle(bundle, tmp_path / "merged", as_bundle=as_bundle) < 1e-4
    if as_bundle:
        Scorer(Bundle.load(tmp_path / "merged")).check_golden()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"untouched": (8,)}, "numbered 0 to 7"),
        ({"rows": (0, 20)}, "cover 96 pixels"),
        ({"columns": (0, 48, 96), "untouched": ()}, "not a mosaic of complete tiles"),
    ],
    ids=str,
)
def test_a_wrong_layout_is_refused(bundle: Bundle, change: dict[str, object], says: str) -> None:
    """Tiles that do not exist, that leave the frame, or that the taps are no mosaic of."""
    assert bundle.manifest.grid is not None
    entry = bundle.manifest.grid.model_dump()
    entry["tiles"] |= change
    with pytest.raises(ValidationError, match=says):
        GridEntry.model_validate(entry)
    manifest = bundle.manifest.model_dump() | {"free_gel": None}  # skipping needs its picture
    with pytest.raises(ValidationError, match="free_gel"):
        type(bundle.manifest).model_validate(manifest)
