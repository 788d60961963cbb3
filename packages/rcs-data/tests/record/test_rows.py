"""A row that does not fit is refused with what came and what is valid, and leaves nothing behind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data.errors import InvalidSetup
from rcs_data.record.rows import RowBuffer

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows

STATE = 5  # the sim_state_size of make_info


@pytest.fixture
def buffer(make_info: MakeInfo, make_rows: MakeRows) -> RowBuffer:
    """A buffer whose first row is taken already."""
    rows = RowBuffer(make_info(images=True))
    rows.add(make_rows(1, images=True)[0], np.zeros(STATE))
    rows.take()
    return rows


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("observation/joints", np.zeros(4), r"observation/joints.*\(4,\) float64; expected \(3,\) float64"),
        ("observation/joints", np.zeros(3, np.float32), r"\(3,\) float32; expected \(3,\) float64"),
        ("observation/joints", [0.0, 0.0, 0.0], r"\[0.0, 0.0, 0.0\] \(list\); expected"),
        ("observation/joints", None, "None; expected"),
        ("action/index", np.zeros(2, np.int64), "expected .* int32"),
        ("reward", "high", "'high'"),
        ("reward", True, "True"),
        ("reward", None, "None"),
        ("terminated", 1, "expected .* bool"),
        ("time/monotonic", math.nan, "finite"),
        ("time/frames/wrist", math.inf, "finite"),
        ("observation/frames/wrist/rgb", np.zeros((24, 16, 3), np.uint8), "expected"),
        ("observation/frames/wrist/depth", np.zeros((8, 10), np.float32), "expected"),
    ],
)
def test_a_wrong_value_is_refused(buffer: RowBuffer, make_rows: MakeRows, key: str, value: Any, message: str) -> None:
    row = make_rows(2, images=True)[1]
    with pytest.raises(InvalidSetup, match=message):
        buffer.add({**row, key: value}, np.zeros(STATE))
    assert buffer.rows == 0
    buffer.add(row, np.zeros(STATE))
    batch = buffer.take()
    assert batch.num_rows == 1
    assert [len(column) for column in batch.columns] == [1] * batch.num_columns


def test_missing_and_unknown_keys_are_named(buffer: RowBuffer, make_rows: MakeRows) -> None:
    row = make_rows(2, images=True)[1]
    del row["reward"]
    with pytest.raises(InvalidSetup, match=r"missing reward; unknown speed\. Valid are action/index"):
        buffer.add({**row, "speed": 1.0}, np.zeros(STATE))


@pytest.mark.parametrize("state", [None, np.zeros(STATE + 1), np.zeros(STATE, np.float32)])
def test_a_wrong_simulation_state_is_refused(buffer: RowBuffer, make_rows: MakeRows, state: Any) -> None:
    with pytest.raises(InvalidSetup, match="Expected sim_state to be"):
        buffer.add(make_rows(2, images=True)[1], state)


def test_a_reset_has_no_action_and_no_reward(make_info: MakeInfo, make_rows: MakeRows) -> None:
    buffer = RowBuffer(make_info())
    row = make_rows(1)[0]
    with pytest.raises(InvalidSetup, match="first row"):
        buffer.add({**row, "reward": 0.0}, np.zeros(STATE))
    with pytest.raises(InvalidSetup, match="missing observation/joints"):
        buffer.add({"observation/gripper": row["observation/gripper"]}, np.zeros(STATE))
    buffer.add({**row, "reward": None}, np.zeros(STATE))
    batch = buffer.take()
    names = {name for name in batch.schema.names if batch.column(name).null_count}
    assert names == {"action/joints", "action/index", "reward"}


def test_a_time_that_was_not_measured_is_null_and_not_a_number(buffer: RowBuffer, make_rows: MakeRows) -> None:
    buffer.add({**make_rows(2, images=True)[1], "time/frames/wrist": None}, np.zeros(STATE))
    assert buffer.take().column("time/frames/wrist").to_pylist() == [None]


def test_numbers_of_the_right_kind_need_no_array(buffer: RowBuffer, make_rows: MakeRows) -> None:
    row = {**make_rows(2, images=True)[1], "reward": 1, "terminated": np.True_, "time/monotonic": np.float64(2.0)}
    buffer.add(row, np.zeros(STATE))
    batch = buffer.take()
    assert [batch.column(key)[0].as_py() for key in ("reward", "terminated", "time/monotonic")] == [1.0, True, 2.0]


def test_an_image_may_come_as_the_bytes_of_another_recording(buffer: RowBuffer, make_rows: MakeRows) -> None:
    row, key = make_rows(2, images=True)[1], "observation/frames/wrist/rgb"
    buffer.add(row, np.zeros(STATE))
    stored = buffer.take().column(key)[0].as_py()
    buffer.add({**row, key: stored}, np.zeros(STATE))
    assert buffer.take().column(key)[0].as_py() == stored
    with pytest.raises(InvalidSetup, match="observation/joints"):
        buffer.add({**row, "observation/joints": b"\0" * 24}, np.zeros(STATE))


@pytest.mark.parametrize("given", [b"", bytes(16 * 24 * 3), b"\xff\xd8 cut short", b"\x89PNG\r\n\x1a\n"])
def test_bytes_that_are_no_file_of_the_encoding_are_refused(
    buffer: RowBuffer, make_rows: MakeRows, given: bytes
) -> None:
    row = make_rows(2, images=True)[1]
    for key in ("observation/frames/wrist/rgb", "observation/frames/wrist/depth"):
        with pytest.raises(InvalidSetup, match=f"{key}.* {len(given)} bytes that are no file of its encoding"):
            buffer.add({**row, key: given}, np.zeros(STATE))
    assert buffer.rows == 0
