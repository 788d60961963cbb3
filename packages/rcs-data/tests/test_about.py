"""What `episode.json` says is checked where it is read, whoever sealed it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset, check
from rcs_data.about import read_about
from rcs_data.cli.info import InfoCommand
from rcs_data.cli.program import run
from rcs_data.cli.view import ViewCommand
from rcs_data.durable import sealed, unsealed
from rcs_data.errors import CorruptEpisode
from rcs_data.json_file import MOST_DEPTH, parsed_json


def say(dataset: Path, **changes: Any) -> None:
    path = dataset / "episodes/000001/episode.json"
    path.write_bytes(sealed({**unsealed(path.read_bytes(), path), **changes}))


WRONG = [
    ("success", "yes"), ("success", 1), ("timing", None), ("timing", {"cameras": 3}), ("length", 10**18),
    ("timing", {"period": {"expected": 0.03, "max": 0.04}}),
    ("length", True), ("outcome", []), ("seed", "1"), ("seed", 2**130), ("instruction", None), ("content_hash", "x"),
    ("sha256", {"../../dataset.json": "0" * 64}), ("versions", {"rcs": 1}), ("source", {"dataset": "../x"}),
    ("source", {"dataset": "a", "episode": "../x"}),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value"), WRONG)
def test_what_cannot_be_is_named_by_check_and_refused_by_all_else(dataset: Path, field: str, value: Any) -> None:
    say(dataset, **{field: value})
    episode = Dataset.open(dataset)["000001"]
    with pytest.raises(CorruptEpisode, match=rf"000001/episode.json is damaged: {field} is .*; valid is "):
        _ = episode.success
    found = [finding for finding in check(dataset).damage if finding.episode == "000001"]
    assert field in found[0].message
    assert run(InfoCommand(path=dataset)) == 1
    assert run(ViewCommand(path=dataset)) == 0, "the page lists it as damaged"


@pytest.mark.parametrize(
    "text",
    ["[1]", '{"a": NaN}', '{"a": 1e999}', '{"a": "\\udcff"}', '{"a": ' + "1" * 5000 + "}", "{", '{"a": ' + "[" * 99999],
)
def test_json_that_no_dataset_has_is_refused(text: str) -> None:
    with pytest.raises(CorruptEpisode, match="somewhere is damaged"):
        parsed_json(text.encode(), "somewhere")


@pytest.mark.parametrize(("depth", "is_read"), [(MOST_DEPTH - 1, True), (MOST_DEPTH, False), (900, False)])
def test_values_are_nested_so_deep_and_no_deeper(depth: int, is_read: bool) -> None:
    text = '{"a": ' + "[" * depth + "]" * depth + "}"
    if is_read:
        assert "a" in parsed_json(text, "somewhere")
    else:
        with pytest.raises(CorruptEpisode, match="levels deep"):
            parsed_json(text, "somewhere")


def test_what_was_written_is_read(dataset: Path) -> None:
    for folder in (dataset / "episodes").iterdir():
        assert read_about(folder)["id"] == folder.name
