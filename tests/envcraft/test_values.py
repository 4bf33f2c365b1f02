"""ValueCodecs come from untrusted code: every byte is bounded, and nothing but MalformedValue is raised."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from envcraft.errors import MalformedValue
from envcraft.spaces.codec import MAX_BYTES, ValueCodec

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=20,
)
dtypes = st.sampled_from(
    ["|u1", "uint8", "<f8", "<U3", "object", "O", "V8", "S2147483647", "i4,i4", "(3,)i4", "datetime64", "?"]
)
specs = st.recursive(
    st.fixed_dictionaries(
        {"k": st.sampled_from(["array", "scalar", "int", "float", "bool", "str", "other", "pickle"])},
        optional={
            "dtype": dtypes | json_values,
            "shape": st.lists(st.integers(-1, 10_000), max_size=5) | json_values,
            "n": st.integers(-1, 2**40) | json_values,
            "type": json_values,
        },
    ),
    lambda inner: st.fixed_dictionaries(
        {
            "k": st.sampled_from(["dict", "tuple", "list"]),
            "items": st.lists(inner | st.tuples(st.text(max_size=3), inner).map(list), max_size=3),
        }
    ),
    max_leaves=6,
)


@given(json_values | specs)
@example({"k": "array", "dtype": "|u1", "shape": [2**62, 4]})
@example({"k": "array", "dtype": "<U2000000000", "shape": [2]})
@example({"k": "array", "dtype": ",", "shape": [2]})
@example({"k": "array", "dtype": "|u1", "shape": [0, 2**23, 2**23, 2**23]})
@example({"k": "numbers", "dtype": "|u1", "shape": [2**23, 2**23, 2**23, 0]})
@example({"k": "scalar", "dtype": "|u1", "shape": [0]})
def test_any_description_gives_a_bounded_layout_or_malformed(spec: Any) -> None:
    try:
        layout = ValueCodec(spec)
    except MalformedValue:
        return
    assert 0 <= layout.size <= MAX_BYTES
    if layout.size < 100_000:
        try:
            layout.decode(bytes(layout.size))
        except MalformedValue:
            return
        assert str(layout)


@given(arrays.arrays(st.sampled_from(["u1", "<i8", "<f4", "?", "<c16"]), arrays.array_shapes(min_dims=0, max_side=5)))
def test_arrays_come_back_bit_by_bit(value: np.ndarray[Any, Any]) -> None:
    layout = ValueCodec({"k": "array", "dtype": value.dtype.str, "shape": list(value.shape)})
    back = layout.decode(value.tobytes())
    assert back.dtype == value.dtype
    assert back.shape == value.shape
    assert back.tobytes() == value.tobytes()


def test_nested_values_come_back() -> None:
    spec = {
        "k": "dict",
        "items": [["a", {"k": "int"}], ["b", {"k": "tuple", "items": [{"k": "bool"}, {"k": "float"}]}]],
    }
    data = (7).to_bytes(8, "little") + b"\x01" + np.float64(2.5).tobytes()
    assert ValueCodec(spec).decode(data) == {"a": 7, "b": (True, 2.5)}


@pytest.mark.parametrize("size", [0, 7, 9])
def test_another_number_of_bytes_is_refused(size: int) -> None:
    with pytest.raises(MalformedValue, match="bytes"):
        ValueCodec({"k": "int"}).decode(bytes(size))


def test_nesting_is_bounded() -> None:
    spec: dict[str, Any] = {"k": "int"}
    for _ in range(2_000):
        spec = {"k": "list", "items": [spec]}
    with pytest.raises(MalformedValue, match="nested"):
        ValueCodec(spec)


def test_layouts_of_other_types_have_other_tags() -> None:
    specs: list[dict[str, Any]] = [
        {"k": "array", "dtype": "|u1", "shape": [4]},
        {"k": "array", "dtype": "|u1", "shape": [2, 2]},
        {"k": "array", "dtype": "|i1", "shape": [4]},
        {"k": "other", "type": "a"},
        {"k": "other", "type": "b"},
        {"k": "tuple", "items": [{"k": "int"}]},
        {"k": "list", "items": [{"k": "int"}]},
    ]
    assert len({ValueCodec(spec).tag for spec in specs}) == len(specs)


@pytest.mark.parametrize("dtype", ["<U1", ">U1"])
def test_what_is_no_character_is_refused(dtype: str) -> None:
    with pytest.raises(MalformedValue):
        ValueCodec({"k": "numbers", "dtype": dtype, "shape": []}).decode(b"\xff" * 4)


_DTYPES = ("|b1", "|i1", "|u1", "<i4", ">i4", "<i8", "<u8", "<f2", "<f4", "<f8", ">f8")


def test_equal_numbers_of_any_type_are_plainly_equal() -> None:
    def plain(kind: str, dtype: str, shape: list[int], values: Any) -> Any:
        layout = ValueCodec({"k": "dict", "items": [["at", {"k": kind, "dtype": dtype, "shape": shape}]]})
        data = layout.plain(np.array(values, dtype).tobytes())
        assert data is not None
        return layout.plain_tag, bytes(data)

    assert len({plain("array", dtype, [2], [1, 0]) for dtype in _DTYPES}) == 1
    assert plain("array", "<i8", [2], [1, 0]) == plain("numbers", "<i8", [2], [1, 0])
    numbers = [plain("scalar", dtype, [], 1) for dtype in _DTYPES]
    assert {*numbers, plain("int", "<i8", [], 1), plain("float", "<f8", [], 1)} == {numbers[0]}
    assert plain("array", "<i8", [2], [1, 0]) != plain("array", "<i8", [2, 1], [1, 0])
    assert plain("scalar", "<f4", [], 0.1) != plain("scalar", "<f8", [], 0.1)


def test_no_numbers_become_equal_by_their_plain_form() -> None:
    assert (
        ValueCodec({"k": "scalar", "dtype": ">f8"}).plain(np.array(1e300, ">f8").tobytes()) == np.array(1e300).tobytes()
    )
    layout = ValueCodec({"k": "array", "dtype": "<i8", "shape": [1]})
    assert layout.plain(np.array([2**53]).tobytes()) == np.array([2.0**53]).tobytes()
    assert layout.plain(np.array([2**53 + 1]).tobytes()) is None
    assert ValueCodec({"k": "tuple", "items": [{"k": "int"}]}).plain((2**60).to_bytes(8, "little")) is None
