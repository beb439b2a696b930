"""MVTec-style folders and CVAT exports become the same presses."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.dataset import open_dataset
from calibration.dataset.press import Polygon, Runs, rasterise
from edge.core.errors import DatasetError


def picture(path: Path, pixels: np.ndarray | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((30, 40, 3), 90, np.uint8) if pixels is None else pixels)


def test_mvtec_folders(tmp_path: Path) -> None:
    """Category is the part, train and test the positions, the folder's name the kind of defect."""
    for k in range(3):
        picture(tmp_path / "screw" / "train" / "good" / f"{k:03d}.png")
    picture(tmp_path / "screw" / "test" / "good" / "000.png")
    picture(tmp_path / "screw" / "test" / "scratch" / "000.png")
    pixels = np.zeros((30, 40), np.uint8)
    pixels[5:9, 5:10] = 255
    picture(tmp_path / "screw" / "ground_truth" / "scratch" / "000_mask.png", pixels)
    data = open_dataset(tmp_path)
    assert data.layout == "mvtec"
    assert data.positions == (("screw", "test"), ("screw", "train"))
    assert [p.defect for p in data.defective] == ["scratch"]
    assert data.defective[0].mask().sum() == 20
    assert len(data.select(position="train").good) == 3
    (tmp_path / "screw" / "ground_truth" / "scratch" / "000_mask.png").unlink()
    with pytest.raises(DatasetError, match=r"scratch/000\.png: has no mask"):
        open_dataset(tmp_path)


def test_real_screws(real_tactile: Path) -> None:
    """The optical screws of the tactile data set have as many masks as defective pictures."""
    root = real_tactile.parent / "real_ad" / "mvtec_screw_subset"
    if not root.is_dir():
        pytest.skip(f"SKIPPED, NOT TESTED: no screws at {root}")
    data = open_dataset(root)
    assert data.good
    assert data.defective
    assert data.defective[0].mask().any()


ANNOTATIONS = """<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version>
<image id="0" name="PZ3/1/PZ3_1_s002_p01.png" width="40" height="30">
  <polygon label="dent" points="10.00,10.00;20.00,10.00;20.00,15.00;10.00,15.00" z_order="0"/>
  <box label="dent" xtl="0" ytl="0" xbr="2.0" ybr="3.0"/>
  <mask label="burr" rle="1, 2, 2, 1" left="30" top="20" width="3" height="2"/>
</image>
<image id="1" name="PZ3/1/PZ3_1_s001_p01.png" width="40" height="30"><tag label="checked"/></image>
</annotations>"""


@pytest.fixture
def cvat(tmp_path: Path) -> Path:
    (tmp_path / "annotations.xml").write_text(ANNOTATIONS)
    for name in ("PZ3_1_s001_p01.png", "PZ3_1_s002_p01.png"):
        picture(tmp_path / "images" / "PZ3" / "1" / name)
    return tmp_path


def test_cvat_xml(cvat: Path) -> None:
    """Polygon 10x5, box 2x3 and three run-length pixels make 59; the tagged picture without shapes is good."""
    data = open_dataset(cvat)
    assert data.layout == "cvat_xml"
    assert data.positions == (("PZ3", "1"),)
    bad, good = data.defective[0], data.good[0]
    assert (bad.defect, bad.specimen, good.specimen) == ("dent", "PZ3_s002", "PZ3_s001")
    pixels = bad.mask()
    assert pixels.sum() == 50 + 6 + 3
    assert pixels[10:15, 10:20].all()
    assert pixels[20:22, 30:33].tolist() == [[False, True, True], [False, False, True]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('width="40" height="30">\n', 'width="41" height="30">\n', "annotations.xml says 41x30"),
        ("PZ3_1_s001_p01.png", "PZ3_1_s007_p01.png", "missing or unreadable"),
        ("1, 2, 2, 1", "1, 2, 2, 2", "runs sum to 7, expected 3x2"),
        ("20.00,15.00;10.00,15.00", "", "needs three points"),
        ("<box ", "<polyline ", "has no area"),
        ('xtl="0"', "", "xtl"),
        ("<annotations>", "<!DOCTYPE a [<!ENTITY b 'c'>]><annotations>", "declares a document type"),
        ("</annotations>", "", "not a complete XML file"),
        ('name="PZ3/1/PZ3_1_s001', 'name="../../PZ3_1_s001', "outside the dataset"),
    ],
)
def test_cvat_faults(cvat: Path, old: str, new: str, message: str) -> None:
    """Each broken export is one DatasetError that says what is broken."""
    (cvat / "annotations.xml").write_text(ANNOTATIONS.replace(old, new, 1))
    with pytest.raises(DatasetError, match=message):
        open_dataset(cvat)


def test_cvat_png_masks(tmp_path: Path) -> None:
    """Any colour but black is a defect; a frame without a mask file and a mask without a frame are faults."""
    for name in ("a", "b"):
        picture(tmp_path / "JPEGImages" / f"{name}.jpg")
    colours = np.zeros((30, 40, 3), np.uint8)
    colours[3:5, 4:8, 2] = 250
    picture(tmp_path / "SegmentationClass" / "a.png", colours)
    picture(tmp_path / "SegmentationClass" / "b.png", np.zeros((30, 40, 3), np.uint8))
    data = open_dataset(tmp_path)
    assert [p.path.stem for p in data.defective] == ["a"]
    assert data.defective[0].mask().sum() == 8
    (tmp_path / "SegmentationClass" / "b.png").rename(tmp_path / "SegmentationClass" / "c.png")
    with pytest.raises(DatasetError, match=r"b.jpg: has no mask(.|\n)*c.png: is a mask without a frame"):
        open_dataset(tmp_path)


def test_a_pixel_belongs_by_its_centre() -> None:
    """A triangle over a 4x4 picture covers the pixels whose centres it contains; parts outside are cut off."""
    triangle = Polygon(((0.0, 0.0), (4.0, 0.0), (0.0, 4.0)))
    rows = rasterise([triangle], (4, 4)).sum(axis=1)
    assert rows.tolist() == [3, 2, 1, 0]
    beyond = Polygon(((-5.0, -5.0), (50.0, -5.0), (50.0, 50.0), (-5.0, 50.0)))
    assert rasterise([beyond], (4, 4)).all()
    assert rasterise([Runs(-1, -1, 2, 2, (0, 4))], (4, 4)).sum() == 1
    assert rasterise([Runs(10, 10, 2, 2, (0, 4))], (4, 4)).sum() == 0


def test_shapes_refuse_nonsense() -> None:
    with pytest.raises(ValueError, match="three points"):
        Polygon(((0.0, 0.0), (1.0, 1.0)))
    with pytest.raises(ValueError, match="finite"):
        Polygon(((0.0, 0.0), (1.0, 1.0), (float("nan"), 0.0)))
    with pytest.raises(ValueError, match="no negative run"):
        Runs(0, 0, 2, 2, (-1, 5))
