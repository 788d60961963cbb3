from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import msgpack
from vlagents.errors import BadMessage, InvalidInput
from vlagents.wire.bulk import LARGE
from vlagents.wire.openpi import observation_from_flat, pack, pack_parts, unpack
from vlagents.wire.stream import LARGEST_HEADER

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
def test_parts_are_what_the_whole_is_and_are_read_as_they_were(values: dict[str, Any]) -> None:
    given: dict[str, Any] = {name: large() if value == "array" else value for name, value in values.items()}
    data = b"".join(pack_parts(given))
    assert data == pack(given)
    assert same(unpack(data), given)


@given(NESTED, st.binary(min_size=1, max_size=5))
def test_large_messages_are_read_as_the_library_reads_them_and_to_the_end(value: Any, behind: bytes) -> None:
    data: Any = msgpack.encode([bytes(LARGE), value, bytes(LARGE)])
    came = unpack(data)
    assert [bytes(came[0]), came[1], bytes(came[2])] == [bytes(LARGE), value, bytes(LARGE)]
    for wrong in (data + behind, data[:-1], data[: LARGE + 6]):
        with pytest.raises(BadMessage):
            unpack(wrong)


def test_large_arrays_are_not_copied_and_all_can_be_written() -> None:
    data = bytearray(b"".join(pack_parts({"image": large(), "deep": {"image": large()}, "state": np.zeros(7)})))
    came = unpack(memoryview(data))
    for array in (came["image"], came["deep"]["image"]):
        assert np.shares_memory(array, np.frombuffer(data, np.uint8))
        array[0, 0] = 7
    came["state"][0] = 1.0


@pytest.mark.parametrize("one", [b"\x80", b"\x91\x90", b"\xa3abc", b"\xc4\x01a"])
def test_what_is_no_large_array_is_at_most_as_much_as_a_header(one: bytes) -> None:
    def message(count: int) -> bytes:
        return b"\x92" + msgpack.encode(bytes(LARGE)) + b"\xdd" + count.to_bytes(4, "big") + one * count

    count = LARGEST_HEADER // len(one)
    assert len(unpack(message(count - 10))[1]) == count - 10
    with pytest.raises(BadMessage, match=f"more than {LARGEST_HEADER} bytes"):
        unpack(message(count + 10))


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


@pytest.mark.parametrize("number", [np.float32(1.5), np.int8(-3), np.bool_(True), np.uint64(2**63)])
def test_numbers_of_numpy_come_as_they_were(number: np.generic) -> None:
    (came,) = unpack(pack([number]))
    assert (type(came), came) == (type(number), number)


@pytest.mark.parametrize(("dtype", "value"), [(b"|O", 1), ("|O", 1), ("<f8", "x"), ("|u1", 300), ("|i1", 1e400)])
def test_numbers_that_are_none_are_refused(dtype: Any, value: Any) -> None:
    with pytest.raises(BadMessage):
        unpack(msgpack.encode({b"__npgeneric__": True, b"data": value, b"dtype": dtype}))


@pytest.mark.parametrize(("shape", "seen"), [((3, 4, 5), (4, 5, 3)), ((4, 5, 3), (4, 5, 3)), ((3, 5, 3), (3, 5, 3))])
def test_images_with_the_channels_first_are_transposed(shape: tuple[int, ...], seen: tuple[int, ...]) -> None:
    image = np.arange(math.prod(shape), dtype=np.uint8).reshape(shape)
    found = observation_from_flat({"eye": {"left": image}, "joints": 1.0, "prompt": "pick"}, "a", 2.0)
    assert found.images["eye/left"].shape == seen  # type: ignore[union-attr]
    assert (found.state["joints"].tolist(), found.instruction, found.session, found.time) == ([1.0], "pick", "a", 2.0)


@pytest.mark.parametrize("given", [5, {"a": "text"}, {3: 1.0}, {"a": np.zeros((2, 2))}, {"a": np.zeros((2, 2, 3, 1))}])
def test_what_is_no_observation_of_openpi_is_refused(given: Any) -> None:
    with pytest.raises(InvalidInput):
        observation_from_flat(given)
