"""Datasets of presses: the paper's layout, MVTec-style folders and CVAT exports, read into the same values.

Every file that is missing, misnamed, of the wrong size or unreadable is listed in one DatasetError.
"""

from calibration.dataset.files import pool_mask
from calibration.dataset.layouts import SIZES, Resolution, resolution_of
from calibration.dataset.opening import Dataset, layout_of, open_dataset
from calibration.dataset.press import LabelledPress, Split, split_by_specimen

__all__ = [
    "SIZES",
    "Dataset",
    "LabelledPress",
    "Resolution",
    "Split",
    "layout_of",
    "open_dataset",
    "pool_mask",
    "resolution_of",
    "split_by_specimen",
]
