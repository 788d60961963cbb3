"""Videos have the frames they were given, in their places, and colours come back as close as the codec allows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import video_codec
from rcs_data.convert.video import (
    VideoJoiner,
    VideoReader,
    check_video,
    decode_depth_video,
    decode_image,
    encode_depth_video,
    encode_video,
)
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.video_format import pixel_format

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
    joiner = VideoJoiner(tmp_path / "all.mp4", FPS)
    apart: list[NDArray[np.uint8]] = []
    firsts: list[int] = []
    for i, count in enumerate(counts):
        part = tmp_path / f"{i}.mp4"
        given = pictures(count, start=sum(counts[:i]))
        encode_video(part, given, given[0].shape, FPS, codec)
        assert joiner.takes(part)
        firsts.append(joiner.append(part))
        apart += VideoReader(part).frames(0.0, count, FPS)
    joiner.close()
    joiner.close()
    assert firsts == [0, 3, 4]
    check_video(tmp_path / "all.mp4", 10, FPS)
    np.testing.assert_array_equal(list(VideoReader(tmp_path / "all.mp4").frames(0.0, 10, FPS)), apart)


def test_a_video_of_another_kind_is_not_joined(tmp_path: Path) -> None:
    for name, size in (("a", 64), ("b", 80)):
        given = pictures(2, size, size)
        encode_video(tmp_path / f"{name}.mp4", given, given[0].shape, FPS, "h264")
    joiner = VideoJoiner(tmp_path / "all.mp4", FPS)
    joiner.append(tmp_path / "a.mp4")
    assert not joiner.takes(tmp_path / "b.mp4")
    joiner.close()


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


def test_depth_comes_back_bit_for_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    given = [rng.integers(0, 65536, (13, 17), np.uint16) for _ in range(6)]
    assert encode_depth_video(tmp_path / "d.mkv", given, (13, 17), FPS) == 6
    np.testing.assert_array_equal(list(decode_depth_video(tmp_path / "d.mkv")), given)


def test_a_png_is_decoded_exactly() -> None:
    given = pictures(1, 20, 30)[0]
    encoder = av.CodecContext.create("png", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 30, 20, "rgb24"
    data = b"".join(bytes(p) for p in encoder.encode(av.VideoFrame.from_ndarray(given, format="rgb24")))
    np.testing.assert_array_equal(decode_image(data), given)
    with pytest.raises(CorruptEpisode, match="not an image"):
        decode_image(b"no image at all")


@pytest.mark.parametrize(("codec", "worse"), [("h264", {"qmin": "50", "qmax": "51"}), ("av1", {"crf": "63"})])
def test_a_frame_that_came_out_wrong_is_encoded_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: Any, worse: dict[str, str]
) -> None:
    rng = np.random.default_rng(0)
    monkeypatch.setattr(video_codec, "_AT_A_TIME", 3)
    flat = pictures(9)
    # One picture has details that the encoder is told to spare.
    flat[5][16:48, 16:48] = rng.integers(0, 256, (32, 32, 1))
    monkeypatch.setitem(video_codec.OPTIONS, codec, {**video_codec.OPTIONS[codec], **worse})
    good = {name: "0" if name == "qmin" else "6" if name == "qmax" else "8" for name in worse}
    monkeypatch.setitem(
        video_codec._MENDING, codec, ({"g": "1", **good} if codec == "av1" else {"forced-idr": "1", **good},)
    )
    encode_video(tmp_path / "v.mp4", flat, flat[0].shape, FPS, codec)
    reader = VideoReader(tmp_path / "v.mp4")
    shown = list(reader.frames(0.0, 9, FPS))
    error = np.square(shown[5].astype(float) - flat[5])[16:48, 16:48].mean()
    assert 10 * np.log10(255**2 / error) > 24
    assert all(np.abs(a.astype(float) - b).mean() < 15 for a, b in zip(shown, flat, strict=True))
    np.testing.assert_array_equal(next(reader.frames(5 / FPS, 1, FPS)), shown[5])  # alone, after a jump


def test_frames_that_stay_wrong_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = pictures(6)
    given[3][:] = np.random.default_rng(0).integers(0, 256, (64, 80, 1))
    monkeypatch.setitem(video_codec.OPTIONS, "h264", {**video_codec.OPTIONS["h264"], "qmin": "50", "qmax": "51"})
    monkeypatch.setitem(video_codec._MENDING, "h264", ({"forced-idr": "1"},))
    with pytest.raises(DatasetError, match=r"h264 spoils frame 3 for v\.mp4, and 0 after it"):
        encode_video(tmp_path / "v.mp4", given, given[0].shape, FPS, "h264")


@pytest.mark.parametrize(("limit", "most"), [("_AT_A_TIME", 4), ("_BYTES_AT_A_TIME", 20_000)])
def test_no_more_packets_wait_than_a_part_holds(monkeypatch: pytest.MonkeyPatch, limit: str, most: int) -> None:
    noise = list(np.random.default_rng(0).integers(0, 256, (24, 64, 80, 3), np.uint8))
    monkeypatch.setattr(video_codec, limit, most)
    parts: list[list[int]] = []
    taken = video_codec.encoded_in_parts

    def counted(*given: Any) -> Any:
        for packets, wrong in taken(*given):
            parts.append([packet.size for packet in packets])
            yield packets, wrong

    monkeypatch.setattr(video_codec, "encoded_in_parts", counted)
    assert all(video_codec.encode_clip(noise, noise[0].shape, "h264"))
    assert len(parts) > 2
    for part in parts:  # one ends before a key frame, which every second one is
        until_the_last = part[:-2]
        assert (len(until_the_last) if limit == "_AT_A_TIME" else sum(until_the_last)) < most


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
