from __future__ import annotations

from typing import Any

import pytest
from rcs_data.convert.provenance import Provenance, checked_provenance
from rcs_data.errors import CorruptEpisode

WHOLE: dict[str, Any] = {
    "episode": "000001",
    "seed": 3,
    "success": True,
    "outcome": {"failure": None},
    "instruction": "pick the cuboid",
    "rows": 20,
}


def test_what_was_written_is_taken() -> None:
    for success in (True, False, None):
        given = {**WHOLE, "success": success, "seed": None}
        assert checked_provenance(given, "a file") == given


@pytest.mark.parametrize("field", Provenance.__annotations__)
def test_a_field_that_is_missing_is_named(field: str) -> None:
    given = {key: value for key, value in WHOLE.items() if key != field}
    with pytest.raises(CorruptEpisode, match=rf"a file is damaged.*{field}"):
        checked_provenance(given, "a file")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("episode", "../escaped"),
        ("episode", 1),
        ("seed", 1.5),
        ("seed", True),
        ("success", "yes"),
        ("success", 1),
        ("outcome", None),
        ("instruction", 5),
        ("rows", 0),
    ],
)
def test_a_field_that_cannot_be_is_named(field: str, value: Any) -> None:
    with pytest.raises(CorruptEpisode, match=field):
        checked_provenance({**WHOLE, field: value}, "a file")
