"""Videos have the frames they were given, in their places, and colours come back as close as the codec allows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from av.error import InvalidDataError
from numpy.typing import NDArray
from rcs_data.convert.lerobot.video import (
    VideoJoiner,
    VideoReader,
    check_video,
    encode_video,
    pixel_format,
)
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup

FPS = 30


def pictures(count: int, height: int = 64, width: int = 80, start: int = 0) -> list[NDArray[np.uint8]]:
    """Return smooth pictures of which each is brighter than the one before."""
    y, x = np.mgrid[0:height, 0:width]
    shade = 40 + 20 * np.sin(0.05 * x + 0.04 * y)
    ramps = [np.stack([shade, shade + 15, shade + 30], axis=-1) + 5 * (start + i) for i in range(count)]
    return [ramp.clip(0, 255).astype(np.uint8) for ramp in ramps]


@pytest.mark.parametrize("codec", ["h264", "av1"])
def test_every_frame_comes_back_in_its_place(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "v.mp4"
    given = pictures(11)
    assert encode_video(path, iter(given), given[0].shape, FPS, codec) == 11
    read = list(VideoReader(path).frames(0.0, 11, FPS))
    errors = [np.abs(a.astype(int) - b).mean() for a, b in zip(given, read, strict=True)]
    assert max(errors) < 3
    # The neighbour would be 5 away, so no frame is where another should be.
    assert all(abs(a.mean() - b.mean()) < 1.5 for a, b in zip(given, read, strict=True))


@pytest.mark.parametrize("colour", [(255, 0, 0), (0, 255, 0), (0, 0, 255), (128, 128, 128), (0, 0, 0), (255, 255, 255)])
def test_plain_colours_come_back(tmp_path: Path, colour: tuple[int, int, int]) -> None:
    given = np.full((64, 64, 3), colour, np.uint8)
    encode_video(tmp_path / "v.mp4", [given] * 3, given.shape, FPS, "h264")
    for read in VideoReader(tmp_path / "v.mp4").frames(0.0, 3, FPS):
        assert np.abs(read.astype(int) - given).max() <= 3


def test_odd_sizes_keep_their_size_and_all_colour(tmp_path: Path) -> None:
    given = pictures(4, 33, 47)
    encode_video(tmp_path / "v.mp4", given, given[0].shape, FPS, "h264")
    read = list(VideoReader(tmp_path / "v.mp4").frames(0.0, 4, FPS))
    assert read[0].shape == (33, 47, 3)
    assert pixel_format(33, 47, "h264") == "yuv444p"


@pytest.mark.parametrize(("height", "width"), [(33, 64), (32, 64), (64, 48)])
def test_what_av1_cannot_take_is_refused(height: int, width: int) -> None:
    with pytest.raises(InvalidSetup, match="h264"):
        pixel_format(height, width, "av1")


@pytest.mark.parametrize("codec", ["h264", "av1"])
def test_joined_videos_are_their_parts_one_after_the_other(tmp_path: Path, codec: str) -> None:
    counts = (3, 1, 6)
    joiner = VideoJoiner(lambda number: tmp_path / f"joined-{number}.mp4", FPS, 1 << 30)
    apart: list[NDArray[np.uint8]] = []
    firsts: list[int] = []
    for i, count in enumerate(counts):
        part = tmp_path / f"{i}.mp4"
        given = pictures(count, start=sum(counts[:i]))
        encode_video(part, given, given[0].shape, FPS, codec)
        file, first = joiner.append(part)
        assert file == 0
        firsts.append(first)
        apart += VideoReader(part).frames(0.0, count, FPS)
    joiner.close()
    joiner.close()
    assert firsts == [0, 3, 4]
    check_video(tmp_path / "joined-0.mp4", 10, FPS)
    np.testing.assert_array_equal(list(VideoReader(tmp_path / "joined-0.mp4").frames(0.0, 10, FPS)), apart)


def test_frames_are_found_by_their_time_in_any_order(tmp_path: Path) -> None:
    given = pictures(20)
    encode_video(tmp_path / "v.mp4", given, given[0].shape, FPS, "h264")
    reader = VideoReader(tmp_path / "v.mp4")
    straight = list(reader.frames(0.0, 20, FPS))
    for start, count in ((12, 3), (2, 5), (7, 1), (19, 1), (0, 2)):
        np.testing.assert_array_equal(
            list(reader.frames(start / FPS, count, FPS)), straight[start : start + count], err_msg=f"from {start}"
        )
    reader.close()
    reader.close()


def test_after_a_frame_that_cannot_be_decoded_later_ones_are_read(tmp_path: Path) -> None:
    given = pictures(20)
    encode_video(tmp_path / "v.mp4", given, given[0].shape, FPS, "h264")
    straight = list(VideoReader(tmp_path / "v.mp4").frames(0.0, 20, FPS))
    reader = VideoReader(tmp_path / "v.mp4")

    def failing(frames: Iterator[Any]) -> Iterator[Any]:
        yield from islice(frames, 3)
        raise InvalidDataError(0, "not a frame")

    reader._frames = failing(reader._frames)
    with pytest.raises(CorruptEpisode, match="Cannot decode"):
        list(reader.frames(0.0, 10, FPS))
    np.testing.assert_array_equal(list(reader.frames(10 / FPS, 5, FPS)), straight[10:15])


def test_a_time_without_a_frame_is_told(tmp_path: Path) -> None:
    given = pictures(5)
    encode_video(tmp_path / "v.mp4", given, given[0].shape, FPS, "h264")
    with pytest.raises(CorruptEpisode, match=r"no frame at 0\.1667 s"):
        list(VideoReader(tmp_path / "v.mp4").frames(0.0, 6, FPS))


def test_a_missing_or_moved_frame_is_noticed(tmp_path: Path) -> None:
    given = pictures(5)
    encode_video(tmp_path / "v.mp4", given, given[0].shape, FPS, "h264")
    with pytest.raises(DatasetError, match="should have 6 frames"):
        check_video(tmp_path / "v.mp4", 6, FPS)
    with pytest.raises(DatasetError, match="wrong times"):
        check_video(tmp_path / "v.mp4", 5, 25)


def test_what_is_no_video_is_told(tmp_path: Path) -> None:
    (tmp_path / "v.mp4").write_bytes(b"no video")
    for path in (tmp_path / "v.mp4", tmp_path / "none.mp4"):
        with pytest.raises(CorruptEpisode, match="missing or not a video"):
            VideoReader(path)


@pytest.mark.parametrize("codec", ["h264", "av1"])
def test_even_noise_is_written(tmp_path: Path, codec: Any) -> None:
    noise = list(np.random.default_rng(0).integers(0, 256, (6, 64, 80, 3), np.uint8))
    assert encode_video(tmp_path / "v.mp4", noise, noise[0].shape, FPS, codec) == 6


def test_an_encoder_leaves_the_priority_of_this_process_alone(tmp_path: Path) -> None:
    """SVT-AV1 takes real-time priority where it may, which is as root."""
    before = os.sched_getscheduler(0)
    seen: set[int] = set()

    def watched() -> Iterator[NDArray[np.uint8]]:
        for image in pictures(8):
            yield image
            seen.update(os.sched_getscheduler(int(thread)) for thread in os.listdir("/proc/self/task"))

    encode_video(tmp_path / "v.mp4", watched(), (64, 80, 3), FPS, "av1")
    assert os.sched_getscheduler(0) == before
    assert os.SCHED_FIFO not in seen
