"""Edits of cameras: rename them, resize their frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from operator import index
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from rcs_data.codec import decode_frame, encode_frame
from rcs_data.edit.transaction import editing
from rcs_data.errors import InvalidSetup
from rcs_data.feature import Feature
from rcs_data.flags import camera_of
from rcs_data.info import DatasetInfo
from rcs_data.output import OnProgress
from rcs_data.video_codec import ONE_THREAD

_SINGLE = ("time/frames/", "flags/frames/")


def cameras_of(info: DatasetInfo) -> list[str]:
    """Return the names of all cameras, sorted."""
    return sorted({camera for f in info.features if f.is_image and (camera := camera_of(f.key)) is not None})


def rename_camera(path: str | Path, name: str, to: str, *, on_progress: OnProgress | None = None) -> None:
    """Rename a camera in all its features.

    Args:
        path: The dataset.
        name: The camera.
        to: Its new name.
        on_progress: Called with the number of episodes done and of all.

    Raises:
        InvalidSetup: There is no such camera, or the new name is taken; nothing changes.
        CorruptEpisode: An episode is damaged; nothing changes.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing changes.
    """
    arguments = {"name": name, "to": to}
    with editing(path, "rename-camera", arguments, new_info=lambda info: renamed(info, {name: to})) as edit:
        episodes = edit.dataset.episodes
        for i, episode in enumerate(episodes):
            edit.write(episode, (with_names(rows, edit.info) for rows in episode.rows(packets=True)))
            if on_progress is not None:
                on_progress(i + 1, len(episodes))


def renamed(info: DatasetInfo, names: Mapping[str, str]) -> DatasetInfo:
    """Return the info with renamed cameras.

    Raises:
        InvalidSetup: There is no such camera, two would share a name, or a new name is not valid.
    """
    known = cameras_of(info)
    if unknown := sorted(set(names) - set(known)):
        raise InvalidSetup(f"There is no camera {', '.join(unknown)}; there are {', '.join(known) or 'none'}.")
    after = [names.get(camera, camera) for camera in known]
    if len(set(after)) < len(after):
        raise InvalidSetup(f"Cameras {known} cannot be renamed to {after}: two would share a name.")
    return replace(info, features=tuple(replace(f, key=_renamed_key(f.key, names)) for f in info.features))


def with_names(rows: pa.Table, info: DatasetInfo) -> pa.Table:
    """Return the rows, with images or their numbers, with renamed columns in the same order."""
    more = list(rows.schema)[len(info.features) :]
    fields = [feature.arrow_field.with_type(rows.schema.field(i).type) for i, feature in enumerate(info.features)]
    return pa.Table.from_arrays([column.combine_chunks() for column in rows.columns], schema=pa.schema(fields + more))


def resize(path: str | Path, size: tuple[int, int], *, on_progress: OnProgress | None = None) -> None:
    """Scale all camera frames to another size; intrinsics are scaled with them.

    Colour is averaged over the area of a pixel, depth takes the nearest reading. JPEGs and videos are encoded again,
    with the dataset's quality.

    Args:
        path: The dataset.
        size: Width and height [px].
        on_progress: Called with the number of episodes done and of all.

    Raises:
        InvalidSetup: The size is not valid, or there is no camera; nothing changes.
        CorruptEpisode: An episode is damaged; nothing changes.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing changes.
    """
    size = (index(size[0]), index(size[1]))  # NumPy's are no JSON
    with editing(path, "resize", {"size": list(size)}, new_info=lambda info: resized(info, size)) as edit:
        episodes = edit.dataset.episodes
        for i, episode in enumerate(episodes):
            edit.write(episode, (with_size(rows, episode.info, edit.info) for rows in episode.rows()))
            if on_progress is not None:
                on_progress(i + 1, len(episodes))


def resized(info: DatasetInfo, size: tuple[int, int]) -> DatasetInfo:
    """Return the info with resized frames.

    Raises:
        InvalidSetup: The size is not valid, or there is no camera.
    """
    width, height = size
    if min(size) < 1 or max(size) > 16384:
        raise InvalidSetup(f"size is {width} x {height}; width and height must be from 1 to 16384 pixels.")
    if not cameras_of(info):
        raise InvalidSetup("The dataset has no camera frames to resize.")
    if wrong := [f for f in info.features if _is_matrix(f) and f.shape != (3, 3)]:
        raise InvalidSetup(
            f"{wrong[0].key!r} is {wrong[0].shape}; only intrinsics of (3, 3) can be scaled with frames."
        )
    return replace(
        info,
        features=tuple(
            replace(f, shape=(height, width, *f.shape[2:])) if f.is_image and camera_of(f.key) is not None else f
            for f in info.features
        ),
    )


def _is_matrix(feature: Feature) -> bool:
    return feature.key.endswith("/intrinsics") and camera_of(feature.key) is not None


def with_size(rows: pa.Table, before: DatasetInfo, info: DatasetInfo) -> pa.Table:
    """Return the rows with all frames scaled from their sizes in one info to those in another."""
    columns: list[pa.Array] = []
    for field in rows.schema:
        column = rows.column(field.name).combine_chunks()
        feature = next((f for f in info.features if f.key == field.name), None)
        old = None if feature is None else before.feature(feature.key)
        if feature is not None and old is not None and feature.is_image and feature.shape != old.shape:
            images = [
                encode_frame(feature, scaled(decode_frame(old, image.as_py()), feature), info)
                if image.is_valid
                else None
                for image in column
            ]
            columns.append(pa.array(images, type=pa.binary()))
        elif feature is not None and _is_matrix(feature):
            columns.append(_scaled_intrinsics(column, feature, before, info))
        else:
            columns.append(column)
    fields = [*(feature.arrow_field for feature in info.features), *list(rows.schema)[len(info.features) :]]
    return pa.Table.from_arrays(columns, schema=pa.schema(fields))


def scaled(image: NDArray[Any], feature: Feature) -> NDArray[Any]:
    """Return an image scaled to the size of a feature: colour averaged, depth by the nearest reading.

    Args:
        image: Shape (h, w, 3) uint8, or (h, w) uint16.
        feature: An image feature of the same kind, (H, W, …).
    """
    height, width = feature.shape[:2]
    if image.ndim == 3:
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        return VideoReformatter().reformat(frame, width, height, interpolation="AREA", **ONE_THREAD).to_ndarray()
    # The reading nearest to the centre of each new pixel; of two, the first.
    rows, columns = (
        np.ceil((np.arange(new) + 0.5) * old / new - 1).astype(np.intp)
        for new, old in zip((height, width), image.shape, strict=True)
    )
    return np.ascontiguousarray(image[rows[:, None], columns])


def _scaled_intrinsics(column: pa.Array, feature: Feature, old: DatasetInfo, new: DatasetInfo) -> pa.Array:
    frames = [f for f in old.features if f.is_image and camera_of(f.key) == camera_of(feature.key)]
    if not frames:
        return column
    before, after = frames[0].shape, new.feature(frames[0].key).shape
    # Centres of pixels have whole numbers: x becomes (x + 0.5) * scale - 0.5.
    across, down = after[1] / before[1], after[0] / before[0]
    scaling = np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])
    is_null = column.is_null()
    values = column.values.slice(column.offset * 9, len(column) * 9).to_numpy(zero_copy_only=False)
    numbers = (scaling @ values.reshape(-1, 3, 3)).astype(feature.numpy_dtype)
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers.reshape(-1)), 9, mask=is_null)


def _renamed_key(key: str, names: Mapping[str, str]) -> str:
    for prefix in _SINGLE:
        if key.startswith(prefix):
            camera = key.removeprefix(prefix)
            return prefix + names.get(camera, camera)
    camera = camera_of(key)
    if camera is None:
        return key
    head, _, leaf = key.rpartition("/")
    return f"{head.removesuffix(camera)}{names.get(camera, camera)}/{leaf}"
