import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pydantic import ValidationError

from common.wire.array import Array


@given(arrays.arrays(st.sampled_from([np.float32, np.float64, np.bool_]), arrays.array_shapes(max_dims=4, max_side=4)))
def test_an_array_comes_back_bit_by_bit(values: np.ndarray):
    back = Array.of(values).values()
    assert back.dtype == values.dtype
    assert back.shape == values.shape
    assert back.tobytes() == values.tobytes()


def test_numbers_that_are_not_float32_travel_as_float64():
    assert Array.of(np.array([1, 2])).dtype == "float64"


def test_an_array_that_is_not_contiguous_travels_in_c_order():
    values = np.arange(6, dtype=np.float32).reshape(2, 3).T
    np.testing.assert_array_equal(Array.of(values).values(), values)


def test_data_is_little_endian():
    assert Array.of(np.array([1.0], dtype=">f8")).data == bytes([0, 0, 0, 0, 0, 0, 0xF0, 0x3F])


def test_the_values_cannot_be_written_into():
    with pytest.raises(ValueError, match="read-only"):
        Array.of(np.zeros(3)).values()[0] = 1


def test_json_carries_data_as_base64_text():
    array = Array.of(np.array([1.5, -2.0]))
    text = array.model_dump(mode="json")["data"]
    assert base64.b64decode(text) == array.data
    assert Array.model_validate({"dtype": "float64", "shape": [2], "data": text}) == array


@pytest.mark.parametrize(
    ("shape", "size", "said"),
    [
        ([2, 3], 23, "expected 24 bytes of data for shape"),
        ([2**40, 2**40], 8, "expected 4835703278458516698824704 bytes"),
        ([0], 0, "greater than or equal to 1"),
        ([-1], 4, "greater than or equal to 1"),
        ([], 4, "at least 1 item"),
        ([1, 1, 1, 1, 1], 4, "at most 4 items"),
    ],
)
def test_a_shape_that_does_not_fit_the_data_is_refused(shape: list[int], size: int, said: str):
    with pytest.raises(ValidationError, match=said):
        Array.model_validate({"dtype": "float32", "shape": shape, "data": bytes(size)})


@pytest.mark.parametrize("dtype", ["object", "int64", "float16", ">f4", ""])
def test_another_element_type_is_refused(dtype: str):
    with pytest.raises(ValidationError, match="dtype"):
        Array.model_validate({"dtype": dtype, "shape": [1], "data": bytes(8)})


def test_text_that_is_not_base64_is_refused():
    with pytest.raises(ValidationError, match="in JSON as base64"):
        Array.model_validate({"dtype": "bool", "shape": [3], "data": "?!"})
