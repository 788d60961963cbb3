"""Records every step of an environment into a dataset."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.data import DatasetInfo, DatasetWriter, EpisodeRecord, EpisodeWriter, Feature
from rcs.envs import spaces as keys
from rcs.envs.env import Env
from rcs.envs.observers.observer import Observer, Transition
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, WrongOrder

OBSERVATION, ACTION, EXECUTED = "observation", "action", "executed"
TIME_MONOTONIC, TIME_PERIOD = "time/monotonic", "time/period"
SIMULATED_TIME = "simulated_time"


def dataset_info(env: Env, setup: Setup, *, jpeg_quality: int = 95) -> DatasetInfo:
    """Return what a dataset of an environment's episodes has in common.

    Args:
        env: The environment.
        setup: Its setup.
        jpeg_quality: Of colour frames, 1 to 100.
    """
    observation_space = env.observation_space
    assert isinstance(observation_space, spaces.Dict)
    features = [*_features(OBSERVATION, observation_space.spaces)]
    features += _features(ACTION, env.stack.action_space.spaces)
    features += _features(EXECUTED, env.stack.executed_spaces)
    features += [
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="truncated", shape=(), dtype="bool"),
        Feature(key=SIMULATED_TIME, shape=(), dtype="float64", unit="s"),
        Feature(key=TIME_MONOTONIC, shape=(), dtype="float64", unit="s"),
        Feature(key=TIME_PERIOD, shape=(), dtype="float64", unit="s"),
    ]
    features += [
        Feature(key=f"time/{keys.FRAMES}/{name}", shape=(), dtype="float64", unit="s") for name in _sensors(env)
    ]
    return DatasetInfo(
        fps=setup.frequency,
        features=tuple(features),
        setup=setup.to_json(),
        instruction=env.scenario.task.instruction,
        jpeg_quality=jpeg_quality,
        sim_state_size=env.scenario.world.core.state_size,
        versions=versions(),
    )


def versions() -> dict[str, str]:
    """Return the versions of what makes the data."""
    packages = ("robot-control-stack", "mujoco-core", "numpy", "gymnasium", "pyarrow", "simplejpeg")
    return {"python": platform.python_version(), **{name: importlib.metadata.version(name) for name in packages}}


def _sensors(env: Env) -> list[str]:
    """Return the names of all cameras and tactile sensors."""
    frames = env.stack.observation_space.spaces.get(keys.FRAMES)
    return list(frames.spaces) if isinstance(frames, spaces.Dict) else []


def _features(prefix: str, entries: Mapping[str, spaces.Space[Any]]) -> list[Feature]:
    """Return a feature per array, with `/` between the levels of nested spaces."""
    features: list[Feature] = []
    for key, space in entries.items():
        if isinstance(space, spaces.Dict):
            features += _features(f"{prefix}/{key}", space.spaces)
            continue
        assert isinstance(space, spaces.Box)
        encoding = "jpeg" if key == keys.RGB else "depth" if key == keys.DEPTH else "plain"
        unit = keys.UNITS.get(key, "")
        features.append(
            Feature(key=f"{prefix}/{key}", shape=space.shape, dtype=str(space.dtype), unit=unit, encoding=encoding)
        )
    return features


class Recorder(Observer):
    """Writes the episodes of one environment. An episode is kept by `finish` and dropped by `discard`.

    A new reset while an episode is open discards it: what was not kept on purpose is not kept.
    """

    def __init__(self, env: Env, writer: DatasetWriter) -> None:
        """Record into a dataset.

        Args:
            env: The environment, for its simulation state.
            writer: The dataset; it stays open when the recorder is closed.
        """
        self._world = env.scenario.world
        self._writer = writer
        self._episode: EpisodeWriter | None = None
        self._next_id: str | None = None
        self._last_time = 0.0
        self._dtypes = {feature.key: feature.numpy_dtype for feature in writer.info.features}

    def name_next(self, episode_id: str) -> None:
        """Set the id of the next episode; without one, episodes are not recorded."""
        self._next_id = episode_id

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Begin an episode with its first observation."""
        self.discard()
        if self._next_id is None:
            return
        self._episode = self._writer.episode(self._next_id, seed=seed)
        self._next_id = None
        self._last_time = first.time
        self._add(first, period=None)

    def on_step(self, transition: Transition) -> None:
        """Record a step."""
        if self._episode is None:
            return
        period = transition.time - self._last_time
        self._last_time = transition.time
        self._add(transition, period)

    def _add(self, transition: Transition, period: float | None) -> None:
        assert self._episode is not None
        row: dict[str, Any] = {
            "terminated": transition.terminated,
            "truncated": transition.truncated,
            SIMULATED_TIME: float(self._world.time),
            TIME_MONOTONIC: transition.time,
            TIME_PERIOD: period,
        }
        row.update(_flat(OBSERVATION, transition.observation))
        if transition.action is not None and transition.executed is not None:
            # An action may come in another number type; it is kept in that of its space.
            given = _flat(ACTION, transition.action)
            row.update({key: np.asarray(value, self._dtypes[key]) for key, value in given.items()})
            row.update(_flat(EXECUTED, transition.executed))
            row["reward"] = transition.reward
        row.update({f"time/{key}": time for key, time in transition.capture_times.items()})
        self._episode.add(row, self._world.states())

    def finish(self, success: bool | None, outcome: Mapping[str, Any] | None = None) -> EpisodeRecord:
        """Keep the open episode.

        Args:
            success: Whether the task was done; None if that is not known.
            outcome: What else is to be kept of how it went, as JSON values.

        Raises:
            WrongOrder: No episode is open.
        """
        if self._episode is None:
            raise WrongOrder("There is no open episode to finish; reset the environment first.")
        record = self._episode.finish(success, outcome)
        self._episode = None
        return record

    def discard(self) -> None:
        """Drop the open episode, if there is one."""
        if self._episode is not None:
            self._episode.discard()
            self._episode = None

    def close(self) -> None:
        """Drop what is open."""
        self.discard()


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    flat: dict[str, NDArray[Any]] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat.update(_flat(f"{prefix}/{key}", value))
        else:
            flat[f"{prefix}/{key}"] = value
    return flat


def require_recordable(setup: Setup) -> None:
    """Check that a setup can be recorded.

    Raises:
        InvalidSetup: Its control mode has no fixed rate.
    """
    if setup.mode == "sync":
        raise InvalidSetup("A dataset has a fixed rate; synchronous steps have none. Use mode='async' or 'realtime'.")
