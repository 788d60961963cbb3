from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from msgspec import msgpack
from vlagents import BadMessage, InvalidInput
from vlagents.wire.message import ARRAY, DTYPES, pack, unpack

arrays = st.sampled_from(sorted(DTYPES)).flatmap(
    lambda dtype: npst.arrays(np.dtype(dtype), npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
)
plain = st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | st.text() | st.binary()
values = st.recursive(
    plain | arrays,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def sent(given_values: Any) -> Any:
    header, parts, size = pack({"value": given_values})
    body = b"".join(parts)
    assert len(body) == size
    return unpack(header, body)["value"]


def assert_same(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


@given(values)
def test_what_is_sent_comes_as_it_was(given_values: Any) -> None:
    assert_same(sent(given_values), given_values)


def test_arrays_come_aligned_and_can_be_written_and_small_ones_do_not_keep_pictures() -> None:
    header, parts, _ = pack({"a": np.zeros(3, np.uint8), "b": np.arange(5.0), "c": np.zeros((200, 200, 3), np.uint8)})
    body = np.frombuffer(bytearray(b"".join(parts)), np.uint8)
    came = unpack(header, body)
    assert all(array.flags.writeable and array.flags.aligned for array in came.values())
    assert {name for name, array in came.items() if np.shares_memory(array, body)} == {"c"}


def test_arrays_that_lie_in_each_other_are_refused() -> None:
    described = msgpack.Ext(ARRAY, msgpack.encode(["<f8", [1000], 0]))
    with pytest.raises(BadMessage, match="lie in others"):
        unpack(msgpack.encode({"a": [described] * 2}), bytes(8000))


def test_views_that_are_not_contiguous_travel() -> None:
    image = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    np.testing.assert_array_equal(sent(image[::2, ::-1]), image[::2, ::-1])


@pytest.mark.parametrize("value", [object(), 1j, np.array([object()]), np.array(["a"]), np.zeros(2, np.complex128)])
def test_what_does_not_travel_is_said_before_anything_is_sent(value: Any) -> None:
    with pytest.raises(InvalidInput, match="does not travel"):
        pack({"a": value})


def array(*described: Any) -> bytes:
    return msgpack.encode({"a": msgpack.Ext(ARRAY, msgpack.encode(list(described)))})


@pytest.mark.parametrize(
    "header",
    [
        array("<f8", [2], 0),  # longer than the body
        array("<f8", [1], 8),
        array("<f8", [2**63], 0),
        array("<f8", [2**40, 2**40], 0),
        array("<f8", [-1], 0),
        array("<f8", [1], -8),
        array("<f8", [True], 0),
        array("<f8", [1.0], 0),
        array("<f8", 1, 0),
        array("<f8", [1] * 9, 0),
        array("|O", [1], 0),
        array("<U1", [1], 0),
        array(["<f8"], [1], 0),
        array("<f8", [1]),
        msgpack.encode({"a": msgpack.Ext(7, b"")}),
        msgpack.encode({"a": msgpack.Ext(ARRAY, b"\xc1")}),
        msgpack.encode({(1, 2): 3}),
        msgpack.encode([1]),
        b"\xc1",
        b"",
        b"\x81\xa1a" + b"\x91" * 5000,
        msgpack.encode({}) + b"rest",
    ],
)
def test_what_is_no_message_is_refused(header: bytes) -> None:
    with pytest.raises(BadMessage):
        unpack(header, bytes(8))
