"""A sample shows what training is fed: the same windows, numbers and images, with warnings of what is odd in them."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import av
import numpy as np
import pytest
import simplejpeg
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, Windows
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.view import write_sample


def pictures(text: str) -> list[np.ndarray]:
    found = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', text)
    return [simplejpeg.decode_jpeg(base64.b64decode(data, validate=True)) for data in found]


def headings(text: str) -> list[str]:
    return re.findall(r"<h2>(\w+, step \d+)</h2>", text)


def test_the_page_has_the_images_that_windows_have(filmed: Path, tmp_path: Path) -> None:
    windows = Windows(Dataset.open(filmed), history=2, horizon=4, image_size=(32, 24))
    report = write_sample(windows, tmp_path / "sample.html", count=3, seed=5)
    assert report.windows == 3
    text = report.path.read_text("utf-8")
    shown = pictures(text)
    assert len(shown) == 3 * 2 * 2
    assert {image.shape for image in shown} == {(24, 32, 3)}
    known = {f"{window['episode']}, step {window['step']}": window for window in windows}
    first = known[headings(text)[0]]
    expected = [images[back] for images in first["images"].values() for back in (1, 0)]
    for image, wanted in zip(shown, expected, strict=False):
        assert abs(float(image.mean()) - float(wanted.mean())) < 3


def test_the_same_seed_draws_the_same_windows_each_once(filmed: Path, tmp_path: Path) -> None:
    windows = Windows(Dataset.open(filmed), cameras=())

    def drawn(seed: int, count: int) -> list[str]:
        write_sample(windows, tmp_path / "sample.html", seed=seed, count=count)
        return headings((tmp_path / "sample.html").read_text("utf-8"))

    assert drawn(1, 5) == drawn(1, 5) != drawn(2, 5)
    assert len(set(drawn(0, 1000))) == len(windows)


def test_numbers_are_shown_before_and_after_normalisation(filmed: Path, tmp_path: Path) -> None:
    windows = Windows(Dataset.open(filmed), cameras=(), horizon=3)
    write_sample(windows, tmp_path / "a.html", count=1, seed=3, normalisation="min_max")
    text = (tmp_path / "a.html").read_text("utf-8").replace("&quot;", '"')
    episode, step = headings(text)[0].split(", step ")
    window = next(one for one in windows if (one["episode"], one["step"]) == (episode, int(step)))
    state = windows.statistics()["state"]
    for values in (window["state"][-1], state.normalise(window["state"][-1], "min_max")):
        words = [f"(joints_{i}) {value:.3g}".replace("-", "\N{MINUS SIGN}") for i, value in enumerate(values)]
        assert all(f'"{word}"'.replace("\N{MINUS SIGN}", "\\u2212") in text for word in words)
    assert f"<td>{state.mean[0]:.3g}</td>".replace("-", "\N{MINUS SIGN}") in text
    assert "min max" in text


def test_what_is_odd_is_told(filmed: Path, tmp_path: Path) -> None:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
        Feature(key="observation/frames/side/rgb", shape=(16, 16, 3), dtype="uint8", encoding="jpeg"),
    )
    info = DatasetInfo(frequency=30, features=features, setup={}, instruction="")
    rng = np.random.default_rng(0)
    with DatasetWriter.open(tmp_path / "data", info) as writer:
        episode = writer.episode("a", seed=0)
        for row in range(100):
            values = {
                "observation/joints": np.array([0.785, rng.normal() if row != 50 else -9.0]),
                "observation/frames/side/rgb": np.full((16, 16, 3), 7, np.uint8),
            }
            episode.add(values | ({"action/joints": rng.normal(size=2)} if row else {}))
        episode.finish(True)
    report = write_sample(Windows(Dataset.open(tmp_path / "data")), tmp_path / "sample.html", count=2)
    assert re.match(r"state: joints_0 is always 0\.785; normalised, it is 0", report.warnings[0])
    assert re.match(r"state: joints_1 reaches \N{MINUS SIGN}9, [67]\.\d σ from the mean", report.warnings[1])
    assert [words[:7] for words in report.warnings[2:]] == ["images:", "images:"]
    assert all(words in report.path.read_text("utf-8") for words in report.warnings)
    plain = write_sample(Windows(Dataset.open(filmed), cameras=()), tmp_path / "b.html")
    assert plain.warnings == ()
    assert "Nothing is conspicuous" in plain.path.read_text("utf-8")


def test_the_images_come_as_one_picture_too(filmed: Path, tmp_path: Path) -> None:
    windows = Windows(Dataset.open(filmed), cameras=["side", "wrist", "side/depth"])
    write_sample(windows, tmp_path / "sample.html", count=4, png=tmp_path / "sheet.png")
    with av.open(str(tmp_path / "sheet.png")) as container:
        sheet = next(container.decode(video=0)).to_ndarray(format="rgb24")
    assert sheet.shape == (4 * 66 + 6, 81 + 48 + 40 + 4 * 6, 3)
    with pytest.raises(InvalidSetup, match="no images for a picture"):
        write_sample(Windows(Dataset.open(filmed), cameras=()), tmp_path / "b.html", png=tmp_path / "b.png")


def test_what_makes_no_sense_is_refused(filmed: Path, tmp_path: Path) -> None:
    windows = Windows(Dataset.open(filmed), cameras=())
    with pytest.raises(InvalidSetup, match="count is 0; it must be at least 1"):
        write_sample(windows, tmp_path / "sample.html", count=0)
    with pytest.raises(InvalidSetup, match="valid is a number from 0"):
        write_sample(windows, tmp_path / "sample.html", floor=-1.0)
    (tmp_path / "file").touch()
    with pytest.raises(DatasetError, match="write the sample"):
        write_sample(windows, tmp_path / "file/sample.html")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_command_draws_what_was_asked_for(
    filmed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rcs_data.cli.main import main

    out = tmp_path / "sample.html"
    words = ["rcs-data", "sample", str(filmed), "--out", str(out), "--windows", "2", "--cameras", "side", "side/depth"]
    monkeypatch.setattr("sys.argv", [*words, "--history", "2", "--horizon", "5", "--episodes", "000001"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert str(out) in capsys.readouterr().out.replace("\n", "")
    text = out.read_text("utf-8")
    assert len(pictures(text)) == 2 * 2 * 2
    assert all(heading.startswith("000001") for heading in headings(text))
    monkeypatch.setattr("sys.argv", ["rcs-data", "sample", str(filmed), "--out", str(out), "--cameras", "top"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "There is no camera of this dataset named 'top'" in capsys.readouterr().err
