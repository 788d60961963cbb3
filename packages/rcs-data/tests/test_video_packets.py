"""Videos in datasets: written when an episode is complete, read image by image, in any order and after any damage."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from rcs_data import (
    Dataset,
    DatasetInfo,
    DatasetWriter,
    EpisodeRecord,
    Feature,
    FrameAccess,
    check,
    compare_steps,
    edit,
    recover,
    video_codec,
    video_packets,
)
from rcs_data.about import read_about
from rcs_data.convert.lerobot import export_lerobot
from rcs_data.convert.lerobot_import import import_lerobot
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.convert.video import VideoReader
from rcs_data.durable import sealed, write_file
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.flags import FrameFlag

SIDE, WRIST = "observation/frames/side/rgb", "observation/frames/wrist/rgb"
DEPTH, FLAGS = "observation/frames/wrist/depth", "flags/frames/wrist"
SHAPE, ODD = (64, 80, 3), (33, 47, 3)
CODECS = ("h264", "av1")


def info_of(codec: Any = "h264", shape: tuple[int, ...] = SHAPE) -> DatasetInfo:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key=SIDE, shape=shape, dtype="uint8", encoding=codec),
        Feature(key=WRIST, shape=SHAPE, dtype="uint8", encoding="h264"),
        Feature(key=DEPTH, shape=(6, 8), dtype="uint16", encoding="depth"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
        Feature(key=FLAGS, shape=(), dtype="uint8"),
    )
    return DatasetInfo(frequency=30.0, features=features, setup={}, instruction="move")


def picture(row: int, shape: tuple[int, ...] = SHAPE) -> NDArray[np.uint8]:
    """A smooth picture whose brightness tells its row."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    shade = 60 + 20 * np.sin(0.07 * (x + row)) + 20 * np.cos(0.05 * y) + 3 * (row % 40)
    return np.stack([shade, 0.8 * shade + 20, 250 - shade], axis=-1).clip(0, 255).astype(np.uint8)


def rows_of(length: int, held: tuple[int, ...] = (), shape: tuple[int, ...] = SHAPE) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for row in range(length):
        is_held = row in held
        rows.append(
            {
                "observation/joints": np.full(2, 0.01 * row),
                SIDE: picture(row, shape),
                WRIST: None if is_held else picture(row + 5),
                DEPTH: None if is_held else np.full((6, 8), row, np.uint16),
                "time/monotonic": row / 30,
                FLAGS: int(FrameFlag.REPEATED) if is_held else 0,
                **({"action/joints": np.full(2, 0.01)} if row else {}),
            }
        )
    return rows


def record(path: Path, length: int, held: tuple[int, ...] = (), **options: Any) -> EpisodeRecord:
    info = info_of(**options)
    with DatasetWriter.open(path, info, resume=True) as writer:
        name = f"{len(Dataset.open(path).episodes):06d}"
        with writer.episode(name, seed=0) as episode:
            for row in rows_of(length, held, info.feature(SIDE).shape):
                episode.add(row)
            return episode.finish(True)


def psnr(one: NDArray[Any], other: NDArray[Any]) -> float:
    return float(10 * np.log10(255**2 / max(np.square(one.astype(float) - other).mean(), 1e-9)))


def stored(episode: EpisodeRecord, key: str) -> list[bytes | None]:
    return [data for rows in episode.rows(packets=True) for data in rows.column(key).to_pylist()]


@pytest.mark.parametrize("codec", CODECS)
def test_what_is_read_is_what_was_recorded(tmp_path: Path, codec: str) -> None:
    episode = record(tmp_path / "set", 150, codec=codec)
    for row, image in enumerate(episode.frames(SIDE)):
        assert psnr(image, picture(row)) > 35
    packets = stored(episode, SIDE)
    assert sum(len(data or b"") for data in packets) < 0.1 * 150 * len(next(episode.encoded_frames(SIDE)))
    assert not any(video_packets.follows(a or b"") and video_packets.follows(b or b"") for a, b in pairwise(packets))
    assert check(tmp_path / "set", workers=1).is_ok
    np.testing.assert_array_equal(episode.column(SIDE), list(episode.frames(SIDE)))


