"""What a dataset may hold by mistake, and a study can still use."""

from pathlib import Path

import numpy as np
import pytest

from calibration.dataset import LabelledPress
from calibration.dataset.press import empty_masks, repeated_pictures


def presses(*names: str) -> list[LabelledPress]:
    return [LabelledPress(Path(name), "PZ1", "pos1", (320, 240)) for name in names]


@pytest.mark.parametrize(
    ("empty", "said"), [([], []), ([1], ["1 of the 3", "'b'"]), ([0, 2], ["2 of the 3", "'a'"])]
)
def test_empty_masks_are_counted_and_one_is_named(empty: list[int], said: list[str]) -> None:
    masks = np.ones((3, 2, 2), np.bool_)
    masks[empty] = False
    found = empty_masks("PZ1/pos1", presses("a", "b", "c"), masks)
    assert len(found) == bool(said)
    assert all(words in found[0] for words in said)


@pytest.mark.parametrize(
    ("digests", "said"),
    [(b"xyz", []), (b"xyx", ["1 copy", "'c' of 'a'"]), (b"xxx", ["2 copies", "'b' of 'a'"])],
)
def test_copies_are_counted_and_one_is_named(digests: bytes, said: list[str]) -> None:
    found = repeated_pictures("PZ1/pos1", presses("a", "b", "c"), [bytes([one]) for one in digests])
    assert len(found) == bool(said)
    assert all(words in found[0] for words in said)
