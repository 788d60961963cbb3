"""A dataset as a recording for the Rerun viewer: one `.rrd` file, with the episodes one after the other in time."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import MissingDependency
from rcs_data.feature import Feature
from rcs_data.output import OnProgress, new_output
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.clips import pictures
from rcs_data.view.page import chosen_episodes

# So long between two episodes that the end of one and the start of the next are told apart on the time line [s].
_PAUSE = 0.5
_ROW, _TIME = "row", "time"


def write_rerun(
    dataset: Dataset | str | Path,
    out: str | Path,
    *,
    episodes: Sequence[str] | None = None,
    on_progress: OnProgress | None = None,
) -> int:
    """Write episodes as one Rerun recording, and return how many there are.

    Numbers and images keep their keys as entity paths; JPEG images are taken over as they are. The time line "time" has
    the episodes one after the other at the recorded rate, "row" counts rows; the entity `episode` says which one it is.

    Args:
        dataset: The dataset, or its folder.
        out: The file to write, which must not be there yet.
        episodes: Ids, or patterns such as "0001*", of the episodes to write; None for all.
        on_progress: Called with the episodes done and all that there are.

    Raises:
        MissingDependency: Rerun is not installed.
        InvalidSetup: No episode has one of the ids.
        DatasetError: There is no dataset, the file is there already, or cannot be written.
        CorruptEpisode: An episode is damaged.
    """
    rr = _rerun()
    dataset = dataset if isinstance(dataset, Dataset) else Dataset.open(dataset)
    chosen = chosen_episodes(dataset, episodes)
    with new_output(out) as partial:
        recording = rr.RecordingStream(dataset.path.resolve().name)
        recording.save(partial)
        first_row, start = 0, 0.0
        for done, episode in enumerate(chosen):
            _Episode(rr, recording, episode, first_row, start).send()
            first_row += episode.length
            start += episode.length / dataset.info.frequency + _PAUSE
            if on_progress is not None:
                on_progress(done + 1, len(chosen))
        recording.flush()
        recording.disconnect()
    return len(chosen)


def _rerun() -> Any:
    try:
        # By name, so that types are checked with and without it.
        return importlib.import_module("rerun")
    except ImportError as err:
        raise MissingDependency("Recordings for Rerun need its package: pip install 'rcs-data[rerun]'.") from err


class _Episode:
    """Sends one episode, whose rows begin at a row and a time [s] of the recording."""

    def __init__(self, rr: Any, recording: Any, episode: EpisodeRecord, first_row: int, start: float) -> None:
        self._rr = rr
        self._recording = recording
        self._episode = episode
        self._rows = first_row + np.arange(episode.length)
        self._times = start + np.arange(episode.length) / episode.info.frequency

    def send(self) -> None:
        if not self._episode.length:
            return
        words = {True: "success", False: "failure", None: "not judged"}[self._episode.success]
        self._at(0)
        self._log("episode", self._rr.TextLog(f"{self._episode.id}: {self._episode.instruction} ({words})"))
        shown = pictures(self._episode.info)
        for feature in self._episode.info.features:
            if feature.is_image:
                self._send_images(feature)
            elif feature in shown:
                self._send_map(feature)
            elif feature.key.endswith("/intrinsics"):
                self._send_camera(feature)
            elif not feature.key.endswith("/extrinsics"):
                self._send_numbers(feature)

    def _at(self, row: int) -> None:
        self._recording.set_time(_ROW, sequence=int(self._rows[row]))
        self._recording.set_time(_TIME, duration=float(self._times[row]))

    def _log(self, key: str, what: Any) -> None:
        self._recording.log(self._path(key), what)

    def _path(self, key: str) -> str:
        # Spaces and signs in a name are to be marked.
        return self._rr.new_entity_path(key.split("/"))

    def _send_images(self, feature: Feature) -> None:
        last: bytes | None = None
        decoded = None if feature.encoding == "jpeg" else self._episode.frames(feature.key)
        for row, data in enumerate(self._episode.encoded_frames(feature.key)):
            image = None if decoded is None else next(decoded)
            if data is last:
                continue  # what was sent last stays
            last = data
            self._at(row)
            if image is None:
                self._log(feature.key, self._rr.EncodedImage(contents=data, media_type="image/jpeg"))
            elif feature.encoding == "depth":
                self._log(feature.key, self._rr.DepthImage(image, meter=1000.0))
            elif feature.encoding == "labels":
                self._log(feature.key, self._rr.SegmentationImage(image))
            else:
                self._log(feature.key, self._rr.Image(image))

    def _send_map(self, feature: Feature) -> None:
        for row, values in enumerate(self._episode.column(feature.key)):
            self._at(row)
            self._log(feature.key, self._rr.DepthImage(values.astype(np.float32), meter=1.0))

    def _send_camera(self, feature: Feature) -> None:
        """Send where the camera is and what it sees, so that its images stand in space; anew where that changes."""
        camera = feature.key.removesuffix("/intrinsics")
        known = {other.key: other for other in self._episode.info.features}
        picture = next((other for key, other in known.items() if key.startswith(f"{camera}/") and other.is_image), None)
        matrices = self._episode.column(feature.key)
        for row in _changes(matrices):
            self._at(row)
            resolution = None if picture is None else (picture.shape[1], picture.shape[0])
            self._log(camera, self._rr.Pinhole(image_from_camera=matrices[row], resolution=resolution))
        if f"{camera}/extrinsics" in known:
            poses = self._episode.column(f"{camera}/extrinsics")
            for row in _changes(poses):
                self._at(row)
                self._log(camera, self._rr.Transform3D(translation=poses[row, :3, 3], mat3x3=poses[row, :3, :3]))

    def _send_numbers(self, feature: Feature) -> None:
        numbers = self._episode.column(feature.key).reshape(self._episode.length, -1).astype(np.float64)
        known = np.flatnonzero(np.isfinite(numbers).any(axis=1))  # the reset has no action
        if not len(known):
            return
        columns = self._rr.Scalars.columns(scalars=numbers[known])
        indexes = [
            self._rr.TimeColumn(_ROW, sequence=self._rows[known]),
            self._rr.TimeColumn(_TIME, duration=self._times[known]),
        ]
        self._recording.send_columns(self._path(feature.key), indexes=indexes, columns=columns)


def _changes(values: NDArray[np.float64]) -> list[int]:
    """Return the first row, and those that differ from the row before."""
    differ = (np.diff(values, axis=0) != 0).reshape(len(values) - 1, -1).any(axis=1)
    return [0, *(np.flatnonzero(differ) + 1).tolist()]
