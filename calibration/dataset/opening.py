"""Opening a dataset: its layout, its presses, and their specimens."""

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from calibration.dataset.cvat import read_cvat_masks, read_cvat_xml
from calibration.dataset.files import Faults
from calibration.dataset.layouts import Resolution, is_mvtec, is_paper, read_mvtec, read_paper
from calibration.dataset.press import LabelledPress
from edge.core.errors import DatasetError
from edge.recording.format import HEADER

__all__ = ["DATASET_VERSION", "SUMMARY_FILE", "Dataset", "layout_of", "open_dataset"]

Layout = Literal["paper", "mvtec", "cvat_xml", "cvat_masks"]

# Two columns with a header, file and specimen; file is a path below the root or a bare file name.
SPECIMENS_FILE = "specimens.csv"

# The summary of `gelgate lab simulate`; datasets of other origin have none.
SUMMARY_FILE = "dataset.json"
DATASET_VERSION = 1


@dataclass(frozen=True)
class Dataset:
    """Presses of one folder, in the order of their paths."""

    root: Path
    layout: Layout
    presses: tuple[LabelledPress, ...]

    @property
    def good(self) -> tuple[LabelledPress, ...]:
        return tuple(p for p in self.presses if not p.is_defective)

    @property
    def defective(self) -> tuple[LabelledPress, ...]:
        return tuple(p for p in self.presses if p.is_defective)

    @property
    def positions(self) -> tuple[tuple[str, str], ...]:
        """Every (part, position) that has a press, sorted."""
        return tuple(sorted({(p.part, p.position) for p in self.presses}))

    def select(self, part: str | None = None, position: str | None = None) -> "Dataset":
        """The presses of one part or position. Errors: DatasetError with the existing ones, when none is left."""
        chosen = tuple(p for p in self.presses if part in (None, p.part) and position in (None, p.position))
        if not chosen:
            known = ", ".join("/".join(pair) for pair in self.positions)
            wanted = "/".join(str(x or "*") for x in (part, position))
            raise DatasetError(f"dataset '{self.root}' has no press of {wanted}; it has {known}")
        return replace(self, presses=chosen)


def open_dataset(root: Path, resolution: Resolution = "lr") -> Dataset:
    """Read a dataset's file names, sizes and specimens; pictures are read later, from each press.

    resolution: of the two in the paper's layout; the other layouts have one. A `specimens.csv` at the root overrides
    specimen ids. Errors: DatasetError for an unknown layout, for a simulated dataset of another version or an
    interrupted one, or with every file at fault.
    """
    _check_summary(root)
    faults = Faults(root)
    layout, presses = _read(root, resolution, faults)
    presses = _with_specimens(root, presses, faults)
    faults.raise_any()
    if not presses:
        raise DatasetError(f"dataset '{root}' has the {layout} layout, but no picture in it")
    return Dataset(root, layout, tuple(sorted(presses, key=lambda p: p.path)))


def layout_of(root: Path) -> Layout | None:
    """The layout of a folder, None when it is not a dataset."""
    if (root / "annotations.xml").is_file():
        return "cvat_xml"
    if (root / "SegmentationClass").is_dir():
        return "cvat_masks"
    if is_mvtec(root):
        return "mvtec"
    return "paper" if is_paper(root) else None


def _read(root: Path, resolution: Resolution, faults: Faults) -> tuple[Layout, list[LabelledPress]]:
    if not root.is_dir():
        raise DatasetError(f"dataset '{root}' is not a folder; give the folder that holds the parts")
    layout = layout_of(root)
    folders = ("", "*/", "*/*/") if layout in (None, "mvtec") else ()
    if recording := next((found.parent for folder in folders for found in root.glob(folder + HEADER)), None):
        raise DatasetError(
            f"'{recording}' is a recording, whose frames are not sorted into good and damaged; `gelgate run` plays one "
            'with device.plugin = "usb_mock", and `gelgate fit` learns from it'
        )
    match layout:
        case "cvat_xml":
            return layout, read_cvat_xml(root, faults)
        case "cvat_masks":
            return layout, read_cvat_masks(root, faults)
        case "mvtec":
            return layout, read_mvtec(root, faults)
        case "paper":
            return layout, read_paper(root, resolution, faults)
    raise DatasetError(
        f"dataset '{root}' has no known layout; expected <part>/<position>/rgb[_320x240], train/good with test/, "
        "annotations.xml with images/, or SegmentationClass/"
    )


def _check_summary(root: Path) -> None:
    """Refuse a simulated dataset of another version, and an incomplete one: its results would be wrong."""
    path = root / SUMMARY_FILE
    if not path.is_file():
        return
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        version, is_complete = summary["version"], summary["complete"]
    except (OSError, ValueError, KeyError, TypeError):
        raise DatasetError(
            f"'{path}' is not a summary that 'gelgate lab simulate' wrote; restore it, or remove it if the "
            "pictures are "
            "of another origin"
        ) from None
    if version != DATASET_VERSION:
        raise DatasetError(
            f"dataset '{root}' has version {version!r}, this program reads version {DATASET_VERSION}; make it again "
            "with 'gelgate lab simulate', or use the program that made it"
        )
    if is_complete is not True:
        raise DatasetError(
            f"dataset '{root}' is incomplete, because 'gelgate lab simulate' was interrupted; "
            "give the same command again to finish it"
        )


def _with_specimens(root: Path, presses: list[LabelledPress], faults: Faults) -> list[LabelledPress]:
    """Specimen ids from specimens.csv if it lists a file, else from the file's name."""
    table = root / SPECIMENS_FILE
    if not table.is_file():
        return presses
    with table.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        if not {"file", "specimen"} <= set(reader.fieldnames or ()):
            faults.add(
                table, f"needs the columns file and specimen, found {', '.join(reader.fieldnames or ())}"
            )
            return presses
        named = {str(row["file"]).strip(): str(row["specimen"]).strip() for row in reader}
    given = []
    for press in presses:
        keys = (press.path.relative_to(root).as_posix(), press.path.name)
        specimen = next((named[k] for k in keys if k in named), press.specimen)
        given.append(replace(press, specimen=specimen or None))
    for name in sorted(named):
        if not (root / name).is_file() and not any(p.path.name == name for p in presses):
            faults.add(table, f"lists '{name}', which is not in the dataset")
    return given
