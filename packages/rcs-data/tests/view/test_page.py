"""The page is complete, needs nothing else, shows the dataset of today, and leaves it as it is."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature, check, edit, recover
from rcs_data.cli import VERBS
from rcs_data.cli.program import Program
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.view import ClipOptions, ViewReport, write_view
from rcs_data.view.clips import pictures, write_clip
from rcs_data.view.rendering import clip_name


@pytest.fixture
def copy(filmed: Path, tmp_path: Path) -> Path:
    """A dataset of one's own, to change."""
    return shutil.copytree(filmed, tmp_path / "data", ignore=shutil.ignore_patterns("view"))


def call(path: Path) -> dict[str, Any]:
    """Return the values in a script that is one call."""
    found = re.fullmatch(r"rcs(?:Dataset|Episode)\((.*)\);\n", path.read_text("ascii"), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def counts(report: ViewReport) -> tuple[int, int]:
    return report.rendered, report.damaged


def rerecord(path: Path, success: bool, *, scale: float) -> None:
    """Record episode 000001 anew."""
    info = Dataset.open(path).info
    edit.delete(path, ["000001"])
    with DatasetWriter.open(path, info, resume=True) as writer, writer.episode("000001", seed=1) as episode:
        for row in range(5):
            values: dict[str, Any] = {
                feature.key: np.full(feature.shape, scale * row).astype(feature.dtype)[()] for feature in info.features
            }
            episode.add(values if row else {k: v for k, v in values.items() if k not in ("action/joints", "reward")})
        episode.finish(success)


def test_the_page_has_all_that_it_loads_and_loads_nothing_from_elsewhere(copy: Path) -> None:
    report = write_view(copy)
    folder = copy / "view"
    assert report.path == folder / "index.html"
    assert counts(report) == (3, 0)
    index = report.path.read_text("utf-8")
    linked = re.findall(r'(?:src|href)="([^"]+)"', index)
    assert "dataset.js" in linked
    assert all((folder / name).is_file() for name in linked)
    for file in folder.glob("*.*"):
        assert not re.search(
            r"https?:|//[a-z]+\.|@import|url\(|fetch\(|XMLHttp|innerHTML|eval\(", file.read_text("utf-8")
        )
        assert str(copy) not in file.read_text("utf-8")
    assert report.size == sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    values = call(folder / "dataset.js")
    for episode in values["episodes"]:
        for picture in values["pictures"]:
            assert (folder / "clips" / episode["id"] / picture["file"]).is_file()


def test_the_catalogue_says_what_the_dataset_says(copy: Path) -> None:
    write_view(copy)
    values = call(copy / "view/dataset.js")
    assert values["name"] == "data"
    assert values["instruction"] == "pick it up"
    assert values["counts"] | {"judged": 2, "successes": 1, "rows": 98} == values["counts"]
    assert values["counts"]["low"] == pytest.approx(0.0945, abs=1e-3)
    assert [picture["label"] for picture in values["pictures"]] == ["side", "side depth", "wrist"]
    assert [curve["label"] for curve in values["curves"]][:1] == ["observation \N{MIDDLE DOT} joints"]
    entries = {entry["id"]: entry for entry in values["episodes"]}
    assert [(entry["success"], entry["rows"], entry["seed"]) for entry in entries.values()] == [
        (True, 40, "7"), (False, 25, "8"), (None, 33, "9"),
    ]  # fmt: skip
    assert entries["000001"]["note"] == "slip"
    assert "instruction" not in entries["000001"], "it is the dataset's"
    assert entries["000000"]["flaws"] == {"stale": 3, "gap": 2}


def test_every_clip_has_a_frame_for_each_row(copy: Path) -> None:
    write_view(copy)
    for episode in Dataset.open(copy).episodes:
        data = call(copy / f"view/episodes/{episode.id}.js")
        assert data["id"] == episode.id
        assert data["rows"] == episode.length
        assert all(len(line) == episode.length for lines in data["curves"] for line in lines)
        for feature in pictures(episode.info):
            with av.open(str(copy / "view/clips" / episode.id / clip_name(feature))) as container:
                assert sum(1 for _ in container.decode(video=0)) == episode.length


def test_a_second_page_shows_what_has_changed(copy: Path) -> None:
    write_view(copy)
    rerecord(copy, True, scale=2.0)
    assert counts(write_view(copy)) == (3, 0)
    entry = call(copy / "view/dataset.js")["episodes"][1]
    assert (entry["success"], entry["rows"]) == (True, 5)
    assert call(copy / "view/episodes/000001.js")["rows"] == 5


def test_only_what_has_changed_is_rendered_again(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[str] = []

    def note(record: EpisodeRecord, *arguments: Any) -> Any:
        rendered.append(record.id)
        return write_clip(record, *arguments)

    monkeypatch.setattr("rcs_data.view.rendering.write_clip", note)
    write_view(copy)
    before = call(copy / "view/dataset.js")["episodes"]
    rendered.clear()
    edit.relabel(copy, "push")
    assert counts(write_view(copy)) == (3, 0)
    assert (rendered, call(copy / "view/dataset.js")["episodes"]) == ([], before)
    rerecord(copy, True, scale=2.0)
    (copy / "view/clips/000002" / clip_name(pictures(Dataset.open(copy).info)[0])).unlink()
    write_view(copy)
    assert set(rendered) == {"000001", "000002"}
    rendered.clear()
    write_view(copy, options=ClipOptions(height=32))
    assert set(rendered) == {"000000", "000001", "000002"}


def test_what_is_gone_from_the_dataset_or_half_done_is_gone_from_the_page(copy: Path) -> None:
    write_view(copy)
    edit.delete(copy, ["000001"])
    (copy / "view/episodes/000002.js").write_bytes(b"rcsEp")  # as if it had been cut short
    assert counts(write_view(copy)) == (2, 0)
    assert call(copy / "view/episodes/000002.js")["id"] == "000002"
    assert sorted(path.name for path in (copy / "view/episodes").iterdir()) == ["000000.js", "000002.js"]
    assert sorted(path.name for path in (copy / "view/clips").iterdir()) == ["000000", "000002"]


def test_the_page_in_the_dataset_does_not_disturb_it(copy: Path) -> None:
    before = check(copy)
    assert before.is_ok
    hashes = [episode.content_hash for episode in Dataset.open(copy).episodes]
    write_view(copy)
    after = check(copy)
    assert after.is_ok
    assert (after.episodes, after.rows, after.frames) == (before.episodes, before.rows, before.frames)
    assert [episode.content_hash for episode in Dataset.open(copy).episodes] == hashes
    with DatasetWriter.open(copy, Dataset.open(copy).info, resume=True) as writer:
        assert writer.recovered.failed == ()
    assert len(Dataset.open(copy)) == 3
    assert recover(copy).recovered == ()


def test_some_episodes_are_chosen_by_id_or_pattern(copy: Path, tmp_path: Path) -> None:
    assert counts(write_view(copy, tmp_path / "a", episodes=["00000[02]"])) == (2, 0)
    assert [entry["id"] for entry in call(tmp_path / "a/dataset.js")["episodes"]] == ["000000", "000002"]
    assert counts(write_view(copy, tmp_path / "a", episodes=["000002", "000001"])) == (2, 0)
    assert sorted(path.name for path in (tmp_path / "a/episodes").iterdir()) == ["000001.js", "000002.js"]
    with pytest.raises(InvalidSetup, match="'9\\*'; it has 3 episodes"):
        write_view(copy, tmp_path / "b", episodes=["000001", "9*"])
    assert not (tmp_path / "b").exists()


def test_a_folder_of_other_things_is_left_alone(copy: Path, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home/thesis.tex").write_text("years of work")
    (tmp_path / "home/episodes").mkdir()
    with pytest.raises(DatasetError, match="has other things in it"):
        write_view(copy, tmp_path / "home")
    with pytest.raises(DatasetError, match="has other things in it"):
        write_view(copy, copy)
    assert sorted(path.name for path in (tmp_path / "home").iterdir()) == ["episodes", "thesis.tex"]
    assert check(copy).is_ok


def test_the_folder_of_a_page_may_be_named_like_an_address(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert counts(write_view(copy, "12:30")) == (3, 0)
    assert len(list((tmp_path / "12:30/clips").rglob("*.mp4"))) == 9


def test_names_of_clips_differ_where_features_do() -> None:
    keys = ["observation/frames/a b/rgb", "observation/frames/a-b/rgb", "observation/frames/a/b/rgb", "frames/日本/rgb"]
    names = [clip_name(Feature(key=key, shape=(8, 8, 3), dtype="uint8", encoding="jpeg")) for key in keys]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[A-Za-z0-9-]+\.mp4", name) for name in names)


def test_an_empty_dataset_has_a_page_too(tmp_path: Path, make_info: Any) -> None:
    with DatasetWriter.open(tmp_path / "data", make_info()):
        pass
    assert counts(write_view(tmp_path / "data")) == (0, 0)
    values = call(tmp_path / "data/view/dataset.js")
    assert values["episodes"] == []
    assert values["counts"]["judged"] == 0


def test_progress_is_told(copy: Path) -> None:
    told: list[tuple[int, int]] = []
    write_view(copy, on_progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_numbers_that_json_does_not_have_are_gaps(tmp_path: Path) -> None:
    feature = Feature(key="observation/force", shape=(1,), dtype="float64")
    info = DatasetInfo(frequency=30, features=(feature,), setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "data", info) as writer:
        episode = writer.episode("a", seed=0)
        for value in (1.0, np.nan, np.inf, 2.0):
            episode.add({"observation/force": np.array([value])})
        episode.finish(None)
    write_view(tmp_path / "data")
    assert call(tmp_path / "data/view/episodes/a.js")["curves"] == [[[1, None, None, 2]]]


def test_the_command_says_what_it_did_and_where_the_page_is(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main = Program("rcs-data", VERBS, "0").main
    with pytest.raises(SystemExit) as ended:
        main(["view", str(copy)])
    assert ended.value.code == 0
    output = capsys.readouterr().out
    assert "3 episodes; " in output
    assert str(copy / "view/index.html") in output
    with pytest.raises(SystemExit) as ended:
        main(["view", str(copy), "--episodes", "no"])
    assert ended.value.code == 1
    assert "No episode" in capsys.readouterr().err
