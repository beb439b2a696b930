"""The feature cache: extracted once, found by content, complete or not at all."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from full_disk import room_for
from tiny import tiny_trunk

from calibration.dataset import LabelledPress
from calibration.experiments.harness.feature_cache import Taken, take_features
from calibration.experiments.harness.pictures import PressPictures, View
from calibration.fitting.trunks import Trunk
from edge.core.errors import ConfigError, StoreError
from edge.core.imaging.region import Region

VIEW = View((48, 40), Region(8, 4, 32, 32), 15.77)
TRUNK = Trunk("tiny", tiny_trunk())
TAPS = ("layer2", "layer1")


class Cache:
    """A folder of features."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def features(self, *asked: Any) -> Taken:
        return take_features(self.folder, *asked)


@pytest.fixture
def presses(tmp_path: Path) -> tuple[LabelledPress, ...]:
    rng = np.random.default_rng(0)
    found = []
    for k in range(3):
        path = tmp_path / f"{k}.png"
        cv2.imwrite(str(path), rng.integers(0, 255, (40, 48, 3), np.uint8))
        found.append(LabelledPress(path, "bolt", "pos1", (48, 40)))
    return tuple(found)


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path / "features")


def entries(cache: Cache) -> set[str]:
    return {path.name for path in cache.folder.iterdir() if path.is_dir()}


def test_features_are_those_of_the_trunk(cache: Cache, presses: tuple[LabelledPress, ...]) -> None:
    """The mean colour of each 8x8 cell of the region, memory-mapped, with their geometry."""
    pictures = PressPictures(presses, VIEW)
    taken = cache.features(TRUNK, TAPS, pictures)

    frame = pictures.read(1, 2)[0].astype(np.float64) / 255
    cells = frame.reshape(4, 8, 4, 8, 3).mean(axis=(1, 3)).transpose(2, 0, 1)
    np.testing.assert_allclose(taken.features["layer1"][1], cells, atol=1e-6)
    assert taken.grid.taps == {"layer1": (3, 4, 4), "layer2": (3, 2, 2)}
    assert taken.grid.frame == (32, 32)
    assert not taken.features["layer1"].flags.writeable
    assert list(taken.grid_of(["layer2"]).taps) == ["layer2"]


def test_a_second_call_reads_what_the_first_wrote(cache: Cache, presses: tuple[LabelledPress, ...]) -> None:
    """Nothing is extracted: a trunk that cannot run would fail."""
    pictures = PressPictures(presses, VIEW)
    first = cache.features(TRUNK, TAPS, pictures)
    (entry,) = entries(cache)
    before = (cache.folder / entry / "layer1.npy").stat().st_mtime_ns
    shares: list[float] = []
    again = cache.features(TRUNK, TAPS, PressPictures(presses, VIEW), shares.append)

    assert (cache.folder / entry / "layer1.npy").stat().st_mtime_ns == before
    assert shares == [1.0]
    np.testing.assert_array_equal(first.features["layer1"], again.features["layer1"])


def test_the_entry_depends_on_all_that_matters(cache: Cache, presses: tuple[LabelledPress, ...]) -> None:
    """Another picture, order, view, tap or trunk is another entry."""
    pictures = PressPictures(presses, VIEW)
    cache.features(TRUNK, TAPS, pictures)
    cache.features(TRUNK, ("layer1",), pictures)
    cache.features(TRUNK, TAPS, PressPictures(presses[::-1], VIEW))
    cache.features(TRUNK, TAPS, PressPictures(presses, replace(VIEW, region=Region(0, 0, 32, 32))))
    cache.features(Trunk("other", tiny_trunk() + b"\x72\x00"), TAPS, pictures)
    cv2.imwrite(str(presses[0].path), np.zeros((40, 48, 3), np.uint8))
    cache.features(TRUNK, TAPS, PressPictures(presses, VIEW))

    assert len(entries(cache)) == 6


def test_an_incomplete_entry_is_extracted_again(cache: Cache, presses: tuple[LabelledPress, ...]) -> None:
    """As after a power cut: a file without its end."""
    pictures = PressPictures(presses, VIEW)
    whole = np.array(cache.features(TRUNK, TAPS, pictures).features["layer1"])
    (entry,) = entries(cache)
    path = cache.folder / entry / "layer1.npy"
    path.write_bytes(path.read_bytes()[:-4])

    np.testing.assert_array_equal(cache.features(TRUNK, TAPS, pictures).features["layer1"], whole)


def test_a_full_disk_leaves_no_entry(cache: Cache, presses: tuple[LabelledPress, ...]) -> None:
    """One sentence; when there is room, the same call works."""
    pictures = PressPictures(presses, VIEW)
    with (
        room_for(200),
        pytest.raises(StoreError, match=r"the features cannot be written .* choose another folder"),
    ):
        cache.features(TRUNK, TAPS, pictures)

    assert entries(cache) == set()
    assert len(cache.features(TRUNK, TAPS, pictures).features["layer1"]) == 3


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("cache.json", '{"format": 99}', "holds another cache of features: format 99, not 1; choose an empty --cache"),
        ("cache.json", "hello", "is not empty and holds no cache of features; choose an empty --cache"),
        ("letter.txt", "hello", "is not empty and holds no cache of features; choose an empty --cache"),
    ],
)  # fmt: skip
def test_a_folder_of_something_else_is_no_cache(
    cache: Cache, presses: tuple[LabelledPress, ...], name: str, text: str, said: str
) -> None:
    """Nothing is written among the operator's files."""
    cache.folder.mkdir()
    (cache.folder / name).write_text(text)
    with pytest.raises(ConfigError, match=said):
        cache.features(TRUNK, TAPS, PressPictures(presses, VIEW))

    assert [path.name for path in cache.folder.iterdir()] == [name]
