"""Records every step of an environment into a dataset."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from rcs_data import DatasetInfo, DatasetWriter, Encoding, EpisodeRecord, EpisodeWriter, Feature
from rcs_data.background import BackgroundEpisode
from rcs_data.feature import Colour
from rcs_data.flags import FrameFlag, camera_of, flags_key

from rcs.envs import spaces as keys
from rcs.envs.env import Env
from rcs.envs.observer import Observer, Transition
from rcs.envs.observers.joint_limits import with_limits
from rcs.envs.setup import Setup
from rcs.envs.vector import VecEnv
from rcs.errors import DeviceFault, InvalidSetup, WrongOrder

OBSERVATION, ACTION, EXECUTED, NOTES = "observation", "action", "executed", "notes"
TIME_MONOTONIC, TIME_PERIOD = "time/monotonic", "time/period"
SIMULATED_TIME = "simulated_time"
OBJECTS = "objects"
"""Key of an outcome: where the task's objects were at the start, by name, translation [m] and quaternion xyzw in the
base frame (of several robots: in the scene). Real recordings that have it can be replayed in simulation."""

END, REASONS = "end", "reasons"
"""Keys of the outcome of an episode that was broken off: `fault`, `exception` or `closed`; the faults by device, or the
error's message by its class."""

_FRAMES = f"{keys.FRAMES}/"


def dataset_info(
    env: Env | VecEnv,
    *,
    instruction: str | None = None,
    colour: Colour = "jpeg",
    jpeg_quality: int = 95,
    notes: Sequence[str] = (),
) -> DatasetInfo:
    """Return the info of a dataset of an environment's episodes.

    Args:
        env: The environment, or a batch of copies of one.
        instruction: What the robot is asked to do; None for the environment's instruction.
        colour: Encoding of colour frames; docs/data.md compares sizes and quality. Videos are made when an episode is
            finished.
        jpeg_quality: JPEG quality of colour frames, 1 to 100.
        notes: Names of numbers that `env.note` may give beside a step, recorded as `notes/name`; NaN where it did not.

    Raises:
        InvalidSetup: Steps of the environment have no fixed rate.
    """
    setup = env.setup if isinstance(env, VecEnv) or env.has_setup else None
    if setup is not None:
        require_recordable(setup)
    features = _features(OBSERVATION, env.stack.observation_space.spaces, colour)
    features = with_limits(features, None if setup is None else setup.robot)
    features += _features(ACTION, env.stack.action_space.spaces, colour)
    features += _features(EXECUTED, env.stack.executed_spaces, colour)
    features += [
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="truncated", shape=(), dtype="bool"),
        Feature(key=TIME_MONOTONIC, shape=(), dtype="float64", unit="s"),
        Feature(key=TIME_PERIOD, shape=(), dtype="float64", unit="s"),
    ]
    simulated = env.simulation if isinstance(env, VecEnv) or env.is_simulated else None
    if simulated is not None:
        features.append(Feature(key=SIMULATED_TIME, shape=(), dtype="float64", unit="s"))
    features += [Feature(key=f"time/{key}", shape=(), dtype="float64", unit="s") for key in env.stack.timed]
    sensors = [name for key in env.stack.timed if (name := _camera(key)) is not None]
    features += [Feature(key=flags_key(name), shape=(), dtype="uint8") for name in sensors]
    features += [Feature(key=f"{NOTES}/{name}", shape=(), dtype="float64") for name in notes]
    return DatasetInfo(
        frequency=env.frequency,
        features=tuple(features),
        setup={} if setup is None else setup.to_json(),
        instruction=env.instruction if instruction is None else instruction,
        jpeg_quality=jpeg_quality,
        sim_state_size=None if simulated is None else simulated.world.core.state_size,
        versions=versions(),
        origin={"platform": dict(env.platform), **env.stack.about},
    )


def versions() -> dict[str, str]:
    """Return the versions of the software that makes the data."""
    packages = ("robot-control-stack", "rcs-data", "mujoco-core", "numpy", "gymnasium", "pyarrow", "simplejpeg")
    return {"python": platform.python_version(), **{name: importlib.metadata.version(name) for name in packages}}


def _camera(key: str) -> str | None:
    """Return the camera of a capture time; None for that of another device."""
    return key.removeprefix(_FRAMES) if key.startswith(_FRAMES) else None


def _features(prefix: str, entries: Mapping[str, spaces.Space[Any]], colour: Colour) -> list[Feature]:
    """Return a feature per array, with `/` between the levels of nested spaces."""
    features: list[Feature] = []
    for key, space in entries.items():
        if _is_derived(prefix, key):
            continue
        if isinstance(space, spaces.Dict):
            features += _features(f"{prefix}/{key}", space.spaces, colour)
            continue
        assert isinstance(space, spaces.Box)
        # A camera on a table has the same matrices in every row, one on a wrist has not.
        encodings: dict[str, Encoding] = {
            keys.RGB: colour, keys.DEPTH: "depth", keys.SEGMENTATION: "labels", keys.GEOMS: "labels",
            keys.INTRINSICS: "held", keys.DISTORTION: "held", keys.EXTRINSICS: "held",
        }  # fmt: skip
        encoding = encodings.get(key, "plain")
        unit = keys.UNITS.get(key, "")
        features.append(
            Feature(key=f"{prefix}/{key}", shape=space.shape, dtype=str(space.dtype), unit=unit, encoding=encoding)
        )
    return features


