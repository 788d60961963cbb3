"""In a notebook, a dataset is a table with pictures; words of it are words."""

from __future__ import annotations

import base64
import re
import shutil
from pathlib import Path

import numpy as np
import simplejpeg
from numpy.typing import NDArray
from rcs_data import Dataset, EpisodeRecord
from rcs_data.view import picture_tag


def html(shown: Dataset | EpisodeRecord) -> str:
    return shown._repr_html_()  # pyright: ignore[reportPrivateUsage]  # what a notebook calls


def pictures(text: str) -> list[NDArray[np.uint8]]:
    found = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', text)
    return [simplejpeg.decode_jpeg(base64.b64decode(data, validate=True)) for data in found]


def test_a_picture_is_inside_of_its_tag_and_its_title_is_text() -> None:
    tag = picture_tag(np.full((400, 600, 3), 128, np.uint8), height=100, title='"><b>')
    (image,) = pictures(tag)
    assert image.shape == (200, 300, 3)
    assert abs(image.mean() - 128) < 3
    assert "<b>" not in tag


def test_a_dataset_has_a_row_and_the_first_frame_of_each_camera_for_each_episode(filmed: Path) -> None:
    text = html(Dataset.open(filmed))
    assert text.count("<tr>") == 4
    assert [round(float(image.mean())) for image in pictures(text)] == [30] * 6
    assert "failure: slip" in text


def test_an_episode_shows_its_first_middle_and_last_frames(filmed: Path) -> None:
    text = html(Dataset.open(filmed)["000000"])
    assert [round(float(image.mean())) for image in pictures(text)] == [30, 130, 225] * 2


def test_a_damaged_episode_says_so(tmp_path: Path, filmed: Path) -> None:
    copy = shutil.copytree(filmed, tmp_path / "copy")
    (copy / "episodes/000001/steps.parquet").write_bytes(b"PAR1")
    dataset = Dataset.open(copy)
    assert "damaged" in html(dataset)
    assert "Cannot read" in html(dataset["000001"])
