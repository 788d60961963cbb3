"""The report page is one file that needs nothing else, tells the truth and breaks on no dataset."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import av
import numpy as np
import pytest

from rcs.data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs.data.durable import sealed, unsealed
from rcs.errors import DatasetError
from rcs.rollout import report
from rcs.rollout.clip import encode_clip
from rcs.rollout.report import write_report

SIZES = {"wrist": (48, 64), "side": (36, 36)}
VOID = {"meta", "input", "br"}


def record(path: Path, verdicts: list[bool | None], *, cameras: bool = True, length: int = 12, **info: object) -> Path:
    features = [
        Feature(key="observation/joints", shape=(7,), dtype="float64", unit="rad"),
        Feature(key="observation/gripper", shape=(1,), dtype="float32"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
    ]
    for name, size in SIZES.items() if cameras else ():
        key = f"observation/frames/{name}/rgb"
        features.append(Feature(key=key, shape=(*size, 3), dtype="uint8", encoding="jpeg"))
    values = {"setup": {"robot": "fr3", "nested": {"deep": "<script>"}}, "instruction": "pick <it> & go", **info}
    with DatasetWriter.open(path, DatasetInfo(frequency=30.0, features=tuple(features), **values)) as writer:  # pyright: ignore[reportArgumentType]
        for number, success in enumerate(verdicts):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for i in range(length):
                    row = {"observation/joints": np.full(7, i / 10), "observation/gripper": np.ones(1, np.float32)}
                    row |= {"time/monotonic": i / 30}  # pyright: ignore[reportAssignmentType]
                    for name, size in SIZES.items() if cameras else ():
                        row[f"observation/frames/{name}/rgb"] = np.full((*size, 3), 8 * i, np.uint8)
                    episode.add(row)
                episode.finish(success, {"failure": None if success is not False else "slip & <slide>"})
    return path


class Page(HTMLParser):
    """Collects the tags of a page and fails where they do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag and what it loads."""
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "poster")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close the innermost tag, which must be this one."""
        assert self.open.pop() == tag


def test_the_page_is_whole_and_loads_nothing(tmp_path: Path) -> None:
    path = write_report(record(tmp_path / "picks", [True, False, None]), wall_time=10.0)
    assert path == tmp_path / "picks/report.html"
    text = path.read_text("utf-8")
    page = Page(text)
    assert page.tags.count("video") == 3
    assert all(link.startswith("data:video/mp4;base64,") for link in page.links)
    assert not re.findall(r"https?:|@import|url\(|<link|fetch\(", text)
    assert str(tmp_path) not in text
    assert "$" not in text


def test_the_numbers_are_those_of_the_dataset(tmp_path: Path) -> None:
    text = write_report(record(tmp_path, [True, True, False, None]), wall_time=24.0).read_text("utf-8")
    assert "<b>2 of 3</b> judged episodes succeeded: 66.7 %, 95 % interval 20.8 to 93.9 %" in text
    assert "nobody judged them or they are damaged: 1." in text
    assert "<b>600</b><span>episodes per hour" in text
    assert "<b>2</b><span>steps per second" in text
    assert "33.33 ms (wanted 33.33 ms)" in text


def test_words_from_the_dataset_are_not_taken_for_html(tmp_path: Path) -> None:
    text = write_report(record(tmp_path, [False])).read_text("utf-8")
    assert "pick &lt;it&gt; &amp; go" in text
    assert "slip &amp; &lt;slide&gt;" in text
    assert text.count("<script>") == 1


