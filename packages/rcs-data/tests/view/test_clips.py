"""A clip has a frame per row, is small, and can be entered anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.view.clips import ClipOptions, Codec, coloured, pictures, write_clip

FRAME = "observation/frames/a/rgb"


def record(path: Path, feature: Feature, images: list[Any], fps: float = 30.0) -> EpisodeRecord:
    info = DatasetInfo(frequency=fps, features=(feature,), setup={}, instruction="")
    with DatasetWriter.open(path, info) as writer:
        episode = writer.episode("a", seed=0)
        for image in images:
            episode.add({feature.key: image})
        return episode.finish(None)


def decoded(path: Path) -> tuple[list[np.ndarray[Any, Any]], Any]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [(frame.to_ndarray(format="rgb24"), frame.time, frame.key_frame) for frame in container.decode(stream)]
        about = {"codec": stream.codec_context.name, "rate": stream.average_rate, "times": [t for _, t, _ in frames]}
        return [image for image, _, _ in frames], {**about, "keys": [key for _, _, key in frames]}


@pytest.mark.parametrize("codec", ["h264", "vp9"])
@pytest.mark.parametrize("fps", [30.0, 7.5, 29.97])
def test_row_i_is_frame_i_at_i_over_fps(codec: Codec, fps: float, tmp_path: Path) -> None:
    feature = Feature(key=FRAME, shape=(32, 48, 3), dtype="uint8", encoding="jpeg")
    episode = record(tmp_path / "data", feature, [np.full((32, 48, 3), 20 + 6 * i, np.uint8) for i in range(33)], fps)
    write_clip(episode, feature, tmp_path / "a.mp4", ClipOptions(codec=codec))
    frames, about = decoded(tmp_path / "a.mp4")
    assert len(frames) == 33
    np.testing.assert_allclose([frame.mean() for frame in frames], [20 + 6 * i for i in range(33)], atol=3)
    np.testing.assert_allclose(about["times"], np.arange(33) / fps, atol=1e-3)
    whole = np.flatnonzero(about["keys"])
    assert whole[0] == 0
    assert np.diff(whole).max() <= 10


def test_colours_stay_what_they_are(tmp_path: Path) -> None:
    feature = Feature(key=FRAME, shape=(64, 96, 3), dtype="uint8", encoding="lossless")
    image = np.zeros((64, 96, 3), np.uint8)
    colours = [(200, 30, 30), (30, 200, 30), (30, 30, 200), (220, 220, 40)]
    for i, colour in enumerate(colours):
        image[:, 24 * i : 24 * (i + 1)] = colour
    write_clip(record(tmp_path / "data", feature, [image] * 3), feature, tmp_path / "a.mp4", ClipOptions())
    frames, _ = decoded(tmp_path / "a.mp4")
    for i, colour in enumerate(colours):
        np.testing.assert_allclose(frames[1][8:56, 24 * i + 6 : 24 * i + 18].mean((0, 1)), colour, atol=8)


@pytest.mark.parametrize(
    ("shape", "height", "size"),
    [((480, 640), 320, (320, 426)), ((481, 641), 240, (240, 320)), ((60, 81), 320, (60, 80)), ((15, 21), 16, (16, 20))],
)
def test_large_images_are_made_small_and_small_ones_stay(
    shape: tuple[int, int], height: int, size: tuple[int, int], tmp_path: Path
) -> None:
    feature = Feature(key=FRAME, shape=(*shape, 3), dtype="uint8", encoding="jpeg")
    episode = record(tmp_path / "data", feature, [np.zeros((*shape, 3), np.uint8)] * 2)
    write_clip(episode, feature, tmp_path / "a.mp4", ClipOptions(height=height))
    assert decoded(tmp_path / "a.mp4")[0][0].shape[:2] == size


def test_depth_is_lighter_the_farther_and_black_where_nothing_was_measured(tmp_path: Path) -> None:
    feature = Feature(key="observation/frames/a/depth", shape=(40, 60), dtype="uint16", unit="mm", encoding="depth")
    image = np.repeat(np.linspace(400, 1600, 60).astype(np.uint16)[None], 40, axis=0)
    image[:10] = 0
    limits = write_clip(record(tmp_path / "data", feature, [image] * 4), feature, tmp_path / "a.mp4", ClipOptions())
    assert limits is not None
    assert len(limits) == 4
    assert all(400 <= low < 450 < 1550 < high <= 1600 for low, high in limits)
    frames, _ = decoded(tmp_path / "a.mp4")
    brightness = frames[-1] @ (0.2126, 0.7152, 0.0722)
    assert brightness[:6].max() < 12
    columns = brightness[15:].mean(0)
    assert (np.diff(columns[4:-4:4]) > 0).all()


def test_what_is_near_is_seen_after_what_was_far(tmp_path: Path) -> None:
    """A camera in the hand sees the room, and then a grasp of a few centimetres."""
    feature = Feature(key="observation/frames/a/depth", shape=(40, 60), dtype="uint16", unit="mm", encoding="depth")
    far, near = (
        np.repeat(np.linspace(low, high, 60).astype(np.uint16)[None], 40, axis=0)
        for low, high in ((800, 3000), (60, 120))
    )
    episode = record(tmp_path / "data", feature, [far] * 20 + [near] * 20)
    write_clip(episode, feature, tmp_path / "a.mp4", ClipOptions())
    brightness = decoded(tmp_path / "a.mp4")[0][-1].mean(axis=(0, 2))
    assert brightness[-5] > brightness[5] + 80


def test_touch_is_shown_where_it_is_a_map_of_numbers(tmp_path: Path) -> None:
    touch = Feature(key="observation/frames/left/indentation", shape=(24, 32), dtype="float32", unit="m")
    matrix = Feature(key="observation/frames/left/intrinsics", shape=(3, 3), dtype="float64")
    vector = Feature(key="observation/table", shape=(24, 32), dtype="float64")
    info = DatasetInfo(frequency=30, features=(touch, matrix, vector), setup={}, instruction="")
    assert pictures(info) == [touch]
    deep = np.zeros((24, 32), np.float32)
    deep[10:14, 12:20] = 2e-3
    episode = record(tmp_path / "data", touch, [np.zeros_like(deep), deep, deep])
    limits = write_clip(episode, touch, tmp_path / "a.mp4", ClipOptions())
    assert limits is not None
    frames, _ = decoded(tmp_path / "a.mp4")
    assert frames[2][12, 16].mean() > frames[2][2, 2].mean() + 60 > frames[0][12, 16].mean() + 40


def test_an_image_without_any_number_has_a_clip_too(tmp_path: Path) -> None:
    depth = Feature(key="observation/frames/a/depth", shape=(16, 16), dtype="uint16", encoding="depth")
    episode = record(tmp_path / "data", depth, [np.zeros((16, 16), np.uint16)] * 2)
    write_clip(episode, depth, tmp_path / "a.mp4", ClipOptions())
    assert len(decoded(tmp_path / "a.mp4")[0]) == 2


def test_what_does_not_decode_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    feature = Feature(key=FRAME, shape=(16, 16, 3), dtype="uint8", encoding="jpeg")
    record(tmp_path / "data", feature, [np.zeros((16, 16, 3), np.uint8)] * 2)
    episode = Dataset.open(tmp_path / "data").episodes[0]
    monkeypatch.setattr(EpisodeRecord, "encoded_frames", lambda self, key: iter([b"\xff\xd8 no image \xff\xd9"]))
    with pytest.raises(CorruptEpisode, match=r"frames/a/rgb, row 0"):
        write_clip(episode, feature, tmp_path / "a.mp4", ClipOptions())


def test_senseless_options_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="height is 8; valid: a whole number from 16"):
        ClipOptions(height=8)
    with pytest.raises(InvalidSetup, match="valid: 'h264', 'vp9'"):
        ClipOptions(codec="av2")  # pyright: ignore[reportArgumentType]


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_the_larger_number_is_never_darker(low: float, span: float) -> None:
    values = np.linspace(low - span, low + 2 * span, 200)[None]
    colours = coloured(values, (low, low + span))[0].astype(float)
    assert colours.shape == (200, 3)
    lightness = colours @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(lightness) >= -1).all()  # a step of rounding
    assert lightness[-1] > lightness[0] + 150


def test_no_number_is_black_and_no_number_else_is() -> None:
    assert not coloured(np.array([[np.nan, np.inf]]), (0, 1)).any()
    assert coloured(np.array([[0.0]]), (0, 1)).any()
    assert not coloured(np.array([[0]], np.uint16), (0, 1)).any()
    assert coloured(np.array([[1]], np.uint16), (1, 5)).any()


def test_neighbouring_labels_have_colours_far_apart_and_none_is_grey(tmp_path: Path) -> None:
    feature = Feature(key="observation/frames/a/geoms", shape=(64, 192), dtype="uint16", encoding="labels")
    labels = np.repeat(np.arange(8, dtype=np.uint16), 24)[None].repeat(64, axis=0)
    write_clip(record(tmp_path / "data", feature, [labels] * 3), feature, tmp_path / "a.mp4", ClipOptions())
    frames, _ = decoded(tmp_path / "a.mp4")
    colours = np.array([frames[1][8:56, 24 * i + 6 : 24 * i + 18].mean((0, 1)) for i in range(8)])
    assert colours[0].max() < 20
    assert (np.ptp(colours[1:], axis=1) > 0.6 * colours[1:].max(axis=1)).all()
    assert np.linalg.norm(np.diff(colours, axis=0), axis=1).min() > 80