@pytest.mark.parametrize(("codec", "shape"), [("h264", SHAPE), ("av1", SHAPE), ("h264", ODD), ("h264", (1, 2, 3))])
def test_any_order_gives_what_reading_in_order_gives(tmp_path: Path, codec: str, shape: tuple[int, ...]) -> None:
    held = (0, 1, 5, 6, 9, 64, 65, 66)
    for _ in range(2):
        record(tmp_path / "set", 80, held, codec=codec, shape=shape)
    found = Dataset.open(tmp_path / "set")
    access = FrameAccess()
    for key in (SIDE, WRIST):
        whole = [list(episode.frames(key)) for episode in found]
        files = [list(episode.encoded_frames(key)) for episode in found]
        for number in np.random.default_rng(0).permutation(160).tolist():
            episode, row = found.episodes[number // 80], number % 80
            np.testing.assert_array_equal(access.frame(episode, key, row), whole[number // 80][row])
            assert access.encoded(episode, key, [row]) == [files[number // 80][row]]
    assert not whole[0][1].any(), "black before the first image"
    np.testing.assert_array_equal(whole[0][4], whole[0][6])
    for first in (0, 1, 4, 63, 65, 79):
        (part,) = list(found.episodes[0].rows(first, first + 1))
        assert part.column(SIDE)[0].as_py() == list(found.episodes[0].encoded_frames(SIDE))[first]


def test_two_runs_make_the_same_bytes_however_rows_are_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = record(tmp_path / "one", 90, (3, 70), codec="av1")
    monkeypatch.setattr("rcs_data.rows._CAPACITY", 5)
    two = record(tmp_path / "two", 90, (3, 70), codec="av1")
    assert (one.path / "frames.arrow").read_bytes() == (two.path / "frames.arrow").read_bytes()
    assert one.content_hash == two.content_hash
    assert compare_steps(one, two) == []


@pytest.mark.parametrize(("height", "width"), [(33, 64), (32, 64), (64, 48)])
def test_what_a_codec_cannot_take_is_refused_before_anything_is_recorded(height: int, width: int) -> None:
    with pytest.raises(InvalidSetup, match="AV1 video"):
        Feature(key=SIDE, shape=(height, width, 3), dtype="uint8", encoding="av1")
    with pytest.raises(InvalidSetup, match="colour image"):
        Feature(key=SIDE, shape=(64, 64), dtype="uint8", encoding="av1")


def test_a_renamed_camera_keeps_its_packets(tmp_path: Path) -> None:
    before = record(tmp_path / "set", 70, (2, 3))
    images, decoded = (before.path / "frames.arrow").read_bytes(), list(before.frames(SIDE))
    edit.rename_camera(tmp_path / "set", "side", "front")
    after = Dataset.open(tmp_path / "set").episodes[0]
    assert after.path != before.path
    assert (after.path / "frames.arrow").read_bytes() == images
    np.testing.assert_array_equal(list(after.frames("observation/frames/front/rgb")), decoded)
    assert check(tmp_path / "set", workers=1).is_ok


def test_edits_of_rows_and_sizes_encode_again(tmp_path: Path) -> None:
    record(tmp_path / "set", 90, (2, 3, 31))
    edit.trim(tmp_path / "set", "000000", first=1, last=-10)
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert [psnr(image, picture(row + 1)) > 33 for row, image in enumerate(episode.frames(SIDE))] == [True] * 80
    edit.resample(tmp_path / "set", 10.0)
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert all(psnr(image, picture(1 + 3 * row)) > 33 for row, image in enumerate(list(episode.frames(SIDE))[:-1]))
    edit.resize(tmp_path / "set", (40, 32))
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert next(episode.frames(SIDE)).shape == (32, 40, 3)
    assert check(tmp_path / "set", workers=1).is_ok
    with pytest.raises(InvalidSetup, match="from 1 to 16384"):
        edit.resize(tmp_path / "set", (40, 0))
    for _ in range(3):
        edit.undo(tmp_path / "set")
    assert Dataset.open(tmp_path / "set").episodes[0].length == 90


@pytest.mark.parametrize("codec", CODECS)
def test_a_damaged_packet_is_named_and_no_cut_crashes(tmp_path: Path, codec: str) -> None:
    episode = record(tmp_path / "set", 70, codec=codec)
    path = episode.path / "frames.arrow"
    whole, packets = path.read_bytes(), stored(episode, SIDE)
    key, after = packets[40], packets[41]
    assert key
    assert after
    assert not video_packets.follows(key)
    assert video_packets.follows(after)
    path.write_bytes(whole.replace(key, key[:20] + bytes([key[20] ^ 1]) + key[21:]))
    for row in (40, 41):
        with pytest.raises(CorruptEpisode, match=rf"frames\.arrow, '{SIDE}', row {row}: .*packet of {codec}"):
            FrameAccess().frame(episode, SIDE, row)
    with pytest.raises(CorruptEpisode, match="row 40"):
        list(episode.rows())
    assert FrameAccess().frame(episode, SIDE, 42).shape == SHAPE
    for depth in ("bytes", "frames"):
        found = {(finding.kind, finding.rows) for finding in check(tmp_path / "set", depth=depth, workers=1).findings}
        assert found >= {("altered", None), ("image", (40, 41))}
    path.write_bytes(whole)
    feature, rng = episode.info.feature(SIDE), np.random.default_rng(0)
    for data in (key, after):
        for cut in (0, 1, 4, 5, 6, *rng.integers(7, len(data), 10).tolist()):
            decoder = video_packets.VideoDecoder(feature)
            if data is after:
                decoder.decode(key)
            with pytest.raises(CorruptEpisode):
                decoder.decode(data[:cut])
        for _ in range(30):  # with a right checksum, as from a bad program
            packet = bytearray(data[5:])
            for at in rng.integers(0, len(packet), 3):
                packet[at] = rng.integers(0, 256)
            decoder = video_packets.VideoDecoder(feature)
            if data is after:
                decoder.decode(key)
            with suppress(CorruptEpisode):
                assert decoder.decode(video_packets.stored_packet(bytes(packet), is_key=data is key)).shape == SHAPE
    with pytest.raises(CorruptEpisode, match="key frame before it"):
        video_packets.VideoDecoder(feature).decode(after)


def test_a_packet_of_another_size_is_refused(tmp_path: Path) -> None:
    (large,) = video_codec.encode_clip([np.zeros((2000, 2000, 3), np.uint8)], (2000, 2000, 3), "h264")
    assert large
    feature = info_of().feature(SIDE)
    with pytest.raises(CorruptEpisode):
        video_packets.VideoDecoder(feature).decode(video_packets.stored_packet(*large))


def test_other_values_than_those_written_are_found(tmp_path: Path) -> None:
    episode = record(tmp_path / "set", 20)
    other = record(tmp_path / "other", 20, codec="av1")
    lines = compare_steps(episode, other)
    assert lines == [f"{SIDE}: first difference in row 0"]


def test_a_killed_recording_is_complete_after_recover(tmp_path: Path) -> None:
    program = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_video_packets import *
writer = DatasetWriter.open({str(tmp_path / "set")!r}, info_of())
episode = writer.episode("a", seed=0)
for row in rows_of(100):
    episode.add(row)
os._exit(9)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 9
    assert recover(tmp_path / "set").recovered == ("a",)
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert episode.length >= 85
    assert all(psnr(image, picture(row)) > 35 for row, image in enumerate(episode.frames(SIDE)))


def test_what_no_try_encodes_well_stays_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(video_codec.OPTIONS, "h264", {**video_codec.OPTIONS["h264"], "qmin": "50", "qmax": "51"})
    monkeypatch.setitem(video_codec._MENDING, "h264", ({"forced-idr": "1"},))
    info, noise = info_of(), np.random.default_rng(0).integers(0, 256, SHAPE, np.uint8)
    with DatasetWriter.open(tmp_path / "set", info) as writer, writer.episode("a", seed=0) as episode:
        for number, row in enumerate(rows_of(12)):
            episode.add({**row, SIDE: noise if number in (4, 7) else np.full(SHAPE, 99, np.uint8)})
        made = episode.finish(True)
    kinds = [video_packets.is_packet(data or b"") for data in stored(made, SIDE)]
    assert kinds == [row not in (4, 7) for row in range(12)]
    frames = list(made.frames(SIDE))
    assert psnr(frames[7], noise) > 30
    access = FrameAccess()
    for row in np.random.default_rng(0).permutation(12).tolist():
        np.testing.assert_array_equal(access.frame(made, SIDE, row), frames[row])
    assert check(tmp_path / "set", workers=1).is_ok


def test_a_damaged_jpeg_of_an_open_episode_does_not_stop_its_end(tmp_path: Path) -> None:
    rows = rows_of(6)
    rows[3][SIDE] = b"\xff\xd8 no image \xff\xd9"
    with DatasetWriter.open(tmp_path / "set", info_of()) as writer, writer.episode("a", seed=0) as episode:
        for row in rows:
            episode.add(row)
        made = episode.finish(True)
    assert [row for row in range(6) if _is_unreadable(made, row)] == [3]


def _is_unreadable(episode: EpisodeRecord, row: int) -> bool:
    try:
        FrameAccess().frame(episode, SIDE, row)
    except CorruptEpisode:
        return True
    return False


def test_a_frozen_camera_is_found(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path / "set", info_of()) as writer, writer.episode("a", seed=0) as episode:
        for number, row in enumerate(rows_of(120)):
            joints = np.full(2, 0.05 * number)
            episode.add({**row, "observation/joints": joints, SIDE: picture(min(number, 20))})
        episode.finish(True)
    (found,) = [finding for finding in check(tmp_path / "set", workers=1).findings if finding.kind == "frozen"]
    assert SIDE in found.message
    assert found.rows in ((19, 119), (20, 119))  # as far as the quality tells


def test_export_to_lerobot_and_back(tmp_path: Path) -> None:
    record(tmp_path / "set", 40)
    export_lerobot(Dataset.open(tmp_path / "set"), tmp_path / "out", ExportOptions())
    back = import_lerobot(tmp_path / "out", tmp_path / "back", ImportOptions()).episodes[0]
    assert back.info.feature(SIDE).encoding == "h264"
    assert all(psnr(image, picture(row)) > 33 for row, image in enumerate(list(back.frames(SIDE))[:-1]))
    exact = import_lerobot(tmp_path / "out", tmp_path / "exact", ImportOptions(lossless=True))
    assert exact.info.feature(SIDE).encoding == "lossless"
    small = import_lerobot(tmp_path / "out", tmp_path / "small", ImportOptions(video="av1"))
    assert small.info.feature(SIDE).encoding == small.info.feature(WRIST).encoding == "av1"
    assert small.info.feature(DEPTH).encoding == "depth"


def muxed(folder: Path, camera: str) -> list[bytes]:
    """Return the packets of a camera's videos in an export."""
    packets: list[bytes] = []
    for path in sorted(folder.glob(f"videos/**/*{camera}/**/*.mp4")):
        with av.open(str(path)) as source:
            packets += [bytes(packet) for packet in source.demux(video=0) if packet.pts is not None]
    return packets


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_av1_goes_to_lerobot_and_back_and_there_again_packet_by_packet(tmp_path: Path, version: Any) -> None:
    for length in (41, 20):
        record(tmp_path / "set", length, codec="av1")
    dataset, options = Dataset.open(tmp_path / "set"), ExportOptions(codec="av1", cameras=("side",))
    export_lerobot(dataset, tmp_path / "out", options, version=version)
    packets = [data[5:].removeprefix(b"\x12\0") for episode in dataset for data in stored(episode, SIDE)[:-1] if data]
    assert muxed(tmp_path / "out", "side") == packets
    back = import_lerobot(tmp_path / "out", tmp_path / "back")
    assert check(tmp_path / "back", workers=1).is_ok
    for one, other in zip(dataset, back, strict=True):
        assert stored(other, SIDE)[:-1] == stored(one, SIDE)[:-1]
        np.testing.assert_array_equal(other.column(SIDE)[:-1], one.column(SIDE)[:-1])
    export_lerobot(back, tmp_path / "again", options, version=version)
    for name in (path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("*.mp4")):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


@pytest.mark.parametrize("codec", CODECS)
def test_videos_of_others_stay_as_they_are(tmp_path: Path, codec: Any) -> None:
    record(tmp_path / "set", 40, codec="h264")
    export_lerobot(Dataset.open(tmp_path / "set"), tmp_path / "out", ExportOptions(codec=codec))
    (tmp_path / "out" / "meta" / "rcs.json").unlink()
    (video,) = (tmp_path / "out").glob("videos/*side/**/*.mp4")
    frames = list(VideoReader(video).frames(0.0, 39, 30))
    back = import_lerobot(tmp_path / "out", tmp_path / "back", ImportOptions(video=codec)).episodes[0]
    key = next(feature.key for feature in back.info.features if "side" in feature.key and feature.is_image)
    assert all(map(video_packets.is_packet, filter(None, stored(back, key))))
    np.testing.assert_array_equal(back.column(key)[:-1], frames)
    assert check(tmp_path / "back", workers=1).is_ok
    access = FrameAccess()
    for row in (38, 3, 17, 2, 1, 0):
        np.testing.assert_array_equal(access.frame(back, key, row), frames[row])
    export_lerobot(Dataset.open(tmp_path / "back"), tmp_path / "again", ExportOptions(codec=codec))
    (again,) = (tmp_path / "again").glob("videos/*side/**/*.mp4")
    np.testing.assert_array_equal(list(VideoReader(again).frames(0.0, 39, 30)), frames)
    edit.trim(tmp_path / "back", back.id, first=1)
    export_lerobot(Dataset.open(tmp_path / "back"), tmp_path / "shorter", ExportOptions(codec=codec))
    (shorter,) = (tmp_path / "shorter").glob("videos/*side/**/*.mp4")
    assert min(psnr(a, b) for a, b in zip(VideoReader(shorter).frames(0.0, 38, 30), frames[1:], strict=True)) > 35


def test_videos_whose_key_frames_are_far_apart_are_encoded_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "set", 40, codec="av1")
    options = {"g": "12", "bf": "0"}
    with monkeypatch.context() as patch:
        patch.setattr("rcs_data.video_codec.OPTIONS", {"h264": options, "av1": {}})
        patch.setattr("rcs_data.convert.video.OPTIONS", {"h264": options, "av1": {}})
        export_lerobot(Dataset.open(tmp_path / "set"), tmp_path / "out", ExportOptions(codec="h264", cameras=("side",)))
    back = import_lerobot(tmp_path / "out", tmp_path / "back", ImportOptions(video="h264")).episodes[0]
    packets = stored(back, SIDE)[:-1]
    assert sum(video_packets.follows(data or b"") for data in packets) == 19
    assert muxed(tmp_path / "out", "side") != [data[5:] for data in packets if data]
    assert min(psnr(image, picture(row)) for row, image in enumerate(list(back.frames(SIDE))[:-1])) > 30


@pytest.mark.parametrize("codec", CODECS)
def test_a_damaged_video_is_told_or_was_not_hurt(tmp_path: Path, codec: Any) -> None:
    record(tmp_path / "set", 12, codec="av1")
    export_lerobot(Dataset.open(tmp_path / "set"), tmp_path / "out", ExportOptions(codec=codec, cameras=("side",)))
    (video,) = (tmp_path / "out").glob("videos/*side/**/*.mp4")
    whole, rng, told = video.read_bytes(), np.random.default_rng(0), 0
    for number in range(60):
        damaged = bytearray(whole)
        damaged[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        video.write_bytes(damaged)
        try:
            import_lerobot(tmp_path / "out", tmp_path / f"{number}", ImportOptions(video=codec))
        except CorruptEpisode:
            told += 1
    assert told


def test_rows_may_be_given_as_files_of_another_dataset(tmp_path: Path) -> None:
    one = record(tmp_path / "one", 20)
    with DatasetWriter.open(tmp_path / "two", info_of()) as writer, writer.episode("a", seed=0) as episode:
        for row, files in zip(rows_of(20), pa.concat_tables(one.rows()).column(SIDE).to_pylist(), strict=True):
            episode.add({**row, SIDE: files})
        made = episode.finish(True)
    assert all(psnr(a, b) > 38 for a, b in zip(made.frames(SIDE), one.frames(SIDE), strict=True))


def test_rows_wait_for_the_end_of_their_clip_and_no_longer(tmp_path: Path) -> None:
    episode = record(tmp_path / "set", 100)
    taken = 0

    def pieces() -> Iterator[pa.Table]:
        nonlocal taken
        for row in range(100):
            taken += 1
            yield from episode.rows(row, row + 1)

    made = 0
    for rows in video_packets.packed(episode.info, pieces()):
        made += rows.num_rows
        assert taken == made
        assert rows.num_rows <= 32
    assert made == 100


def test_images_of_another_video_are_found_though_every_file_has_its_hash(tmp_path: Path) -> None:
    episode = record(tmp_path / "set", 20)
    with DatasetWriter.open(tmp_path / "other", info_of()) as writer, writer.episode("a", seed=0) as other:
        for row in rows_of(20):
            other.add({**row, SIDE: row[SIDE][::-1].copy()})
        flipped = other.finish(True)
    frames = (flipped.path / "frames.arrow").read_bytes()
    (episode.path / "frames.arrow").write_bytes(frames)
    about = read_about(episode.path)
    hashes = {**about["sha256"], "frames.arrow": hashlib.sha256(frames).hexdigest()}
    write_file(episode.path / "episode.json", sealed({**about, "sha256": hashes}))
    kinds = {finding.kind for finding in check(tmp_path / "set", depth="rows", workers=1).findings}
    assert "content" in kinds
