"""Windows of a dataset for training: some observations up to a step, and the actions from it on.

Step t of an episode has the observation of row t and the action that followed, as in `rcs_data.read.trajectory`.
The window of step t has the observations of t - history + 1 to t and the actions of t to t + horizon - 1. Windows never
cross into another episode: the first observation and the last action are repeated instead, with flags, as in ACT (T. Z.
Zhao et al., 2023) and Diffusion Policy (C. Chi et al., 2023).
"""

from __future__ import annotations

import operator
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, TypedDict, cast, get_args, overload

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import InvalidSetup, require_fields
from rcs_data.files.feature import Feature
from rcs_data.files.output import OnProgress
from rcs_data.options import require_whole
from rcs_data.read.episode_record import EpisodeRecord
from rcs_data.read.frame_access import ByteCache, FrameAccess
from rcs_data.read.scale import Scaler, whole_size
from rcs_data.read.statistics import RunningStatistics, Statistics
from rcs_data.read.torch import ChosenWindow, TorchDataset
from rcs_data.read.trajectory import action_layout, camera_features, state_layout

if TYPE_CHECKING:
    from rcs_data.read.reader import Dataset

Padding = Literal["repeat", "drop"]

_VECTOR_BYTES = 1 << 30
_Vectors = tuple[NDArray[np.float64], NDArray[np.float64]]


class Window(TypedDict):
    """The window of one step."""

    state: NDArray[np.float64]
    """States, the newest last, shape (history, state)."""
    images: dict[str, NDArray[Any]]
    """By camera, (history, H, W, 3) uint8, or for depth (history, H, W) uint16 millimetres."""
    actions: NDArray[np.float64]
    """Actions from this step on, shape (horizon, action)."""
    is_pad: NDArray[np.bool_]
    """Whether an action comes after the end and repeats the last one, shape (horizon,)."""
    is_history_pad: NDArray[np.bool_]
    """Whether an observation comes before the start and repeats the first one, shape (history,)."""
    instruction: str
    """The instruction that the robot had."""
    episode: str
    """The id of the episode."""
    step: int
    """The number of the step in it, from 0."""


class WindowBatch(TypedDict):
    """Several windows; every array has one more axis in front."""

    state: NDArray[np.float64]
    images: dict[str, NDArray[Any]]
    actions: NDArray[np.float64]
    is_pad: NDArray[np.bool_]
    is_history_pad: NDArray[np.bool_]
    instruction: list[str]
    episode: list[str]
    step: NDArray[np.int64]


