"""Regions of a picture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.errors import ConfigError
from edge.core.imaging.region import Region, touched_in

LR = (320, 240)


def test_the_default_region_is_the_centre() -> None:
    """224x224 of 320x240: rows 8 to 231, columns 48 to 271."""
    region = Region.centre(LR)
    assert region == Region(48, 8, 224, 224)
    rows = np.broadcast_to(np.arange(240)[:, None], (240, 320))
    assert (region.crop(rows).min(), region.crop(rows).max()) == (8, 231)
    columns = np.broadcast_to(np.arange(320), (240, 320))
    assert (region.crop(columns).min(), region.crop(columns).max()) == (48, 271)


@given(st.integers(0, 96), st.integers(0, 16), st.integers(1, 224), st.integers(1, 224))
def test_written_and_read_back(x: int, y: int, width: int, height: int) -> None:
    """parse(str(region)) is the region, and its crop has its size and starts at its corner."""
    region = Region(x, y, width, height)
    assert Region.parse(str(region), LR) == region
    picture = np.arange(320 * 240 * 3, dtype=np.int64).reshape(240, 320, 3)
    crop = region.crop(picture)
    assert crop.shape == (height, width, 3)
    assert crop[0, 0, 0] == picture[y, x, 0]


def test_words() -> None:
    """`centre` and `full` are understood, in any case."""
    assert Region.parse("Centre", LR) == Region.centre(LR)
    assert Region.parse(" full ", LR) == Region(0, 0, 320, 240)


@pytest.mark.parametrize("text", ["", "middle", "1,2,3", "-1,0,10x10", "1,2,3x4x5", "0,0,0x10"])
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="region"):
        Region.parse(text, LR)


def test_a_region_outside_the_picture_is_refused() -> None:
    """One pixel outside is refused: in the configuration, at a crop, and for a centre that does not fit."""
    assert Region.parse("96,16,224x224", LR).is_within(LR)
    with pytest.raises(ConfigError, match=r"\(321, 240\).*320x240"):
        Region.parse("97,16,224x224", LR)
    with pytest.raises(ConfigError, match="224x224"):
        Region.centre((160, 120))
    with pytest.raises(ValueError, match="outside"):
        Region(97, 16, 224, 224).crop(np.zeros((240, 320)))
    with pytest.raises(ValueError, match="found"):
        Region(0, 0, 0, 5)


def test_a_view_mask_lands_on_the_same_place_of_the_region() -> None:
    """One pixel of the 160x120 view is a 2x2 block of the 320x240 picture."""
    mask = np.zeros((120, 160), np.bool_)
    mask[50, 60] = True
    found = touched_in(mask, LR, Region.centre(LR))
    assert found.shape == (224, 224)
    assert found.dtype == np.bool_
    assert set(zip(*np.nonzero(found), strict=True)) == {(92, 72), (92, 73), (93, 72), (93, 73)}
