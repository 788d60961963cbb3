from __future__ import annotations

import importlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.convert.mcap.export import export_mcap, row_times
from rcs_data.convert.options import ExportOptions
from rcs_data.files.durable import sealed, unsealed

Messages = dict[str, list[tuple[int, Any]]]
Read = Callable[[Path], Messages]


@pytest.fixture
def read() -> Read:
    """Read a file with mcap's reader, and its messages by what the file says of them."""
    reader = importlib.import_module("mcap.reader")
    pools = importlib.import_module("google.protobuf.descriptor_pool")
    descriptors = importlib.import_module("google.protobuf.descriptor_pb2")
    factory = importlib.import_module("google.protobuf.message_factory")

    def messages(path: Path) -> Messages:
        found: Messages = {}
        with path.open("rb") as file:
            for schema, channel, message in reader.make_reader(file).iter_messages():
                assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
                pool = pools.DescriptorPool()
                for described in descriptors.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(described)
                kind = factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
                found.setdefault(channel.topic, []).append((message.log_time, kind.FromString(message.data)))
        return found

    return messages


@pytest.mark.parametrize("started", ["9999-12-31T23:59:59+00:00", "9999-12-31T23:59:59", "0001-01-01", "2262-05-01"])
def test_a_date_that_nanoseconds_cannot_tell_is_as_good_as_none(source: Dataset, started: str) -> None:
    episode = source.episodes[0]
    path = episode.path / "episode.json"
    path.write_bytes(sealed({**unsealed(path.read_bytes(), path), "started": started}))
    rows = row_times(episode, source.info)
    assert rows[0] == 0
    assert (np.diff(rows) > 0).all()


@pytest.mark.extras
def test_a_recording_of_the_year_9999_is_exported(source: Dataset, tmp_path: Path, read: Read) -> None:
    for episode in source.episodes:
        path = episode.path / "episode.json"
        path.write_bytes(sealed({**unsealed(path.read_bytes(), path), "started": "9999-12-31T23:59:59+00:00"}))
    export_mcap(source, tmp_path / "out")
    assert read(tmp_path / "out/take-0.mcap")["/instruction"][0][0] == 0


@pytest.mark.extras
def test_a_file_has_what_was_recorded_at_the_times_of_the_recording(
    source: Dataset, tmp_path: Path, read: Read
) -> None:
    report = export_mcap(source, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [f"take-{i}.mcap" for i in range(3)]
    assert (report.episodes, report.steps) == (3, 6 + 7 + 8)
    for episode in source.episodes:
        found = read(tmp_path / f"out/{episode.id}.mcap")
        times = episode.column("time/monotonic")
        stamps = np.array([at for at, _ in found["/observation/joints"]])
        np.testing.assert_allclose((stamps - stamps[0]) / 1e9, times - times[0], atol=1e-6)
        assert abs(stamps[0] / 1e9 - 1.7e9) < 1e9  # the day of the recording
        joints = [[joint.position for joint in message.joints] for _, message in found["/observation/joints"]]
        np.testing.assert_array_equal(joints, episode.column("observation/joints"))
        assert [joint.name for joint in found["/observation/joints"][0][1].joints] == [f"joints_{i}" for i in range(3)]
        actions = [[joint.position for joint in message.joints] for _, message in found["/action/joints"]]
        np.testing.assert_array_equal(actions, episode.column("action/joints")[1:])
        assert [at for at, _ in found["/action/joints"]] == stamps[:-1].tolist()
        assert [at for at, _ in found["/reward"]] == stamps[1:].tolist()
        rewards = [message.values[0] for _, message in found["/reward"]]
        np.testing.assert_array_equal(rewards, episode.column("reward")[1:])
        images = [message for _, message in found["/observation/frames/wrist/rgb"]]
        assert [image.data for image in images] == list(episode.encoded_frames("observation/frames/wrist/rgb"))
        assert {(image.format, image.frame_id) for image in images} == {("jpeg", "wrist")}
        depth = found["/observation/frames/side/depth"][1][1]
        shown = np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width)
        np.testing.assert_array_equal(shown, episode.column("observation/frames/side/depth")[1])
        assert (depth.encoding, depth.step) == ("16UC1", 32)
        camera = found["/observation/frames/wrist/intrinsics"][0][1]
        assert (camera.width, camera.height, list(camera.K)) == (48, 32, np.eye(3).reshape(-1).tolist())
        ((_, words),) = found["/instruction"]
        assert words.message == episode.instruction
        assert not [topic for topic in found if topic.startswith("/time")]


@pytest.mark.extras
def test_images_have_the_time_when_they_were_taken(dataset: Path, tmp_path: Path, read: Read) -> None:
    export_mcap(Dataset.open(dataset), tmp_path / "out", ExportOptions(compress=False))
    for at, image in read(tmp_path / "out/000000.mcap")["/observation/frames/wrist/rgb"]:
        taken = image.timestamp.seconds * 10**9 + image.timestamp.nanos
        assert abs(at - taken - 0.01e9) < 1000


@pytest.mark.extras
def test_what_repeats_is_written_once_and_lossless_images_are_png(tmp_path: Path, read: Read) -> None:
    features = (
        Feature(key="observation/frames/top/rgb", shape=(8, 10, 3), dtype="uint8", encoding="lossless"),
        Feature(key="observation/frames/top/extrinsics", shape=(4, 4), dtype="float64", encoding="held"),
        Feature(key="observation/touch", shape=(), dtype="bool"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
    )
    info = DatasetInfo(frequency=10, features=features, setup={}, instruction="touch – é")
    noise = np.random.default_rng(0).integers(0, 256, (8, 10, 3), np.uint8)
    with DatasetWriter.open(tmp_path / "in", info) as writer, writer.episode("a", seed=None) as episode:
        for row in range(4):
            image = noise if row == 0 else noise + 1 if row == 2 else None
            values = dict(zip([f.key for f in features], (image, np.eye(4), row > 1, None), strict=True))
            episode.add(values)
        episode.finish(None)
    export_mcap(Dataset.open(tmp_path / "in"), tmp_path / "out")
    found = read(tmp_path / "out/a.mcap")
    assert [len(found[f"/{feature.key}"]) for feature in features[:3]] == [2, 1, 4]
    stamps = [at for at, _ in found["/observation/touch"]]
    assert np.diff(stamps).tolist() == [100_000_000] * 3  # the nominal rate, since nothing was measured
    assert [at for at, _ in found["/observation/frames/top/rgb"]] == [stamps[0], stamps[2]]
    _, image = found["/observation/frames/top/rgb"][1]
    assert image.format == "png"
    with av.open(io.BytesIO(image.data), format="png_pipe") as file:
        np.testing.assert_array_equal(next(file.decode(video=0)).to_ndarray(format="rgb24"), noise + 1)


@pytest.mark.extras
def test_a_file_says_where_it_is_from(source: Dataset, tmp_path: Path) -> None:
    export_mcap(source, tmp_path / "out", ExportOptions(episodes=("take-1",), cameras=("wrist",)))
    with (tmp_path / "out/take-1.mcap").open("rb") as file:
        reader = importlib.import_module("mcap.reader").make_reader(file)
        (metadata,) = reader.iter_metadata()
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
    provenance = json.loads(metadata.metadata["provenance"])
    assert (provenance["episode"], provenance["seed"], provenance["success"]) == ("take-1", 101, False)
    assert not [topic for topic in topics if "side" in topic]
