"""What a dataset may hold by mistake, and a study can still use: said, and not refused."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.press import LabelledPress

__all__ = ["empty_masks", "repeated_pictures"]


def empty_masks(where: str, defective: Sequence[LabelledPress], masks: NDArray[np.bool_]) -> list[str]:
    """A sentence if some defective presses show no damage. masks: of the inspected region, bool (n, h, w)."""
    empty = [press.path.name for press, mask in zip(defective, masks, strict=True) if not mask.any()]
    if not empty:
        return []
    return [
        f"{len(empty)} of the {len(defective)} defective presses of {where} "
        f"{'has an empty mask' if len(empty) == 1 else 'have empty masks'} in the inspected region, such as "
        f"'{empty[0]}': as presses they count as damaged, all their pixels as sound; check their masks"
    ]


def repeated_pictures(where: str, presses: Sequence[LabelledPress], digests: Sequence[bytes]) -> list[str]:
    """A sentence if some pictures are the same. digests: of the bytes of each press's picture."""
    first: dict[bytes, LabelledPress] = {}
    copies = [
        (first[digest], press)
        for press, digest in zip(presses, digests, strict=True)
        if first.setdefault(digest, press) is not press
    ]
    if not copies:
        return []
    original, copy = copies[0]
    return [
        f"{where} has {len(copies)} {'copy' if len(copies) == 1 else 'copies'} of other pictures, such as "
        f"'{copy.path.name}' of '{original.path.name}': what is learnt and tested too is found too easily; remove "
        "the copies"
    ]
