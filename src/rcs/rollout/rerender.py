"""Draws the frames of recorded episodes anew: other cameras, sizes, qualities and looks of the very same states."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcs.data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature
from rcs.data.flags import FrameFlag, flags_key, time_key
from rcs.envs import spaces as keys
from rcs.envs.assemble import compose
from rcs.envs.draws import Draws
from rcs.envs.env import Env
from rcs.envs.observers.recorder import OBSERVATION, TIME_MONOTONIC, versions
from rcs.envs.setup import Setup
from rcs.envs.sim_ports import SimCameraPort
from rcs.errors import InvalidSetup
from rcs.rollout.derive import SOURCE, derive, source_of
from rcs.rollout.look import Look, Stage, physics_of, require_states, setup_of, varied
from rcs.setups.make import resolve
from rcs.sim.state_transfer import StateTransfer

MODE = "render"


@dataclass(frozen=True, kw_only=True)
class Rerendering:
    """What to draw anew."""

    source: Path
    """Folder of the dataset."""
    out: Path
    """Folder of the new one."""
    look: Look = field(default_factory=Look)
    workers: int = 1
    """Processes; 0 for one per core."""


@dataclass(frozen=True, kw_only=True)
class RerenderResult:
    """One episode that was drawn anew."""

    episode_id: str
    rows: int


def rerender(rendering: Rerendering) -> Iterator[RerenderResult]:
    """Restore every recorded state bit for bit, without stepping, and draw frames of it into a new dataset.

    All that is not a frame, its calibration or its capture time stays as it is, simulation states included. Frames of
    tactile sensors stay too: what they felt is not in the states.

    Raises:
        InvalidSetup: The dataset is not from simulation, or the look makes no sense.
        DatasetError, CorruptEpisode: A dataset cannot be read or written.
    """
    dataset = Dataset.open(rendering.source)
    require_states(dataset)
    physics = physics_of(dataset)
    stage = Stage.of(physics, setup_of(dataset), rendering.look)
    env, _ = stage.env()
    try:
        info = _info(dataset.info, env, stage, physics)
    finally:
        env.close()
    make = functools.partial(_Rerenderer, rendering)
    return derive(rendering.out, info, make, range(len(dataset)), rendering.workers)


class _Rerenderer:
    """Draws episodes anew: the part that one process does."""

    def __init__(self, rendering: Rerendering, out: Path) -> None:
        self._dataset = Dataset.open(rendering.source)
        physics = physics_of(self._dataset)
        stage = Stage.of(physics, setup_of(self._dataset), rendering.look)
        self._writer = DatasetWriter.join(out)
        self._env, self._looks = stage.env()
        self._cameras = _cameras_of(self._env)
        self._was_varied = physics.randomisation is not None
        source = compose(resolve(replace(physics, assets="builtin"))).compile()
        self._transfer = StateTransfer(source, self._env.scenario.world.model)

    def attempt(self, number: int) -> RerenderResult:
        """Draw one episode anew."""
        episode = self._dataset.episodes[number]
        states = episode.sim_state()
        carried = self._transfer(states)
        outcome: dict[str, Any] = {**episode.outcome, SOURCE: source_of(episode, self._dataset.path, MODE)}
        outcome.update(self._vary(episode))
        world = self._env.scenario.world
        rows = RecordedRows(episode, self._writer.info)
        fresh = FreshFrames(self._cameras, self._writer.info)
        with self._writer.episode(episode.id, seed=episode.seed, instruction=episode.instruction) as made:
            for i, state in enumerate(carried):
                world.core.set_state(state)
                world.refresh()
                # Cameras count control steps to know when a frame is due. The first row always has one.
                world.core.steps[0] = round(float(world.time) * world.frequency) if i else 0
                made.add({**rows.at(i), **fresh.read(rows.capture_times(i))}, states[i])
            made.finish(episode.success, outcome)
        return RerenderResult(episode_id=episode.id, rows=len(states))

    def _vary(self, episode: EpisodeRecord) -> dict[str, Any]:
        """Have the model vary as it did in an episode, and its looks as they are to; return what was drawn."""
        if episode.seed is None and self._was_varied:
            raise InvalidSetup(f"Episode {episode.id!r} was randomised without a seed; how it looked is not known.")
        if self._looks is not None:
            self._looks.episode_id = episode.id
        self._env.scenario.begin(Draws(episode.seed or 0, 0))
        return varied(self._env)

    def close(self) -> None:
        """Close the environment and the writer."""
        self._env.close()
        self._writer.close()


class RecordedRows:
    """The rows of a recorded episode, one after the other, as far as another dataset has the same features."""

    def __init__(self, episode: EpisodeRecord, info: DatasetInfo) -> None:
        """Read what is kept; images stay encoded as they are.

        Args:
            episode: The episode.
            info: What the other dataset has; features with frames of its cameras are left out.
        """
        drawn = camera_names(info)
        recorded = {feature.key: feature for feature in episode.info.features}
        kept = [f for f in info.features if f.key in recorded and not is_of_camera(f.key, drawn)]
        self._columns = {f.key: _column(episode, f) for f in kept if not f.is_image}
        self._columns.update({f.key: _stored(episode, f) for f in kept if f.is_image})
        # A new frame is of the state of its row, so it was taken when the row was complete.
        ends = self._columns.get(TIME_MONOTONIC, [None] * episode.length)
        own = {name: time_key(name) for name in drawn}
        self._times = {name: _column(episode, recorded[key]) if key in recorded else ends for name, key in own.items()}

    def at(self, row: int) -> dict[str, Any]:
        """Return what a row has."""
        return {key: column[row] for key, column in self._columns.items()}

    def capture_times(self, row: int) -> dict[str, Any]:
        """Return when a new frame of each drawn camera would have been taken in a row [s]; None where it is unknown."""
        return {name: times[row] for name, times in self._times.items()}


class FreshFrames:
    """Frames of the present state as a recorder keeps them: one that is not new is not stored again."""

    def __init__(self, port: SimCameraPort | None, info: DatasetInfo) -> None:
        """Read from the cameras of an environment, from the start of an episode.

        Args:
            port: The cameras; None for none.
            info: What the dataset has.
        """
        self._port = port
        self._keys = {feature.key for feature in info.features}
        self._images = {feature.key for feature in info.features if feature.is_image}
        self._drawn: dict[str, float] = {}
        self._times: dict[str, Any] = {}

    def read(self, times: Mapping[str, Any]) -> dict[str, Any]:
        """Return the features of all cameras for one row.

        Args:
            times: When a new frame of each would have been taken [s]; None where that is not known.
        """
        if self._port is None:
            return {}
        frames = self._port.observe()[keys.FRAMES]
        drawn = {key.removeprefix(f"{keys.FRAMES}/"): time for key, time in self._port.capture_times().items()}
        row: dict[str, Any] = {}
        for camera, frame in frames.items():
            is_new = drawn[camera] != self._drawn.get(camera)
            if is_new:
                self._times[camera] = times[camera]
            row[time_key(camera)] = self._times[camera]
            row[flags_key(camera)] = 0 if is_new else int(FrameFlag.REPEATED)
            for name, value in frame.items():
                key = f"{OBSERVATION}/{keys.FRAMES}/{camera}/{name}"
                row[key] = np.ascontiguousarray(value) if is_new or key not in self._images else None
        self._drawn = drawn
        return {key: value for key, value in row.items() if key in self._keys}


def _column(episode: EpisodeRecord, feature: Feature) -> list[Any]:
    """Return a column's values by row, with None where there is none."""
    values = list(episode.column(feature.key))
    if feature.encoding != "plain":
        return values
    is_null = episode.steps([feature.key]).column(feature.key).is_null().to_numpy()
    return [None if null else value for value, null in zip(values, is_null, strict=True)]


