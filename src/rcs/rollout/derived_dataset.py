"""Makes a dataset from another one in simulation, episode by episode: whole, or not at all.

Cameras have mass and housings that collide. The scene therefore keeps all recorded cameras, rendered or not.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord
from rcs_data.files.feature import Colour
from rcs_data.files.output import new_output
from rcs_data.options import require_whole

from rcs.envs.assemble import assemble, compose
from rcs.envs.env import Env
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.variation.randomiser import Randomiser
from rcs.rollout.episode import randomisation_of
from rcs.rollout.pool import WorkerPool
from rcs.rollout.recorded_setup import RECORDED, VISUAL
from rcs.setups.make import resolve
from rcs.sim.randomisation import Randomisation
from rcs.sim.state_transfer import StateTransfer
from rcs.sim.world import Copies

SOURCE = "source"
"""Key of an outcome: the episode that this one was made from."""

MakeEpisode = Callable[["EpisodeMaker", EpisodeRecord], Any]
"""Makes an episode from a recorded one and returns the result; it is pickled."""


@dataclass(frozen=True, kw_only=True)
class Derivation:
    """The recipe of a derived dataset, sent to each process."""

    kind: str
    """The kind of replay, stored in outcomes."""
    source: Path
    """Folder of the recorded dataset."""
    physics: Setup
    """The setup of the recorded states."""
    setup: Setup
    """The setup of the new frames."""
    looks_seed: int | None = None
    """Seed of the appearance of episodes; None for the recorded one."""
    make: MakeEpisode

    @property
    def whole(self) -> Setup:
        """The setup of the new frames, with all cameras of the scene."""
        cameras = self.setup.cameras
        names = tuple(dict.fromkeys((*self.physics.cameras, *cameras)))
        return replace(
            self.setup, cameras=replace(cameras, names=names, mounts={**self.physics.cameras.mounts, **cameras.mounts})
        )

    def open(self) -> tuple[Env, NewLooks | None]:
        """Make the environment, and the randomiser of its appearance; None if that is as recorded."""
        parts = resolve(self.whole)
        env = assemble(parts, drawn=self.setup.cameras.names)
        if self.looks_seed is None:
            return env, None
        looks = NewLooks(env, parts, self.looks_seed)
        env.simulation.randomisers.append(looks)
        return env, looks

    def info(self, env: Env, recorded: DatasetInfo, *, has_recorded_states: bool = False) -> DatasetInfo:
        """Return the info of the new dataset.

        Args:
            env: The environment.
            recorded: The info of the recorded dataset.
            has_recorded_states: Whether its states are the recorded ones, not new ones of this scene.
        """
        colours: list[Colour] = [feature.colour for feature in recorded.features if feature.colour is not None]
        colour: Colour = "lossless" if "lossless" in colours else (*colours, "jpeg")[0]
        info = dataset_info(env, colour=colour, jpeg_quality=recorded.jpeg_quality)
        setup, physics = self.setup.to_json(), self.physics if has_recorded_states else self.whole
        if physics != self.setup:
            setup[RECORDED] = physics.to_json()
        instruction = recorded.instruction or info.instruction
        return replace(info, setup=setup, instruction=instruction, jpeg_subsampling=recorded.jpeg_subsampling)


class NewLooks(Randomiser):
    """Draws the appearance of episodes from its own seed and the episodes' ids, whatever the seed of the reset."""

    def __init__(self, env: Env, parts: Parts, seed: int) -> None:
        """Take the nominal appearance of an environment that has not been reset yet."""
        ranges = parts.setup.randomisation or Randomisation.off()
        visual = Randomisation.off(**{name: getattr(ranges, name) for name in VISUAL})
        super().__init__(
            env.simulation.world, visual, objects=parts.task.objects(), robots=parts.robots, cameras=parts.cameras
        )
        self._seed = seed
        self.episode_id = ""
        """Id of the next episode."""

    def begin(self, draws: EpisodeRandom, copies: Copies = None) -> None:
        """Draw and write the appearance of an episode."""
        super().begin(EpisodeRandom(self._seed, zlib.crc32(self.episode_id.encode())), copies)


class EpisodeMaker:
    """Makes episodes in one process, which has an environment, the recorded dataset and the new one."""

    def __init__(self, recipe: Derivation, out: Path) -> None:
        """Open the recorded dataset, join the new one, and make the environment."""
        self.recipe = recipe
        self.dataset = Dataset.open(recipe.source)
        self.writer = DatasetWriter.join(out)
        self.env, self._looks = recipe.open()
        self.recorder = Recorder(self.writer)
        self.env.add_observer(self.recorder)

    @cached_property
    def transfer(self) -> StateTransfer:
        """Transfers recorded simulation states to the scene of the environment."""
        source = compose(resolve(replace(self.recipe.physics, assets="builtin"))).compile()
        return StateTransfer(source, self.env.simulation.world.model)

    def attempt(self, number: int) -> Any:
        """Make an episode, given its number in the dataset."""
        episode = self.dataset.episodes[number]
        if self._looks is not None:
            self._looks.episode_id = episode.id
        with self.recorder.discard_on_error():
            return self.recipe.make(self, episode)

    def outcome(self, episode: EpisodeRecord, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the outcome's entries about randomisation and source of an episode.

        Args:
            episode: The source.
            more: Further entries about it.
        """
        source = {
            "dataset": self.dataset.path.resolve().name,
            "episode": episode.id,
            "content_hash": episode.content_hash,
            "kind": self.recipe.kind,
            SOURCE: episode.outcome.get(SOURCE, episode.source),  # its own source
        }
        return {**randomisation_of(self.env), SOURCE: {**source, **(more or {})}}

    def close(self) -> None:
        """Close the environment and the writer."""
        self.env.close()
        self.writer.close()


def derive(recipe: Derivation, out: Path, info: DatasetInfo, workers: int) -> Iterator[Any]:
    """Make a dataset, and yield the result of each episode as it is done.

    Args:
        recipe: Recipe of the episodes to make.
        out: Folder of the new dataset; it must not exist.
        info: Info of the new dataset.
        workers: Number of processes; 1 for this one, 0 for one per core.

    Raises:
        InvalidSetup: The number of workers is not valid, or an episode cannot be made.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    require_whole("workers", workers)
    numbers = range(len(Dataset.open(recipe.source)))
    processes = min(workers or os.cpu_count() or 1, max(len(numbers), 1))
    with new_output(out) as folder, DatasetWriter.open(folder, info):
        make = partial(EpisodeMaker, recipe, folder)
        if processes > 1:
            with WorkerPool(make, processes) as pool:
                yield from pool.map(iter(numbers))
            return
        with closing(make()) as worker:
            yield from map(worker.attempt, numbers)
