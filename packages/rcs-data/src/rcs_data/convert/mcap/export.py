"""Exports to MCAP, a file per episode, which Foxglove and Rerun open.

The topic of a feature is its key: `/observation/frames/wrist/rgb`. Colour is `foxglove.CompressedImage`, in the bytes
that were recorded; depth `foxglove.RawImage` (mm); intrinsics `foxglove.CameraCalibration`; joints
`foxglove.JointStates`; all other numbers `rcs.Numbers`; `/instruction` `foxglove.Log`.

A file carries the description of each of its messages, so readers need nothing else.

Times are those of the recording: a message has the time of its row, an image also the time when it was taken. An action
has the time of the observation before it, since that is when it was commanded.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.images import as_png
from rcs_data.convert.observations import export_report, kept_info
from rcs_data.convert.options import ExportOptions, ExportReport, refuse_unused, selected_episodes
from rcs_data.convert.provenance import episode_provenance
from rcs_data.errors import package_of
from rcs_data.files.codec import decode_frame
from rcs_data.files.feature import Feature
from rcs_data.files.flags import camera_of
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import new_output
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.read.trajectory import VectorLayout, camera_features

COMPRESSED_IMAGE, RAW_IMAGE, CALIBRATION = "CompressedImage", "RawImage", "CameraCalibration"
JOINTS, JOINT, LOG = "JointStates", "JointState", "Log"
NUMBERS = "rcs.Numbers"

_DOUBLE, _REPEATED = 1, 3  # of FieldDescriptorProto
_SECOND = 1_000_000_000
# 64 bits of nanoseconds end in the year 2262 [s since 1970].
_LATEST = datetime(2262, 1, 1, tzinfo=timezone.utc).timestamp()
_TIME, _FRAME_TIME = "time/monotonic", "time/frames/"


def export_mcap(dataset: Dataset, out: str | Path, options: ExportOptions | None = None) -> ExportReport:
    """Export episodes as MCAP files.

    Args:
        dataset: The dataset.
        out: The folder for `<episode>.mcap`.
        options: Episodes and cameras; `compress` is for the files.

    Raises:
        MissingDependency: The extra `mcap` is not installed.
        InvalidSetup: An option does not suit the dataset, or nothing is left to export.
        CorruptEpisode: An episode is damaged.
        DatasetError: `out` exists already, or the disk fails.
    """
    mcap = load("mcap.writer")
    message_class(LOG)
    options = options or ExportOptions()
    refuse_unused(options, "MCAP", ("compress",))
    episodes = selected_episodes(dataset, options)
    info = kept_info(dataset.info, options)
    compression = mcap.CompressionType.ZSTD if options.compress else mcap.CompressionType.NONE
    digest = dataset.digest()
    total = sum(episode.length for episode in episodes)
    done = images = 0
    with new_output(out) as partial:
        partial.mkdir()
        for episode in episodes:
            with (partial / f"{episode.id}.mcap").open("wb") as file:
                writer: Any = mcap.Writer(file, compression=compression)
                writer.start(library="rcs-data")
                about = {"provenance": episode_provenance(episode, digest), "setup": info.setup}
                writer.add_metadata("rcs", {name: json.dumps(value) for name, value in about.items()})
                images += _write(writer, episode, info)
                writer.finish()
            done += episode.length
            if options.on_progress is not None:
                options.on_progress(done, total)
    return export_report(Path(out), dataset, options, episodes, images)


def _write(writer: Any, episode: EpisodeRecord, info: DatasetInfo) -> int:
    """Write all messages of an episode, row by row, and return the number of images."""
    rows = row_times(episode, info)
    features = [f for f in info.features if not f.key.startswith("time/")]  # which are the times of the messages
    channels = [_channel(writer, f"/{feature.key}", _message(feature)) for feature in features]
    streams = zip(*(_messages(episode, feature, rows) for feature in features), strict=True)
    start = int(rows[0])
    words = message_class(LOG)(message=episode.instruction, name="instruction", level="INFO")
    words.timestamp.FromNanoseconds(start)
    writer.add_message(_channel(writer, "/instruction", LOG), start, words.SerializeToString(), start)
    images = 0
    for row, messages in enumerate(streams):
        for feature, channel, message in zip(features, channels, messages, strict=True):
            # The action of a step was commanded when the step began.
            is_command = feature.key.startswith(("action/", "executed/"))
            if message is None or (row == 0 and feature.is_unknown_at_reset):
                continue
            at = int(rows[row - 1 if is_command else row])
            if not feature.is_image and _message(feature) != NUMBERS:
                message.timestamp.FromNanoseconds(at)
            writer.add_message(channel, at, message.SerializeToString(deterministic=True), at)
            images += feature.is_image
    return images


def _channel(writer: Any, topic: str, message: str) -> int:
    number = load("mcap_protobuf.schema").register_schema(writer, message_class(message))
    return writer.register_channel(topic, "protobuf", number)


def _message(feature: Feature) -> str:
    if feature.is_image:
        return COMPRESSED_IMAGE if feature.dtype == "uint8" else RAW_IMAGE
    word = feature.key.rpartition("/")[2]
    if word == "intrinsics" and feature.shape == (3, 3):
        return CALIBRATION
    return JOINTS if word == "joints" and len(feature.shape) == 1 else NUMBERS


def row_times(episode: EpisodeRecord, info: DatasetInfo) -> NDArray[np.int64]:
    """Return the time of each row [ns since 1970], as measured where the dataset has that; from 0 if it has no date.

    Args:
        episode: The episode.
        info: The features that are exported of it, as an info.

    Raises:
        CorruptEpisode: The episode is damaged.
    """
    started = episode.about.get("started")
    try:
        start = datetime.fromisoformat(started).timestamp() if isinstance(started, str) else 0.0
    except (ValueError, OverflowError):
        start = 0.0
    start = start if 0 < start < _LATEST else 0.0
    since = np.arange(episode.length) / info.frequency
    if any(feature.key == _TIME for feature in info.features):
        measured = episode.column(_TIME)
        elapsed = measured - measured[0]
        if np.isfinite(elapsed).all() and (np.diff(elapsed) >= 0).all() and start + elapsed[-1] < _LATEST:
            since = elapsed
    return np.int64(start * 1e6) * 1000 + np.round(since * _SECOND).astype(np.int64)


def _frame_times(episode: EpisodeRecord, camera: str, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return when the image of each row was taken [ns since 1970]; the time of the row where that is not known."""
    keys = {feature.key for feature in episode.info.features}
    if not {_TIME, _FRAME_TIME + camera} <= keys:
        return rows
    delay = episode.column(_TIME) - episode.column(_FRAME_TIME + camera)
    is_known = np.isfinite(delay) & (np.abs(delay) < 60)
    return np.maximum(rows - np.where(is_known, np.round(delay * _SECOND), 0).astype(np.int64), 0)