def _stored(episode: EpisodeRecord, feature: Feature) -> list[bytes | None]:
    """Return images as they are stored, with None where there is no new one."""
    return episode.steps([feature.key]).column(feature.key).to_pylist()


def camera_names(info: DatasetInfo) -> list[str]:
    """Return the names of the cameras that a dataset has frames of; tactile sensors are none: they have no matrix."""
    suffix = f"/{keys.INTRINSICS}"
    prefix = f"{OBSERVATION}/{keys.FRAMES}/"
    found = [f.key for f in info.features if f.key.startswith(prefix) and f.key.endswith(suffix)]
    return [key.removeprefix(prefix).removesuffix(suffix) for key in found]


def is_of_camera(key: str, cameras: list[str]) -> bool:
    """Return whether a feature is a frame, a matrix, a capture time or a flag of one of these cameras."""
    return any(f"/{keys.FRAMES}/{name}/" in f"{key}/" for name in cameras)


def _info(recorded: DatasetInfo, env: Env, stage: Stage, physics: Setup) -> DatasetInfo:
    """Return the info of the new dataset: features in the order in which they would be recorded."""
    fresh = stage.info(env, recorded, physics)
    cameras = [*camera_names(recorded), *camera_names(fresh)]
    kept = {f.key: f for f in recorded.features if not is_of_camera(f.key, cameras)}
    features = [kept.pop(f.key, f) for f in fresh.features if f.key in kept or is_of_camera(f.key, cameras)]
    return replace(
        recorded,
        features=(*features, *kept.values()),
        setup=fresh.setup,
        jpeg_quality=fresh.jpeg_quality,
        versions={**recorded.versions, **versions()},
    )


def _cameras_of(env: Env) -> SimCameraPort | None:
    for port in env.stack.ports:
        if isinstance(port, SimCameraPort):
            return port
    return None
