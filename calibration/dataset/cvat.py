"""CVAT exports: `CVAT for images 1.1` (annotations.xml) and `Segmentation mask 1.1` (PNG masks).

Ref: CVAT documentation, "CVAT for image" and "Segmentation mask" formats. Every label but `background` is a defect,
and the label is its kind; a picture without shapes is a good part. Boxes may be rotated; ellipses are drawn as 72-gons.
Polylines, points and skeletons have no area and are faults.
"""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calibration.dataset.files import Faults, pictures_in, size_of
from calibration.dataset.press import LabelledPress, Polygon, Runs, Shape, parse_name
from edge.core.errors import DatasetError

__all__ = ["read_cvat_masks", "read_cvat_xml"]

_NO_AREA = ("polyline", "points", "skeleton", "cuboid")
_BACKGROUND = "background"
_ELLIPSE_POINTS = 72


def read_cvat_xml(root: Path, faults: Faults) -> list[LabelledPress]:
    """The presses of an export with annotations.xml and images/. Errors: DatasetError for invalid XML."""
    annotations = root / "annotations.xml"
    presses = []
    seen: set[Path] = set()
    for image in _parse(annotations).iter("image"):
        name = image.get("name", "")
        path = next((p for p in (root / "images" / name, root / name) if p.is_file()), root / "images" / name)
        seen.add(path)
        if not path.resolve().is_relative_to(root.resolve()):
            faults.add(annotations, f"image '{name}' is outside the dataset")
            continue
        press = _annotated(root, path, image, annotations, faults)
        if press is not None:
            presses.append(press)
    for path in sorted((root / "images").rglob("*")):
        if path.is_file() and path not in seen and not path.name.startswith("."):
            faults.add(path, "is not listed in annotations.xml")
    return presses


def _parse(path: Path) -> ElementTree.Element:
    data = path.read_bytes()
    # CVAT writes no document type; refusing it prevents entity expansion.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise DatasetError(
            f"'{path}' declares a document type, which a CVAT export does not; export it again"
        )
    try:
        tree = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise DatasetError(f"'{path}' is not a complete XML file: {error}; export it again") from error
    if tree.tag != "annotations":
        raise DatasetError(f"'{path}' is <{tree.tag}>, expected <annotations> of 'CVAT for images 1.1'")
    return tree


def _annotated(
    root: Path, path: Path, image: ElementTree.Element, annotations: Path, faults: Faults
) -> LabelledPress | None:
    size = size_of(path)
    if size is None:
        faults.add(path, "is listed in annotations.xml, but is missing or unreadable")
        return None
    stated = (int(image.get("width", 0)), int(image.get("height", 0)))
    if stated != size:
        faults.add(path, f"is {size[0]}x{size[1]}, annotations.xml says {stated[0]}x{stated[1]}")
        return None
    shapes: list[Shape] = []
    labels: list[str] = []
    for element in image:
        if element.tag == "tag" or element.get("label") == _BACKGROUND:
            continue
        try:
            shapes.append(_shape(element))
            labels.append(element.get("label", "defect"))
        except (ValueError, KeyError) as error:
            faults.add(annotations, f"image '{path.name}', <{element.tag}>: {error}")
    folder = path.parent.relative_to(root).parts
    return _press(root, path, size, labels[0] if labels else None, shapes=tuple(shapes), folder=folder)


def _shape(element: ElementTree.Element) -> Shape:
    """Read a drawn element. Errors: ValueError or KeyError with what is wrong."""
    if element.tag == "polygon":
        pairs = [p.split(",") for p in element.attrib["points"].split(";") if p]
        return Polygon(tuple((float(x), float(y)) for x, y in pairs))
    if element.tag == "box":
        x0, y0, x1, y1 = (float(element.attrib[k]) for k in ("xtl", "ytl", "xbr", "ybr"))
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        return _rotated(corners, ((x0 + x1) / 2, (y0 + y1) / 2), float(element.get("rotation", 0)))
    if element.tag == "ellipse":
        cx, cy, rx, ry = (float(element.attrib[k]) for k in ("cx", "cy", "rx", "ry"))
        turns = (2 * math.pi * k / _ELLIPSE_POINTS for k in range(_ELLIPSE_POINTS))
        outline = [(cx + rx * math.cos(t), cy + ry * math.sin(t)) for t in turns]
        return _rotated(outline, (cx, cy), float(element.get("rotation", 0)))
    if element.tag == "mask":
        left, top, width, height = (int(element.attrib[k]) for k in ("left", "top", "width", "height"))
        counts = tuple(int(c) for c in element.attrib["rle"].split(","))
        return Runs(left, top, width, height, counts)
    if element.tag in _NO_AREA:
        raise ValueError("has no area; draw a polygon, a box or a mask")
    raise ValueError("is not a shape of CVAT for images 1.1")


def _rotated(points: list[tuple[float, float]], centre: tuple[float, float], degrees: float) -> Polygon:
    """Rotated clockwise on the screen about the centre, as CVAT's `rotation`."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    moved = ((x - centre[0], y - centre[1]) for x, y in points)
    return Polygon(tuple((centre[0] + c * x - s * y, centre[1] + s * x + c * y) for x, y in moved))


def read_cvat_masks(root: Path, faults: Faults) -> list[LabelledPress]:
    """The presses of an export with SegmentationClass/ and JPEGImages/ (or images/).

    Every pixel that is not black, the colour of `background`, is a defect. A picture without a mask file is a fault:
    this format writes a black mask for a good part.
    """
    from calibration.dataset.files import read_mask

    folder = root / "JPEGImages" if (root / "JPEGImages").is_dir() else root / "images"
    masks = {Path(name).stem: path for name, path in pictures_in(root / "SegmentationClass", faults).items()}
    presses = []
    for name, path in pictures_in(folder, faults).items():
        mask_file = masks.pop(Path(name).stem, None)
        size = size_of(path)
        if size is None:
            faults.add(path, "is unreadable")
        elif mask_file is None:
            faults.add(path, "has no mask in SegmentationClass")
        elif size_of(mask_file) != size:
            faults.add(mask_file, f"is unreadable or not {size[0]}x{size[1]} as its frame")
        else:
            is_defective = bool(np.any(read_mask(mask_file, size)))
            presses.append(_press(root, path, size, "defect" if is_defective else None, mask_file=mask_file))
    for mask_file in masks.values():
        faults.add(mask_file, f"is a mask without a frame in {folder.name}")
    return presses


def _press(
    root: Path,
    path: Path,
    size: tuple[int, int],
    defect: str | None,
    *,
    mask_file: Path | None = None,
    shapes: tuple[Shape, ...] = (),
    folder: tuple[str, ...] = (),
) -> LabelledPress:
    """Part and position from `images/<part>/<position>/`, else the export's own name and `all`."""
    part, position = folder[-2:] if len(folder) >= 3 else (root.name, "all")
    specimen, press, _ = parse_name(path.stem, part, position)
    return LabelledPress(path, part, position, size, specimen, press, defect, mask_file, shapes)