def _messages(episode: EpisodeRecord, feature: Feature, rows: NDArray[np.int64]) -> Iterator[Any]:
    """Yield a feature's message by row, of images with their time; None where it repeats the row before."""
    camera = camera_of(feature.key) or ""
    last: Any = None
    if feature.is_image:
        taken = _frame_times(episode, camera, rows)
        for row, data in enumerate(episode.encoded_frames(feature.key)):
            if data is last:
                yield None
                continue
            last, message = data, _image(feature, data)
            message.frame_id = camera
            message.timestamp.FromNanoseconds(int(taken[row]))
            yield message
        return
    kind = _message(feature)
    make = message_class(kind)
    names = feature.limits.names if feature.limits is not None else VectorLayout(features=(feature,)).names
    colour = camera_features(episode.info).get(camera)
    height, width = (0, 0) if colour is None else colour.shape[:2]
    for value in episode.column(feature.key):
        numbers = np.asarray(value, np.float64).reshape(-1)
        if feature.encoding == "held" and last is not None and np.array_equal(numbers, last):
            yield None
        elif kind == JOINTS:
            joint = message_class(JOINT)
            pairs = zip(names, numbers.tolist(), strict=True)
            yield make(joints=[joint(name=name, position=position) for name, position in pairs])
        elif kind == CALIBRATION:
            projection = np.hstack([numbers.reshape(3, 3), np.zeros((3, 1))])
            matrices = {"K": numbers, "R": np.eye(3), "P": projection}
            flat = {name: matrix.reshape(-1).tolist() for name, matrix in matrices.items()}
            yield make(frame_id=camera, width=width, height=height, **flat)
        else:
            yield make(values=numbers.tolist())
        last = numbers


def _image(feature: Feature, data: bytes) -> Any:
    if feature.dtype == "uint8":
        is_jpeg = feature.encoding == "jpeg"
        compressed = data if is_jpeg else as_png(feature, data)
        return message_class(COMPRESSED_IMAGE)(format="jpeg" if is_jpeg else "png", data=compressed)
    image = decode_frame(feature, data)
    height, width = image.shape
    pixels = np.ascontiguousarray(image, "<u2").tobytes()
    return message_class(RAW_IMAGE)(width=width, height=height, encoding="16UC1", step=2 * width, data=pixels)


def load(name: str) -> Any:
    """Return a module of the extra `mcap`; MissingDependency if it is not installed."""
    return package_of(name, "mcap", "MCAP files need mcap and its schemas")


@cache
def message_class(name: str) -> Any:
    """Return the class of a message, one of the names above.

    Raises:
        MissingDependency: The extra `mcap` is not installed.
    """
    if name != NUMBERS:
        return getattr(load(f"foxglove_schemas_protobuf.{name}_pb2"), name)
    package, _, word = name.partition(".")
    file = load("google.protobuf.descriptor_pb2").FileDescriptorProto(name=f"{package}/{word}.proto", package=package)
    file.syntax = "proto3"
    file.message_type.add(name=word).field.add(name="values", number=1, label=_REPEATED, type=_DOUBLE)
    pool = load("google.protobuf.descriptor_pool").DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    return load("google.protobuf.message_factory").GetMessageClass(pool.FindMessageTypeByName(name))