class Recorder(Observer):
    """Writes the episodes of one environment. An episode is kept by `finish` and dropped by `discard`.

    A new reset discards an open episode, which is then repeated. An episode that was broken off, by a fault or an
    error, is different: its outcome says `end` and `reasons`, and unless it is discarded on purpose it is kept, by the
    next reset or by `close`, without a verdict. `close` keeps an episode that is still open in the same way. A frame
    with the capture time of the row before is stored once and flagged as repeated.
    """

    def __init__(
        self,
        writer: DatasetWriter,
        *,
        names: Iterator[str] | None = None,
        background: bool = False,
        stale_after: float | None = None,
        abort_after: float | None = None,
    ) -> None:
        """Record into a dataset.

        Args:
            writer: The dataset; it stays open when the recorder is closed.
            names: Ids for episodes to be recorded unasked: each from reset to end, with the success that the task
                tells. None for episodes that `name_next` asks for.
            background: Whether a thread encodes and writes, so that a loop that must keep its rate never waits. Then a
                writer that is too slow leaves out images, flagged and counted; otherwise the loop waits for it.
            stale_after: Age [s] of a frame, from capture to the end of the step, from which it is flagged as stale;
                None for never, as simulated frames are as old as their drawing takes.
            abort_after: Age [s] of a frame from which the episode is given up: its rows are kept for `recover`, and the
                step raises. None for never.
        """
        self._names = names
        self._broken_off: dict[str, Any] = {}
        self._objects: dict[str, Any] = {}
        self._writer = writer
        self._is_background = background
        self._stale_after = stale_after
        self._abort_after = abort_after
        self._episode: EpisodeWriter | BackgroundEpisode | None = None
        self._next: tuple[str, str | None] | None = None
        self._starts_at_reset = True
        self._last_time = 0.0
        self._last_captures: dict[str, float] = {}
        self._dtypes = {feature.key: feature.numpy_dtype for feature in writer.info.features}
        self._notes = [key.removeprefix(f"{NOTES}/") for key in self._dtypes if key.startswith(f"{NOTES}/")]
        self._images: dict[str, list[str]] = {}
        for feature in writer.info.features:
            camera = camera_of(feature.key)
            if feature.is_image and camera is not None:
                self._images.setdefault(camera, []).append(feature.key)

    @property
    def is_recording(self) -> bool:
        """Whether an episode is open."""
        return self._episode is not None

    @property
    def rows(self) -> int:
        """Rows of the open episode; 0 if none is open."""
        return 0 if self._episode is None else self._episode.rows

    def name_next(self, episode_id: str, *, instruction: str | None = None, at_reset: bool = True) -> None:
        """Set the id of the next episode; without one, episodes are not recorded.

        Args:
            episode_id: The name of its folder.
            instruction: What the robot is asked to do; None for the dataset's instruction.
            at_reset: Whether it begins with the next reset, or already with the next step.
        """
        self._next = (episode_id, instruction)
        self._starts_at_reset = at_reset

    def forget_next(self) -> None:
        """Take back what `name_next` set."""
        self._next = None

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Begin an episode with its first observation."""
        self._let_go()
        if self._names is not None:
            self._next = (next(self._names), None)
        if self._next is not None:
            self._begin(first, seed)

    def on_step(self, transition: Transition) -> None:
        """Record a step.

        Raises:
            DeviceFault: A camera has given nothing new for `abort_after`; the episode is aborted.
            InvalidSetup: A value is not what the dataset has; the row is not recorded, and the episode stays open.
            DatasetError: The disk is full or fails; the episode is aborted.
        """
        if self._broken_off and self._episode is not None:
            return  # a state was set; what follows is not what came of the rows so far
        if self._episode is None:
            if self._next is not None and not self._starts_at_reset:
                # What was seen after this step is where the episode starts; what led there is not part of it.
                self._begin(replace(transition, action=None, executed=None), None)
            return
        period = transition.time - self._last_time
        self._last_time = transition.time
        self._add(transition, period)
        if self._names is not None and (transition.terminated or transition.truncated):
            success = transition.info.get("success")
            self.finish(None if success is None else bool(success))

    def _begin(self, first: Transition, seed: int | None) -> None:
        assert self._next is not None
        name, instruction = self._next
        episode = self._writer.episode(name, seed=seed, instruction=instruction)
        self._episode = BackgroundEpisode(episode, self._writer.info) if self._is_background else episode
        self._next = None
        # A dataset that is closed first ends the episode as the recorder does.
        episode.end = lambda _: self.close()
        self._broken_off = {}
        poses = {name: pose.tolist() for name, pose in first.objects.items()}
        self._objects = {OBJECTS: poses} if poses else {}
        self._last_time = first.time
        self._last_captures = {}
        self._add(first, period=None)

    def _add(self, transition: Transition, period: float | None) -> None:
        assert self._episode is not None
        row: dict[str, Any] = {
            "terminated": transition.terminated,
            "truncated": transition.truncated,
            TIME_MONOTONIC: transition.time,
            TIME_PERIOD: period,
        }
        if transition.sim_state is not None:
            row[SIMULATED_TIME] = transition.info["time"]
        row.update(_flat(OBSERVATION, transition.observation))
        if transition.action is not None and transition.executed is not None:
            # An action may come in another number type; it is kept in that of its space.
            given = _flat(ACTION, transition.action)
            row.update({key: np.asarray(value, self._dtypes[key]) for key, value in given.items()})
            row.update(_flat(EXECUTED, transition.executed))
            row["reward"] = transition.reward
        for name in self._notes:
            row[f"{NOTES}/{name}"] = float(transition.notes.get(name, np.nan))
        captures: dict[str, float] = {}
        for key, captured in transition.capture_times.items():
            row[f"time/{key}"] = captured
            if (camera := _camera(key)) is not None:
                captures[camera] = captured
                row[flags_key(camera)] = flags = self._flags(camera, captured, transition.time)
                if flags & FrameFlag.REPEATED:
                    row.update(dict.fromkeys(self._images.get(camera, ())))
        self._last_captures = captures
        self._episode.add(row, transition.sim_state)
        self._abort_if_late(transition)

    def _abort_if_late(self, transition: Transition) -> None:
        for camera, captured in self._last_captures.items():
            age = transition.time - captured
            if self._episode is not None and self._abort_after is not None and age > self._abort_after:
                reason = f"Camera {camera!r} has given nothing new for {age:.2f} s."
                self._episode.abort(reason)
                self._episode = None
                raise DeviceFault(f"{reason} The episode is aborted; `rcs data recover` keeps its rows.")

    def _flags(self, camera: str, captured: float, now: float) -> int:
        flags = FrameFlag(0)
        if captured == self._last_captures.get(camera):
            flags |= FrameFlag.REPEATED
        if self._stale_after is not None and now - captured > self._stale_after:
            flags |= FrameFlag.STALE
        return int(flags)

    def finish(
        self, success: bool | None, outcome: Mapping[str, Any] | None = None, *, instruction: str | None = None
    ) -> EpisodeRecord:
        """Keep the open episode.

        Args:
            success: Whether the task was done; None if that is not known.
            outcome: What else is to be kept of how it went, as JSON values; where the objects were at the start is
                added as `objects`.
            instruction: What the robot was asked to do; None for what was said at the start.

        Raises:
            WrongOrder: No episode is open.
        """
        if self._episode is None:
            raise WrongOrder("There is no open episode to finish; reset the environment first.")
        told = {**self._objects, **self._broken_off, **(outcome or {})}
        record = self._episode.finish(success, told, instruction=instruction)
        self._episode = None
        return record

    @contextmanager
    def discard_on_error(self) -> Generator[None]:
        """Drop the open episode when the block raises: for programs that can make the same episode again."""
        try:
            yield
        except BaseException:
            self._broken_off = {}
            self._let_go()
            raise

    def discard(self) -> None:
        """Drop the open episode with all its rows, if there is one."""
        if self._episode is not None:
            episode, self._episode = self._episode, None
            episode.discard()

    def on_end(self, end: str, reasons: Mapping[str, str]) -> None:
        """Store in the open episode why it was aborted; it takes no more rows."""
        if self._episode is not None:
            self._broken_off = {END: end, REASONS: dict(reasons)}

    def close(self) -> None:
        """Keep what is open, without a verdict; `outcome["end"]` says why it ended."""
        if self._episode is not None and not self._broken_off:
            self._broken_off = {END: "closed"}
        self._let_go()

    def _let_go(self) -> None:
        """Keep the open episode if it was broken off, and drop it otherwise.

        The rows of one that a failing disk has aborted stay for `recover`; one whose `finish` was interrupted may be
        finished all the same.
        """
        if self._episode is not None and self._episode.state in ("aborted", "finished"):
            self._episode = None
        if self._episode is not None and self._broken_off and self._episode.rows:
            self.finish(None)
        self.discard()


def _is_derived(prefix: str, key: str) -> bool:
    """Return whether a value is left out: points follow from depth and matrices, and are several times as large."""
    return key == keys.POINTS and prefix.startswith(f"{OBSERVATION}/{_FRAMES}")


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    flat: dict[str, NDArray[Any]] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat.update(_flat(f"{prefix}/{key}", value))
        elif not _is_derived(prefix, key):
            flat[f"{prefix}/{key}"] = value
    return flat


def require_recordable(setup: Setup) -> None:
    """Check that a setup can be recorded.

    Raises:
        InvalidSetup: Its control mode has no fixed rate.
    """
    if setup.stepping == "sync":
        raise InvalidSetup(
            "A dataset has a fixed rate; synchronous steps have none. Use stepping='async' or 'realtime'."
        )
