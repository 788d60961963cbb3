"""Edits of cameras: rename them, resize their frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from rcs_data.edit.transaction import editing
from rcs_data.errors import InvalidSetup, require_fields
from rcs_data.files.codec import ONE_THREAD, decode_frame, encode_frame
from rcs_data.files.feature import Feature
from rcs_data.files.flags import camera_of
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import OnProgress
from rcs_data.read.content import flat_numbers
from rcs_data.read.scale import whole_size

_SINGLE = ("time/frames/", "time/device/frames/", "flags/frames/")


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
        edit.write_all(lambda episode: (with_names(rows, edit.info) for rows in episode.rows()), on_progress)


def renamed(info: DatasetInfo, names: Mapping[str, str]) -> DatasetInfo:
    """Return the info with renamed cameras.

    Raises:
        InvalidSetup: There is no such camera, two would share a name, or a new name is not valid.
    """
    known = cameras_of(info)
    require_fields("camera of this dataset", names, known)
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

    Colour is averaged over the area of a pixel, depth takes the nearest reading. JPEGs are encoded again,
    with the dataset's quality.

    Args:
        path: The dataset.
        size: Width and height [px].
        on_progress: Called with the number of episodes done and of all.

    Raises:
        InvalidSetup: The size is not valid, there is no camera, or intrinsics are not (3, 3) matrices; nothing changes.
        CorruptEpisode: An episode is damaged; nothing changes.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing changes.
    """
    pixels = whole_size(size)
    with editing(path, "resize", {"size": list(pixels)}, new_info=lambda info: resized(info, pixels)) as edit:
        edit.write_all(lambda one: (with_size(rows, one.info, edit.info) for rows in one.rows()), on_progress)


def resized(info: DatasetInfo, size: tuple[int, int]) -> DatasetInfo:
    """Return the info with resized frames.

    Raises:
        InvalidSetup: The size is not valid, there is no camera, or intrinsics are not (3, 3) matrices.
    """
    width, height = whole_size(size)
    if min(width, height) < 1 or max(width, height) > 16384:
        raise InvalidSetup(f"size is {width} x {height}; width and height must be from 1 to 16384 pixels.")
    if not cameras_of(info):
        raise InvalidSetup("The dataset has no camera frames to resize.")
    features = tuple(replace(f, shape=(height, width, *f.shape[2:])) if _is_frame(f) else f for f in info.features)
    after = replace(info, features=features)
    for feature in info.features:
        if feature.shape != (3, 3) and _factors(feature.key, info, after):
            raise InvalidSetup(
                f"{feature.key!r} is {feature.shape}; only intrinsics of (3, 3) can be scaled with frames. "
                "Leave it out with mix (drop)."
            )
    return after


def _is_frame(feature: Feature) -> bool:
    return feature.is_image and camera_of(feature.key) is not None


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
        # A mix may have one of another shape, which it leaves out.
        elif feature is not None and feature.shape == (3, 3) and (factors := _factors(feature.key, before, info)):
            columns.append(_scaled_intrinsics(column, feature, factors))
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


def _factors(key: str, old: DatasetInfo, new: DatasetInfo) -> tuple[float, float] | None:
    """Return by what to scale a camera's intrinsics across and down; None for others, or where its frames stay."""
    if key.endswith("/intrinsics"):
        for feature in old.features:
            after = new.feature(feature.key).shape
            if _is_frame(feature) and camera_of(feature.key) == camera_of(key) and feature.shape != after:
                return after[1] / feature.shape[1], after[0] / feature.shape[0]
    return None


def _scaled_intrinsics(column: pa.Array, feature: Feature, factors: tuple[float, float]) -> pa.Array:
    # Centres of pixels have whole numbers: x becomes (x + 0.5) * scale - 0.5.
    across, down = factors
    scaling = np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])
    numbers = (scaling @ flat_numbers(column).reshape(-1, 3, 3)).astype(feature.numpy_dtype)
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers.reshape(-1)), 9, mask=column.is_null())


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
