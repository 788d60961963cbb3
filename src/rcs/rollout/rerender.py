"""Renders recorded states again: with other cameras, sizes, qualities and looks."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data import Dataset, DatasetInfo, EpisodeRecord, Feature
from rcs_data.files.flags import FrameFlag, flags_key, time_key

from rcs.envs import spaces as keys
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.observers.dataset_info import OBSERVATION, TIME_MONOTONIC, versions
from rcs.envs.ports.simulated import SimCameraPort
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.derived_dataset import Derivation, EpisodeMaker, derive
from rcs.rollout.recorded_setup import physics_of, require_states, seen_as, setup_of

FRAMES = f"{OBSERVATION}/{keys.FRAMES}/"


@dataclass(frozen=True, kw_only=True)
class RerenderResult:
    """The result of one rendered episode."""

    episode_id: str
    rows: int

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return {"episode": self.episode_id, "rows": self.rows}


def rerender(
    source: str | Path,
    out: str | Path,
    *,
    setup: Setup | None = None,
    looks_seed: int | None = None,
    workers: int = 1,
    trust: Collection[str] = (),
) -> Iterator[RerenderResult]:
    """Restore every recorded state bit for bit, without stepping, and render it into a new dataset.

    Everything but frames, their calibration and their capture times is copied, including simulation states. So are
    frames of tactile sensors, since the states do not determine them.

    Args:
        source: Folder of the recorded dataset.
        out: Folder of the new dataset; it must not exist.
        setup: The setup of the new frames, see `seen_as`; None for the recorded one.
        looks_seed: Seed of the appearance of episodes; None for the recorded one. Different seeds make variants of a
            dataset.
        workers: Number of processes; 1 for this one, 0 for one per core.
        trust: Modules that may be imported because the dataset's setup names them.

    Raises:
        InvalidSetup: The dataset has no simulation states, or an option is not valid.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    dataset = Dataset.open(source)
    require_states(dataset)
    physics, frames = physics_of(dataset, trust=trust), setup_of(dataset, trust=trust)
    setup = seen_as(frames, setup, looks_seed)
    recipe = Derivation(
        kind="render", source=Path(source), physics=physics, setup=setup, looks_seed=looks_seed, make=_render
    )
    with closing(recipe.open()[0]) as env:
        fresh = recipe.info(env, dataset.info, has_recorded_states=True)
    yield from derive(recipe, Path(out), _info(dataset.info, fresh), workers)


def _info(recorded: DatasetInfo, fresh: DatasetInfo) -> DatasetInfo:
    """Return the info of the new dataset, with features in the order of a recording."""
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


def _render(maker: EpisodeMaker, episode: EpisodeRecord) -> RerenderResult:
    """Render one episode: in each row, the cameras that have a frame due."""
    simulation, info = maker.env.simulation, maker.writer.info
    world = simulation.world
    if episode.seed is None and maker.recipe.physics.randomisation is not None:
        raise InvalidSetup(f"Episode {episode.id!r} was randomised without a seed, so its appearance is unknown.")
    states = episode.sim_state()
    simulation.begin(EpisodeRandom(episode.seed or 0, 0))
    port = next((port for port in maker.env.stack.ports if isinstance(port, SimCameraPort)), None)
    rows, fresh = _recorded_rows(episode, info), _FreshFrames(port, info)
    with maker.writer.episode(episode.id, seed=episode.seed, instruction=episode.instruction) as made:
        for i, (state, (row, times)) in enumerate(zip(maker.transfer(states), rows, strict=True)):
            world.core.set_state(state)
            world.refresh()
            if simulation.frame_clock is not None:  # the first row always has a frame
                simulation.frame_clock.steps = np.array([round(float(world.time) * world.frequency) if i else 0])
            made.add({**row, **fresh.read(times)}, states[i])
        made.finish(episode.success, {**episode.outcome, **maker.outcome(episode)})
    return RerenderResult(episode_id=episode.id, rows=len(states))


def _recorded_rows(episode: EpisodeRecord, info: DatasetInfo) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Return each row of an episode, and the capture times of new frames in it by camera [s], None where unknown.

    Rows are reduced to the features of another dataset, less the frames of rendered cameras; images stay encoded.
    """
    drawn = camera_names(info)
    recorded = {feature.key: feature for feature in episode.info.features}
    kept = [f for f in info.features if f.key in recorded and not is_of_camera(f.key, drawn)]
    columns = {f.key: _column(episode, f) for f in kept}
    # A new frame shows its row's state, so its capture time is that of the row.
    ends = columns.get(TIME_MONOTONIC, [None] * episode.length)
    own = {name: time_key(name) for name in drawn}
    times = {name: _column(episode, recorded[key]) if key in recorded else ends for name, key in own.items()}
    return (
        ({key: column[i] for key, column in columns.items()}, {name: column[i] for name, column in times.items()})
        for i in range(episode.length)
    )


class _FreshFrames:
    """Frames of the present state in the form of a recorder, which stores only new ones."""

    def __init__(self, port: SimCameraPort | None, info: DatasetInfo) -> None:
        """Read from the cameras of an environment, if it has any, from the start of an episode."""
        self._port = port
        self._images = {feature.key: feature.is_image for feature in info.features}
        self._captured: dict[str, float] = {}
        self._times: dict[str, Any] = {}

    def read(self, times: Mapping[str, Any]) -> dict[str, Any]:
        """Return the features of all cameras for one row.

        Args:
            times: Capture time of a new frame of each [s]; None if unknown.
        """
        if self._port is None:
            return {}
        frames = self._port.observe()[keys.FRAMES]
        captured = {key.removeprefix(f"{keys.FRAMES}/"): time for key, time in self._port.capture_times().items()}
        row: dict[str, Any] = {}
        for camera, frame in frames.items():
            is_new = captured[camera] != self._captured.get(camera)
            if is_new:
                self._times[camera] = times[camera]
            row[time_key(camera)] = self._times[camera]
            row[flags_key(camera)] = 0 if is_new else int(FrameFlag.REPEATED)
            for name, value in frame.items():
                key = f"{FRAMES}{camera}/{name}"
                row[key] = np.ascontiguousarray(value) if is_new or not self._images.get(key) else None
        self._captured = captured
        return {key: value for key, value in row.items() if key in self._images}


def _column(episode: EpisodeRecord, feature: Feature) -> list[Any]:
    """Return a column by row, images as stored, with None for no new value."""
    if feature.is_image:
        return [image for rows in episode.rows() for image in rows.column(feature.key).to_pylist()]
    if feature.encoding != "plain":
        return list(episode.column(feature.key))
    stored = episode.steps([feature.key]).column(feature.key)
    is_null = stored.is_null().to_numpy()
    return [None if null else value for value, null in zip(episode.column(feature.key), is_null, strict=True)]


def camera_names(info: DatasetInfo) -> list[str]:
    """Return the cameras of a dataset; tactile sensors, which have no camera matrix, do not count."""
    matrices = [f.key for f in info.features if f.key.startswith(FRAMES) and f.key.endswith(f"/{keys.INTRINSICS}")]
    return [key.removeprefix(FRAMES).removesuffix(f"/{keys.INTRINSICS}") for key in matrices]


def is_of_camera(key: str, cameras: list[str]) -> bool:
    """Return whether a feature is a frame, a matrix, a capture time or a flag of one of these cameras."""
    return any(f"/{keys.FRAMES}/{name}/" in f"{key}/" for name in cameras)
