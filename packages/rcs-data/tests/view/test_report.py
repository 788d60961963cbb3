"""The report page is one file that needs nothing else, tells the truth and breaks on no dataset."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.errors import DatasetError
from rcs_data.files.durable import sealed, unsealed
from rcs_data.view import page as report
from rcs_data.view import write_report

SIZES = {"wrist": (48, 64), "side": (36, 36)}


def record(path: Path, verdicts: list[bool | None], *, cameras: bool = True, length: int = 12, **info: object) -> Path:
    features = [
        Feature(key="observation/joints", shape=(7,), dtype="float64", unit="rad"),
        Feature(key="observation/gripper", shape=(1,), dtype="float32"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
    ]
    for name, size in SIZES.items() if cameras else ():
        key = f"observation/frames/{name}/rgb"
        features.append(
            Feature(key=key, shape=(*size, 3), dtype="uint8", encoding="lossless" if name == "side" else "jpeg")
        )
    values = {"setup": {"robot": "fr3", "nested": {"deep": "<script>"}}, "instruction": "pick <it> & go", **info}
    with DatasetWriter.open(path, DatasetInfo(frequency=30.0, features=tuple(features), **values)) as writer:  # pyright: ignore[reportArgumentType]
        for number, success in enumerate(verdicts):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for i in range(length):
                    row: dict[str, Any] = {
                        "observation/joints": np.full(7, i / 10),
                        "observation/gripper": np.ones(1, np.float32),
                    }
                    row |= {"time/monotonic": i / 30}
                    for name, size in SIZES.items() if cameras else ():
                        row[f"observation/frames/{name}/rgb"] = np.full((*size, 3), 8 * i, np.uint8)
                    episode.add(row)
                episode.finish(success, {"failure": None if success is not False else "slip & <slide>"})
    return path


def facts(text: str) -> dict[str, Any]:
    """Return what the page says of the dataset."""
    found = re.search(r"<script>rcsDataset\((.*)\);\n</script>", text, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def clips(text: str) -> list[str]:
    return re.findall(r'data-clip="[^"]*">data:video/mp4;base64,([^<]+)</script>', text)


def test_the_page_is_whole_and_loads_nothing(tmp_path: Path) -> None:
    path = write_report(record(tmp_path / "picks", [True, False, None]), wall_time=10.0)
    assert path == tmp_path / "picks/report.html"
    text = path.read_text("utf-8")
    assert not re.findall(r"https?:|@import|url\(|<link|fetch\(|<script src", text)
    assert str(tmp_path) not in text
    assert len(clips(text)) == 6, "each camera of each episode, also the one without loss"
    assert all(base64.b64decode(clip, validate=True)[4:8] == b"ftyp" for clip in clips(text))


def test_the_numbers_are_those_of_the_dataset(tmp_path: Path) -> None:
    values = facts(write_report(record(tmp_path, [True, True, False, None]), wall_time=24.0).read_text("utf-8"))
    assert values["counts"] | {"successes": 2, "judged": 3, "rows": 48} == values["counts"]
    assert (values["counts"]["low"], values["counts"]["high"]) == pytest.approx((0.208, 0.939), abs=1e-3)
    assert values["failures"] == [["slip & <slide>", "1, 33.3 %"]]
    recording = dict(values["recording"])
    assert recording["episodes per hour"] == "600"
    assert recording["steps per second"] == "2"
    assert recording["mean period"] == "33.33 ms, wanted 33.33 ms"


def test_numbers_have_no_more_digits_than_anybody_reads(tmp_path: Path) -> None:
    text = write_report(record(tmp_path, [True], setup={"a": 0.1 + 0.2, "b": {"c": [1 / 3]}})).read_text("utf-8")
    assert not re.search(r"0\.3000000|0\.3333333", facts(text)["wholeSetup"] + str(facts(text)["setup"]))


def test_no_value_of_an_episode_becomes_html(tmp_path: Path) -> None:
    """Whatever a file says, and whatever of it is refused before: what is shown is text."""
    path = record(tmp_path / "picks", [False, True])
    scripts = write_report(path).read_text("utf-8").count("<script")
    evil = '</script><img src=x onerror="alert(1)">'
    for number, folder in enumerate(sorted((path / "episodes").iterdir())):
        about = unsealed((folder / "episode.json").read_bytes(), folder)
        about |= {"instruction": evil, "started": evil, "outcome": {"failure": evil, evil: [evil], "aborted": evil}}
        about |= {"seed": evil} if number else {}
        (folder / "episode.json").write_bytes(sealed(about))
    text = write_report(path).read_text("utf-8")
    assert "<img" not in text
    assert text.count("<script") == scripts - 3, "the second episode, and its clips, are not in the page"
    assert facts(text)["episodes"][0]["note"] == evil
    assert "seed" in facts(text)["episodes"][1]["why"], "an episode with a seed that is none is shown as damaged"


def test_damaged_episodes_are_listed_as_such(tmp_path: Path) -> None:
    record(tmp_path, [True, True, True])
    (tmp_path / "episodes/000000/episode.json").write_text("{}")
    (tmp_path / "episodes/000001/steps.parquet").write_bytes(b"PAR1")
    text = write_report(tmp_path).read_text("utf-8")
    first, second, third = facts(text)["episodes"]
    assert first["damaged"]
    assert second["why"].startswith("is damaged: Cannot read 000001/steps.parquet")
    assert "why" not in third
    assert len(clips(text)) == 2


def test_without_cameras_or_episodes_there_is_a_page_too(tmp_path: Path) -> None:
    text = write_report(record(tmp_path / "a", [True], cameras=False)).read_text("utf-8")
    assert not clips(text)
    assert facts(text)["curves"]
    assert facts(write_report(record(tmp_path / "b", [])).read_text("utf-8"))["episodes"] == []


def test_of_many_episodes_the_first_and_the_failures_are_in_detail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "_FIRST_IN_DETAIL", 3)
    monkeypatch.setattr(report, "_MOST_IN_DETAIL", 4)
    verdicts: list[bool | None] = [True, True, True, True, False, True, False, True]
    text = write_report(record(tmp_path, verdicts, cameras=False)).read_text("utf-8")
    assert re.findall(r'data-episode="(\w+)"', text) == ["000000", "000001", "000002", "000004"]
    left_out = [episode["id"] for episode in facts(text)["episodes"] if "left out" in episode.get("why", "")]
    assert left_out == ["000003", "000005", "000006", "000007"]
    assert facts(text)["counts"]["successes"] == 6, "all count"


def test_the_page_is_replaced_in_one_step_and_not_through_a_link(tmp_path: Path) -> None:
    record(tmp_path / "data", [True])
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "data/report.html").symlink_to(tmp_path / "mine")
    (tmp_path / "data/report.html.tmp").symlink_to(tmp_path / "mine")
    assert not write_report(tmp_path / "data").is_symlink()
    assert (tmp_path / "mine").read_text() == "mine"
    assert not list((tmp_path / "data").glob("*.tmp"))


def test_where_there_is_no_dataset_there_is_no_report(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no dataset"):
        write_report(tmp_path)