class Windows(Sequence[Window]):
    """All windows of a dataset, read when accessed, in any order.

    `torch.utils.data.DataLoader` takes them as they are and gives the tensors of `TorchDataset`. It reads them one by
    one, as the arrays that they are, inside of a `ConcatDataset` and with `batch_size=None`: there, give
    `TorchDataset(windows)` instead.

    Caches are not copied to other processes, so workers of any kind may share it. Not thread-safe.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        history: int = 1,
        horizon: int = 16,
        state: Sequence[str] | None = None,
        action: Sequence[str] | None = None,
        cameras: Sequence[str] | None = None,
        episodes: Sequence[EpisodeRecord | str] | None = None,
        stride: int = 1,
        image_size: tuple[int, int] | None = None,
        pad: Padding = "repeat",
        cache_bytes: int = _VECTOR_BYTES,
    ) -> None:
        """Find all windows; reads only the length of every episode.

        Args:
            dataset: The dataset.
            history: Observations in a window.
            horizon: Actions in a window.
            state: Features that make up the state; None for joints, then gripper or hand, robot by robot.
            action: Features that make up the action; None for the arm's part, then gripper or hand.
            cameras: Names, such as "wrist", or "wrist/depth" for the depth image; None for the colour images of all, ()
                for none.
            episodes: Episodes of the dataset to take, or their ids, such as those that succeeded; None for all.
            stride: Steps from one window to the next.
            image_size: Width and height to scale colour images to [px]; None for the recorded size.
            pad: "repeat" makes a window of every step; "drop" only those that need no repetition.
            cache_bytes: Memory per process for states and actions; the least recently used are read again.

        Raises:
            InvalidSetup: An argument does not make sense, or there is no window.
            CorruptEpisode: The description of an episode is damaged.
        """
        history = require_whole("history", history, 1)
        horizon = require_whole("horizon", horizon, 1)
        stride = require_whole("stride", stride, 1)
        if pad not in get_args(Padding):
            raise InvalidSetup(f"pad is {pad!r}; valid are {', '.join(get_args(Padding))}.")
        self.history, self.horizon, self.stride = history, horizon, stride
        self.state_layout = state_layout(dataset.info, state)
        self.action_layout = action_layout(dataset.info, action)
        self.cameras = _chosen_cameras(dataset, cameras)
        chosen = dataset.episodes if episodes is None else episodes
        self.episodes = tuple(dataset[one] if isinstance(one, str) else one for one in chosen)
        for episode in self.episodes:
            if episode.info is not dataset.info and episode.info != dataset.info:
                raise InvalidSetup(f"Episode {episode.id!r} is not of the dataset in {dataset.path}.")
        self._scalers = _scalers(self.cameras, image_size)
        first, tail = (0, 1) if pad == "repeat" else (history - 1, horizon)
        self._first = first
        # A step lies between two rows, and a window needs `tail` steps from its own on.
        counts = [len(range(first, max(e.length, 1) - tail, stride)) for e in self.episodes]
        self._ends = list(accumulate(counts))
        if not len(self):
            needed = (
                "a step" if pad == "repeat" else f"the {history + horizon - 1} steps of one window; use pad='repeat'"
            )
            raise InvalidSetup(f"None of the {len(self.episodes)} episodes of {dataset.path} has {needed}.")
        self._vectors: ByteCache[_Vectors] = ByteCache(cache_bytes)
        self._frames = FrameAccess()

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    @overload
    def __getitem__(self, index: int) -> Window: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Window]: ...
    def __getitem__(self, index: int | slice) -> Window | Sequence[Window]:
        """Read one window, or all of a slice.

        Raises:
            IndexError: There is no such window.
            CorruptEpisode: The episode is damaged.
        """
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        batch: dict[str, Any] = {**self.batch([index])}
        images = {name: images[0] for name, images in batch.pop("images").items()}
        step = int(batch.pop("step")[0])
        return cast(Window, {**{name: values[0] for name, values in batch.items()}, "images": images, "step": step})

    def __getitems__(self, indices: Sequence[int]) -> list[ChosenWindow]:
        """Choose windows for a batch; torch's `DataLoader` calls this, and gets the tensors of `TorchDataset`.

        Raises:
            MissingDependency: torch is not installed.
        """
        return TorchDataset(self).__getitems__(indices)

    def image_shape(self, camera: str) -> tuple[int, ...]:
        """Return the shape of one image in a window: (H, W, 3), or (H, W) for depth."""
        scaler, feature = self._scalers.get(camera), self.cameras[camera]
        return feature.shape if scaler is None else (*scaler.target, *feature.shape[2:])

    def batch(
        self, indices: Sequence[SupportsIndex], *, images: Mapping[str, NDArray[Any]] | None = None
    ) -> WindowBatch:
        """Read several windows into one array each, in the order given.

        Args:
            indices: Their numbers; negative ones count from the end.
            images: Output arrays by camera: contiguous, shape (len(indices), history, *image_shape), of the feature's
                dtype; None for new arrays.

        Raises:
            IndexError: There is no such window.
            CorruptEpisode: An episode is damaged.
        """
        places = [self.place(index) for index in indices]
        steps = np.array([step for _, step in places], np.int64)
        lasts = np.array([episode.length - 2 for episode, _ in places], np.int64)
        seen = steps[:, None] + np.arange(1 - self.history, 1)
        done = steps[:, None] + np.arange(self.horizon)
        rows, actions = np.maximum(seen, 0), np.minimum(done, lasts[:, None])
        vectors = [self._episode_vectors(episode) for episode, _ in places]
        if images is None:
            images = self.new_images(len(places))
        for camera, out in images.items():
            for n, (episode, _) in enumerate(places):
                self._read_images(episode, camera, rows[n].tolist(), out[n])
        return {
            "state": _joined(
                [states[r] for (states, _), r in zip(vectors, rows, strict=True)], rows, self.state_layout.size
            ),
            "images": dict(images),
            "actions": _joined(
                [a[r] for (_, a), r in zip(vectors, actions, strict=True)], actions, self.action_layout.size
            ),
            "is_pad": done > lasts[:, None],
            "is_history_pad": seen < 0,
            "instruction": [episode.instruction for episode, _ in places],
            "episode": [episode.id for episode, _ in places],
            "step": steps,
        }

    def new_images(self, count: int) -> dict[str, NDArray[Any]]:
        """Return empty arrays for the images of some windows, by camera."""
        return {
            name: np.empty((count, self.history, *self.image_shape(name)), feature.numpy_dtype)
            for name, feature in self.cameras.items()
        }

    def statistics(self, on_progress: OnProgress | None = None) -> dict[str, Statistics]:
        """Return the statistics of "state" and "actions" over all steps of the chosen episodes, each counted once.

        Args:
            on_progress: Called with the episodes done and the episodes in all.

        Raises:
            InvalidSetup: A number is not finite.
            CorruptEpisode: An episode is damaged.
        """
        running = {
            "state": RunningStatistics(self.state_layout.size),
            "actions": RunningStatistics(self.action_layout.size),
        }
        for done, episode in enumerate(self.episodes, 1):
            for statistics, values in zip(running.values(), self._episode_vectors(episode), strict=True):
                try:
                    statistics.add(values)
                except InvalidSetup as err:
                    raise InvalidSetup(f"Episode {episode.id!r}: {err}") from err
            if on_progress is not None:
                on_progress(done, len(self.episodes))
        return {name: statistics.result() for name, statistics in running.items()}

    def place(self, index: SupportsIndex) -> tuple[EpisodeRecord, int]:
        """Return the episode and the step of a window.

        Raises:
            IndexError: There is no such window.
        """
        number = operator.index(index)
        wanted = number + len(self) if number < 0 else number
        if not 0 <= wanted < len(self):
            raise IndexError(f"There is no window {number}; there are {len(self)}.")
        place = bisect_right(self._ends, wanted)
        before = self._ends[place - 1] if place else 0
        return self.episodes[place], self._first + (wanted - before) * self.stride

    def _episode_vectors(self, episode: EpisodeRecord) -> _Vectors:
        def read() -> tuple[_Vectors, int]:
            # Opening a file takes as long as reading a thousand rows of it, so it is opened once.
            columns = episode.columns(f.key for f in (*self.state_layout.features, *self.action_layout.features))
            states = self.state_layout.joined(columns, episode.length)[:-1]
            actions = self.action_layout.joined(columns, episode.length)[1:]
            return (states, actions), states.nbytes + actions.nbytes

        return self._vectors.get(episode, read)

    def _read_images(self, episode: EpisodeRecord, camera: str, rows: list[int], out: NDArray[Any]) -> None:
        feature, scaler = self.cameras[camera], self._scalers.get(camera)
        if scaler is None:
            self._frames.frames(episode, feature.key, rows, out)
            return
        whole = np.empty((len(rows), *feature.shape), feature.numpy_dtype)
        self._frames.frames(episode, feature.key, rows, whole)
        for image, place in zip(whole, out, strict=True):
            scaler(image, place)


def _chosen_cameras(dataset: Dataset, names: Sequence[str] | None) -> dict[str, Feature]:
    colour = camera_features(dataset.info)
    if names is None:
        return colour
    if isinstance(names, str):
        raise InvalidSetup(f"cameras is {names!r}; it must be a sequence of names, such as ({names!r},).")
    depth = {f"{name}/depth": feature for name, feature in camera_features(dataset.info, "depth").items()}
    known = {**colour, **depth}
    require_fields("camera of this dataset", names, known)
    return {name: known[name] for name in names}


def _scalers(cameras: Mapping[str, Feature], image_size: tuple[int, int] | None) -> dict[str, Scaler]:
    if image_size is None:
        return {}
    depth = [name for name, feature in cameras.items() if feature.encoding in ("depth", "labels")]
    if depth:
        raise InvalidSetup(f"{', '.join(depth)} cannot be scaled: depth cannot be averaged; leave image_size out.")
    width, height = whole_size(image_size, "image_size")
    return {name: Scaler((feature.shape[0], feature.shape[1]), (height, width)) for name, feature in cameras.items()}


def _joined(parts: list[NDArray[np.float64]], rows: NDArray[np.int64], size: int) -> NDArray[np.float64]:
    return np.stack(parts) if parts else np.empty((*rows.shape, size))
