"""Pickles are written and read, and never run."""

from __future__ import annotations

import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vlagents import BadMessage, InvalidInput
from vlagents.other_wires import inert

CHUNK = (Path(__file__).parent / "lerobot_chunk.pickle").read_bytes()
"""What LeRobot 0.4.4 sends, with torch 2.13.0, for two actions of three numbers."""
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(st.characters(codec="utf-8")),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
)


class Canary:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@given(PLAIN)
def test_python_reads_what_is_written(value: Any) -> None:
    assert pickle.loads(inert.write(value)) == value


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_plain_values_are_read_whatever_the_protocol(protocol: int) -> None:
    value = {"a": [1, -300, 70000, 2**40, 2.5, None, True, "ä" * 300], "b": ((), (1,), (1, 2, 3, 4)), "c": {"d": []}}
    assert inert.read(pickle.dumps(value, protocol)) == value


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.int64, ">f8"])
def test_arrays_arrive_as_they_were_and_can_be_written_to(dtype: Any) -> None:
    array = np.arange(24).astype(dtype).reshape(2, 3, 4)[:, ::2]
    found = pickle.loads(inert.write(array))
    np.testing.assert_array_equal(found, array)
    assert found.flags.writeable


def test_what_has_no_place_on_the_wire_is_refused_before_it_is_sent() -> None:
    with pytest.raises(InvalidInput, match="set"):
        inert.write({"a": {1, 2}})


def test_a_chunk_of_lerobot_is_read_without_torch() -> None:
    timed = inert.read(CHUNK)
    assert [one.state["timestep"] for one in timed] == [3, 4]
    assert [inert.numbers(one.state["action"]).tolist() for one in timed] == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("protocol", [0, 1, 2, 4, 5])
@pytest.mark.parametrize("where", [lambda bad: bad, lambda bad: [bad], lambda bad: {"action": (1, bad)}])
def test_nothing_that_a_pickle_wants_to_call_is_called(protocol: int, where: Any, tmp_path: Path) -> None:
    data = pickle.dumps(where(Canary(tmp_path / "ran")), protocol)
    with pytest.raises(BadMessage):
        inert.read(data)
    assert not (tmp_path / "ran").exists()


def test_the_memory_of_a_tensor_is_no_way_in_either(tmp_path: Path) -> None:
    memory = pickle.dumps(Canary(tmp_path / "ran"), 2)
    tensor = inert.Call(inert.TENSOR, (inert.Call(inert.STORAGE, (memory,)), 0, (3,), (1,)))
    with pytest.raises(BadMessage):
        inert.numbers(tensor)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b".",
        b"\x80\x04(.",
        b"\x80\x04N",
        b"\x80\x04t.",
        b"\x80\x04\x94.",
        b"\x80\x04h\x07.",
        b"\x80\x04NNs.",
        b"\x80\x04]NK\x01b.",
        b"\x80\x04}(K\x01K\x02u.",
        b"\x80\x04\x8e" + struct.pack("<Q", 2**63) + b"x.",
        b"\x80\x04X" + struct.pack("<I", 2**32 - 1) + b"x.",
        b"cos\nsystem\n(S'true'\ntR.",
        b"\x80\x04cos\nsystem\n.\x00",
    ],
)
def test_garbage_is_a_bad_message(data: bytes) -> None:
    with pytest.raises(BadMessage):
        inert.numbers(inert.read(data))


def test_a_tensor_outside_its_memory_is_refused() -> None:
    good = inert.read(CHUNK)[0].state["action"]
    storage = good.arguments[0]
    for offset, shape, strides in [(6, (1,), (1,)), (0, (7,), (1,)), (0, (3,), (3,)), (-1, (3,), (1,)), (0, (0,), (1,)),
                                   (0, (2**30,), (0,)), (0, (3,), (1, 1)), (0, 3, 1), (True, (3,), (1,))]:  # fmt: skip
        with pytest.raises(BadMessage):
            inert.numbers(inert.Call(inert.TENSOR, (storage, offset, shape, strides)))


@given(st.integers(0, len(CHUNK) - 1), st.integers(0, 255), st.booleans())
def test_a_damaged_chunk_is_numbers_or_a_bad_message(place: int, byte: int, is_cut: bool) -> None:
    data = CHUNK[:place] if is_cut else CHUNK[:place] + bytes([byte]) + CHUNK[place + 1 :]
    try:
        found = inert.read(data)
        for one in found if isinstance(found, list) else []:
            state = one.state if isinstance(one, inert.Call) else None
            inert.numbers(state.get("action") if isinstance(state, dict) else None)
    except BadMessage:
        pass
