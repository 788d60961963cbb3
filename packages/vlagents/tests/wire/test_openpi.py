from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vlagents.errors import BadMessage
from vlagents.wire.openpi import LARGE, _unpacked, pack, pack_parts, unpack
from vlagents.wire.skip import end_of

PLAIN = (
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text() | st.binary()
)
NESTED = st.recursive(PLAIN, lambda inside: st.lists(inside) | st.dictionaries(st.text(), inside), max_leaves=20)


def large(seed: int = 0) -> np.ndarray[Any, Any]:
    return np.random.default_rng(seed).integers(0, 256, (160, 160, 3), np.uint8)


def same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and bool((one == other).all())
    return one == other and type(one) is type(other)


@given(st.dictionaries(st.text(), NESTED | st.just("array"), max_size=20))
def test_parts_are_what_the_whole_is_and_are_read_in_place_alike(values: dict[str, Any]) -> None:
    given: dict[str, Any] = {name: large() if value == "array" else value for name, value in values.items()}
    data = b"".join(pack_parts(given))
    assert data == pack(given)
    assert same(unpack(data), _unpacked(data))


@given(NESTED, st.binary(max_size=5))
def test_the_end_of_a_value_is_where_the_library_stops(value: Any, behind: bytes) -> None:
    data: Any = msgpack.packb(value)
    assert end_of(memoryview(data + behind), 0) == len(data)
    if data:
        assert end_of(memoryview(data[:-1]), 0) is None


def test_large_arrays_are_not_copied_and_are_read_only() -> None:
    data = b"".join(pack_parts({"image": large(), "prompt": "pick"}))
    image = unpack(data)["image"]
    assert np.shares_memory(image, np.frombuffer(data, np.uint8))
    assert not image.flags.writeable


@pytest.mark.parametrize("change", [b"|O", b"<c8"])
def test_a_large_array_of_objects_is_refused(change: bytes) -> None:
    data = b"".join(pack_parts({"image": large()}))
    assert len(data) > LARGE
    with pytest.raises(BadMessage):
        unpack(data.replace(b"|u1", change[:3].ljust(3)))
    with pytest.raises(BadMessage):
        unpack(data.replace(b"\xcc\xa0", b"\xcc\xa1"))
    with pytest.raises(BadMessage):
        unpack(data[:-1])
