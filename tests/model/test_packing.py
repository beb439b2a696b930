"""Packing: unpacked values are within the stated bound of the originals, at any scale."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from edge.model.packing import Packed, pack, unpack

SUBNORMAL = 1.5e-45  # the smallest float32, rounded up


def arrays() -> st.SearchStrategy[np.ndarray]:
    """float32 arrays with rows of very different size, from 1e-42 to 1e30, zeros and outliers among them."""
    shapes = hnp.array_shapes(min_dims=1, max_dims=3, max_side=6)
    value = st.floats(-1, 1, width=32)
    scale = st.sampled_from([1e-42, 1e-30, 1e-6, 1.0, 1e6, 1e30])
    return st.tuples(st.data(), scale, shapes).flatmap(
        lambda t: hnp.arrays(np.float32, t[2], elements=value).map(
            lambda a: (a * np.float32(t[1])).astype(np.float32)
        )
    )


@given(arrays())
@settings(max_examples=60, deadline=None)
def test_float16_error_is_a_part_in_2048_of_the_entry(array: np.ndarray) -> None:
    """|error| is at most 2**-11 of the entry plus 2**-40 of the largest one, at any scale: nothing overflows."""
    packed = pack(array, "float16")
    found = unpack(packed, "float16")
    bound = 2.0**-11 * np.abs(array, dtype=np.float64) + 2.0**-39 * np.abs(array).max(initial=0.0) + SUBNORMAL
    assert packed.data.dtype == np.float16
    assert found.dtype == np.float32
    assert (np.abs(found.astype(np.float64) - array) <= bound).all()


@given(arrays())
@settings(max_examples=60, deadline=None)
def test_int8_error_is_half_a_step_of_its_row(array: np.ndarray) -> None:
    """|error| is at most 0.501 of the row's scale, and the scale is a 127th of the row's largest entry."""
    packed = pack(array, "int8")
    found = unpack(packed, "int8")
    assert packed.scale is not None
    top = np.abs(array).max(axis=-1, initial=0.0)
    assert (packed.scale <= top / 127 * 1.001 + SUBNORMAL).all()
    bound = 0.501 * packed.scale[..., None].astype(np.float64)
    assert (np.abs(found.astype(np.float64) - array) <= bound).all()


def test_int8_of_the_smallest_floats_does_not_wrap() -> None:
    """2e-43 / 127 is no float32; rounded down it would make 143 steps, and 143 wraps to a negative number."""
    found = unpack(pack(np.array([[2e-43, -2e-43]], np.float32), "int8"), "int8")
    np.testing.assert_allclose(found, [[2e-43, -2e-43]], atol=2e-45)


def test_none_keeps_every_bit() -> None:
    """`none` stores integers, flags and floats as they are."""
    for array in (np.arange(3), np.array([True, False]), np.array([1e-45, 3.4e38], np.float32)):
        np.testing.assert_array_equal(unpack(pack(array, "none"), "none"), array)


def test_an_outlier_beyond_float16_range_survives() -> None:
    """1e6 does not become infinity: the array is scaled by a power of two."""
    found = unpack(pack(np.array([1e6, 1.0], np.float32), "float16"), "float16")
    np.testing.assert_allclose(found, [1e6, 1.0], rtol=2**-11)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("packing", ["none", "float16", "int8"])
def test_a_bank_that_is_not_finite_is_refused(bad: float, packing: str) -> None:
    """NaN in a bank would make every score NaN; it is refused where it is stored."""
    with pytest.raises(ValueError, match="NaN or infinity"):
        pack(np.array([1.0, bad], np.float32), packing)  # type: ignore[arg-type]


@pytest.mark.parametrize("packing", ["float16", "int8"])
def test_rounding_makes_no_infinity(packing: str) -> None:
    """The largest float32 is refused, because rounded up it would be infinite; 2**127 comes back finite."""
    with pytest.raises(ValueError, match=r"it holds 3.4e\+38; .* takes numbers up to 1.7e\+38"):
        pack(np.array([np.finfo(np.float32).max, 1.0], np.float32), packing)  # type: ignore[arg-type]
    found = unpack(pack(np.array([2.0**127, -1e38], np.float32), packing), packing)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [2.0**127, -1e38], atol=0.004 * 2.0**127)


def test_only_float32_is_packed() -> None:
    """Indices cannot be rounded."""
    with pytest.raises(ValueError, match="float32"):
        pack(np.arange(3), "int8")


def test_int8_without_its_scale_is_refused() -> None:
    with pytest.raises(ValueError, match="scale"):
        unpack(Packed(np.zeros((2, 2), np.int8)), "int8")
