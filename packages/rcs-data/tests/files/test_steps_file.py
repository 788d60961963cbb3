"""Whatever bit of `steps.parquet` changes, no reader gets a wrong number in silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from rcs_data import DatasetInfo, Feature
from rcs_data.errors import CorruptEpisode
from rcs_data.files.steps_file import StepsWriter, read_steps

FEATURES = (
    Feature(key="observation/joints", shape=(2,), dtype="float64"),
    Feature(key="observation/held", shape=(2,), dtype="float32", encoding="held"),
    Feature(key="action/joints", shape=(2,), dtype="float64"),
    Feature(key="reward", shape=(), dtype="float64"),
    Feature(key="terminated", shape=(), dtype="bool"),
)
INFO = DatasetInfo(frequency=30, features=FEATURES, setup={}, instruction="", sim_state_size=2)
ROWS = 4


def written(path: Path) -> pa.Table:
    """Write a file whose first row has no action, and return what is to be read from it."""
    rng, is_first = np.random.default_rng(0), np.arange(ROWS) == 0
    columns: list[pa.Array] = []
    for field, key in zip(INFO.stream_schema, INFO.stream_schema.names, strict=True):
        has_none = pa.array(is_first & (key in ("action/joints", "reward")))
        numbers = rng.random(2 * ROWS) > 0.5 if key == "terminated" else rng.normal(size=2 * ROWS)
        if pa.types.is_fixed_size_list(field.type):
            values = pa.array(numbers, field.type.value_type)
            columns.append(pa.FixedSizeListArray.from_arrays(values, 2, mask=has_none))
        else:
            columns.append(pa.array(numbers[:ROWS], field.type, mask=np.array(has_none)))
    with StepsWriter(path, INFO, "take") as file:
        file.write(pa.table(columns, INFO.stream_schema))
        file.complete()
    return read_steps(path, INFO, ROWS, INFO.stream_schema.names)


@pytest.mark.parametrize("stride", [pytest.param(1, marks=pytest.mark.slow), 7])
def test_a_flipped_bit_is_an_error_or_changes_nothing(tmp_path: Path, stride: int) -> None:
    path = tmp_path / "steps.parquet"
    expected = written(path)
    data, errors = path.read_bytes(), 0
    for bit in range(0, 8 * len(data), stride):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        for name in INFO.stream_schema.names:
            try:
                found = read_steps(path, INFO, ROWS, [name])
            except CorruptEpisode:
                errors += 1
            else:
                assert found.equals(expected.select([name])), f"{name}, byte {bit // 8} of {len(data)}, bit {bit % 8}"
    assert errors
