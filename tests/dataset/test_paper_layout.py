"""The paper's layout: counts, specimens, masks, and one error that lists every fault."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.dataset import open_dataset, pool_mask, split_by_specimen
from edge.core.errors import DatasetError

LR, HR = (320, 240), (1280, 720)


def picture(path: Path, size: tuple[int, int], value: int = 100) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((size[1], size[0], 3), value, np.uint8))
    return path


def mask(path: Path, size: tuple[int, int], box: tuple[int, int, int, int]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.zeros((size[1], size[0]), np.uint8)
    left, top, right, bottom = box
    pixels[top:bottom, left:right] = 255
    cv2.imwrite(str(path), pixels)
    return path


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Part PZ1, two positions, three specimens of two presses; two faulty specimens at position 1."""
    for position in ("1", "2"):
        for specimen in (1, 2, 3):
            for press in (1, 2):
                name = f"PZ1_{position}_s{specimen:03d}_p{press:02d}.png"
                picture(tmp_path / "PZ1" / position / "rgb_320x240" / name, LR)
                picture(tmp_path / "PZ1" / position / "rgb" / name, HR)
    for specimen in (4, 5):
        fault = tmp_path / "PZ1" / "1" / "fault"
        name = f"PZ1_1_s{specimen:03d}_p01.png"
        picture(fault / "rgb_320x240" / name, LR)
        picture(fault / "rgb" / name, HR)
        mask(fault / "mask_320x240" / name, LR, (10, 20, 30, 40))
        mask(fault / "mask" / name, HR, (40, 60, 120, 120))
    return tmp_path


def test_counts_specimens_and_masks(root: Path) -> None:
    """12 good presses of 3 specimens at 2 positions and 2 defective ones; a specimen keeps its id at both positions."""
    data = open_dataset(root)
    assert (data.layout, len(data.good), len(data.defective)) == ("paper", 12, 2)
    assert data.positions == (("PZ1", "1"), ("PZ1", "2"))
    assert {p.specimen for p in data.good} == {"PZ1_s001", "PZ1_s002", "PZ1_s003"}
    first = data.defective[0]
    assert (first.specimen, first.press, first.size) == ("PZ1_s004", 1, LR)
    assert first.rgb().shape == (240, 320, 3)
    assert first.mask().sum() == 400
    assert first.mask()[20:40, 10:30].all()
    assert not data.good[0].mask().any()
    assert len(data.select("PZ1", "2").presses) == 6


def test_numbers_of_more_digits_are_read(root: Path) -> None:
    """Piece 1000 and press 100 are as good as 001 and 01: a large dataset keeps its specimens."""
    for size, kind in ((LR, "rgb_320x240"), (HR, "rgb")):
        picture(root / "PZ1" / "2" / kind / "PZ1_2_s1000_p100.png", size)
    found = next(p for p in open_dataset(root).good if p.press == 100)
    assert found.specimen == "PZ1_s1000"


def test_high_resolution_reads_the_other_folders(root: Path) -> None:
    """The same presses at 1280x720, with masks of that size. A part without large pictures is left out of them; where
    no part has the resolution, the missing files are named."""
    press = open_dataset(root, "hr").defective[0]
    assert press.rgb().shape == (720, 1280, 3)
    assert press.mask().sum() == 80 * 60

    small = picture(root / "PZ3" / "1" / "rgb_320x240" / "PZ3_1_s001_p01.png", LR)
    assert {press.part for press in open_dataset(root, "lr").presses} == {"PZ1", "PZ3"}
    assert {press.part for press in open_dataset(root, "hr").presses} == {"PZ1"}
    shutil.rmtree(root / "PZ1")
    with pytest.raises(DatasetError, match=small.stem):
        open_dataset(root, "hr")


def test_absent_low_resolution_masks_are_pooled(root: Path) -> None:
    """Without mask_320x240 each low-resolution pixel is the maximum of its 4x3 block: same rectangle here."""
    shutil.rmtree(root / "PZ1" / "1" / "fault" / "mask_320x240")
    press = open_dataset(root).defective[0]
    assert press.mask().sum() == 400
    assert press.mask()[20:40, 10:30].all()


def test_pooling_keeps_a_single_pixel_and_refuses_fractions() -> None:
    """One defect pixel marks its whole block; a size that is not an integer multiple is refused."""
    fine = np.zeros((6, 8), bool)
    fine[5, 7] = True
    assert pool_mask(fine, (2, 2)).tolist() == [[False, False], [False, True]]
    with pytest.raises(ValueError, match="8x6 is not an integer multiple of 3x2"):
        pool_mask(fine, (2, 3))