def test_no_value_of_an_episode_becomes_html(tmp_path: Path) -> None:
    """Whatever a file says, and whatever of it is refused before: what is shown is text."""
    path = record(tmp_path / "picks", [False, True])
    evil = '<img src=x onerror="alert(1)">'
    for number, folder in enumerate(sorted((path / "episodes").iterdir())):
        about = unsealed((folder / "episode.json").read_bytes(), folder)
        about |= {"instruction": evil, "started": evil, "outcome": {"failure": evil, evil: [evil], "aborted": evil}}
        about |= {"seed": evil} if number else {}
        (folder / "episode.json").write_bytes(sealed(about))
    text = write_report(path).read_text("utf-8")
    assert "<img" not in text
    assert "&lt;img" in text
    assert "seed is" in text, "an episode with a seed that is none is shown as damaged"
    Page(text)


def test_the_clip_shows_all_cameras_at_the_recorded_speed(tmp_path: Path) -> None:
    record(tmp_path, [True], length=31)
    clip = encode_clip(Dataset.open(tmp_path).episodes[0])
    assert clip is not None
    with av.open(io.BytesIO(clip)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert stream.codec_context.name == "h264"
        assert stream.average_rate == 15
    assert len(frames) == 16
    assert frames[0].shape == (48, 64 + 36, 3)
    brightness = [frame[:30, :60].mean() for frame in frames[:6]]
    np.testing.assert_allclose(brightness, [16 * i for i in range(6)], atol=6)


def test_a_large_image_becomes_a_small_clip(tmp_path: Path) -> None:
    info = DatasetInfo(
        frequency=30,
        features=(Feature(key="observation/frames/a/rgb", shape=(481, 640, 3), dtype="uint8", encoding="jpeg"),),
        setup={},
        instruction="",
    )
    with DatasetWriter.open(tmp_path, info) as writer:
        episode = writer.episode("a", seed=0)
        episode.add({"observation/frames/a/rgb": np.zeros((481, 640, 3), np.uint8)})
        clip = encode_clip(episode.finish(None))
    assert clip is not None
    with av.open(io.BytesIO(clip)) as container:
        assert 150 < container.streams.video[0].height <= 224


def test_without_cameras_the_page_says_so(tmp_path: Path) -> None:
    text = write_report(record(tmp_path, [True], cameras=False)).read_text("utf-8")
    assert "without a colour camera" in text
    assert "video" not in Page(text).tags
    assert "svg" in Page(text).tags


def test_damaged_episodes_are_listed_as_such(tmp_path: Path) -> None:
    record(tmp_path, [True, True, True])
    (tmp_path / "episodes/000000/episode.json").write_text("{}")
    (tmp_path / "episodes/000001/steps.parquet").write_bytes(b"PAR1")
    text = write_report(tmp_path).read_text("utf-8")
    Page(text)
    assert ">damaged</span>" in text
    assert "This episode is damaged: steps.parquet does not read" in text


def test_an_empty_dataset_has_a_page_too(tmp_path: Path) -> None:
    text = write_report(record(tmp_path, [])).read_text("utf-8")
    Page(text)
    assert "No episode is complete yet." in text


def test_of_many_episodes_the_first_and_the_failures_are_in_detail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "_ALL_IN_DETAIL", 6)
    monkeypatch.setattr(report, "_FIRST_IN_DETAIL", 3)
    verdicts = [True, True, True, True, False, True, False, True]
    text = write_report(record(tmp_path, verdicts, cameras=False)).read_text("utf-8")
    assert Page(text).tags.count("template") == 5
    assert "for 5 of 8 episodes: the first 3, and failures" in text


def test_the_page_is_replaced_in_one_step(tmp_path: Path) -> None:
    record(tmp_path, [True])
    first = write_report(tmp_path).read_bytes()
    assert len(write_report(tmp_path).read_bytes()) == len(first)
    assert not list(tmp_path.glob("*.tmp"))


def test_where_there_is_no_dataset_there_is_no_report(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no dataset"):
        write_report(tmp_path)


def test_clips_are_valid_base64(tmp_path: Path) -> None:
    text = write_report(record(tmp_path, [True])).read_text("utf-8")
    (data,) = re.findall(r"base64,([^\"]+)", text)
    assert base64.b64decode(data, validate=True)[4:8] == b"ftyp"