def test_all_faults_in_one_error(root: Path) -> None:
    """Missing, misnamed, wrongly sized, truncated, orphaned and foreign files are all named at once."""
    home = root / "PZ1" / "1"
    (home / "rgb" / "PZ1_1_s001_p01.png").unlink()
    picture(home / "rgb_320x240" / "PZ1_1_s001_p02.png", (320, 200))
    truncated = home / "rgb_320x240" / "PZ1_1_s002_p01.png"
    truncated.write_bytes(truncated.read_bytes()[:-20])
    for kind, size in (("rgb", HR), ("rgb_320x240", LR)):
        picture(home / kind / "PZ1_2_s009_p01.png", size)
        (home / kind / "notes.txt").write_text("x")
    (home / "fault" / "mask_320x240" / "PZ1_1_s004_p01.png").unlink()
    mask(home / "fault" / "mask_320x240" / "PZ1_1_s009_p01.png", LR, (0, 0, 5, 5))
    mask(home / "fault" / "mask_320x240" / "PZ1_1_s005_p01.png", (300, 240), (0, 0, 5, 5))
    with pytest.raises(DatasetError) as caught:
        open_dataset(root)
    text = str(caught.value)
    for expected in (
        "rgb/PZ1_1_s001_p01.png: is missing; the other resolution has it",
        "rgb_320x240/PZ1_1_s001_p02.png: is 320x200, expected 320x240",
        "rgb_320x240/PZ1_1_s002_p01.png: is unreadable or truncated",
        "rgb_320x240/PZ1_2_s009_p01.png: is misnamed, expected PZ1_1_s<specimen>_p<press>",
        "rgb_320x240/notes.txt: expected a picture",
        "fault/rgb_320x240/PZ1_1_s004_p01.png: has no mask of the same name",
        "fault/mask_320x240/PZ1_1_s009_p01.png: is a mask without a frame",
        "fault/mask_320x240/PZ1_1_s005_p01.png: is 300x240, expected 320x240 or an integer multiple",
    ):
        assert expected in text
    assert "has 8 files at fault" in text


def test_specimens_csv_overrides_names(root: Path) -> None:
    """A listed file has the listed specimen; an unlisted one keeps the one in its name; an unknown file is a fault."""
    table = root / "specimens.csv"
    table.write_text(
        "file,specimen\nPZ1_1_s001_p01.png,axle-7\nPZ1/1/rgb_320x240/PZ1_1_s001_p02.png,axle-8\n"
    )
    good = {p.path.name: p.specimen for p in open_dataset(root).good}
    assert good["PZ1_1_s001_p01.png"] == "axle-7"
    assert good["PZ1_1_s001_p02.png"] == "axle-8"
    assert good["PZ1_1_s002_p01.png"] == "PZ1_s002"
    table.write_text("file,specimen\nnobody.png,x\n")
    with pytest.raises(DatasetError, match=r"nobody\.png"):
        open_dataset(root)
    table.write_text("name;id\n")
    with pytest.raises(DatasetError, match="needs the columns file and specimen"):
        open_dataset(root)


@pytest.mark.parametrize("seed", range(5))
def test_no_specimen_on_both_sides(root: Path, seed: int) -> None:
    """The two sides share no specimen, lose no press, and the seed decides."""
    good = open_dataset(root).good
    split = split_by_specimen(good, 0.4, seed)
    kept, held = ({p.specimen for p in side} for side in split)
    assert kept
    assert held
    assert not kept & held
    assert len(split.kept) + len(split.held_out) == len(good)
    assert split == split_by_specimen(good, 0.4, seed)


def test_a_split_needs_specimens(root: Path) -> None:
    """Unknown specimens and a single one are refused, saying what to do."""
    good = open_dataset(root).good
    with pytest.raises(DatasetError, match="needs two specimens"):
        split_by_specimen([p for p in good if p.specimen == "PZ1_s001"], 0.5)
    unnamed = picture(root / "PZ1" / "1" / "rgb_320x240" / "frame.png", LR)
    picture(root / "PZ1" / "1" / "rgb" / "frame.png", HR)
    presses = open_dataset(root).good
    assert next(p for p in presses if p.path == unnamed).specimen is None
    with pytest.raises(DatasetError, match=r"specimens\.csv"):
        split_by_specimen(presses, 0.5)


def test_unknown_layouts_and_selections(root: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """No folder, no layout, no picture and no such part are different sentences; so is a recording."""
    empty = tmp_path_factory.mktemp("empty")
    with pytest.raises(DatasetError, match="is not a folder"):
        open_dataset(empty / "nothing")
    with pytest.raises(DatasetError, match="no known layout"):
        open_dataset(empty)
    (empty / "PZ1" / "1" / "rgb_320x240").mkdir(parents=True)
    with pytest.raises(DatasetError, match="no picture in it"):
        open_dataset(empty)
    recorded = tmp_path_factory.mktemp("recorded")
    (recorded / "run" / "test").mkdir(parents=True)
    (recorded / "run" / "test" / "recording.toml").write_text("version = 1")
    for folder in (recorded, recorded / "run", recorded / "run" / "test"):
        with pytest.raises(DatasetError, match="test' is a recording"):
            open_dataset(folder)
    with pytest.raises(DatasetError, match="no press of PZ9/\\*; it has PZ1/1, PZ1/2"):
        open_dataset(root).select("PZ9")
