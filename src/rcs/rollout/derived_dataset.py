"""Makes a dataset from another one in simulation, episode by episode: whole, or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord
from rcs_data.output import new_output

from rcs.agents import Agent
from rcs.envs.assemble import compose
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup
from rcs.rollout.episode import randomisation_of
from rcs.rollout.pool import WorkerPool
from rcs.rollout.replay import Step, play
from rcs.rollout.replay_scene import ReplayScene
from rcs.setups.make import resolve
from rcs.sim.state_transfer import StateTransfer

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
    scene: ReplayScene
    make: MakeEpisode


class EpisodeMaker:
    """Makes episodes in one process, which has an environment, the recorded dataset and the new one."""

    def __init__(self, recipe: Derivation, out: Path) -> None:
        """Open the recorded dataset, join the new one, and make the environment."""
        self.recipe = recipe
        self.scene = recipe.scene
        self.dataset = Dataset.open(recipe.source)
        self.writer = DatasetWriter.join(out)
        self.env, self._appearance = self.scene.make()
        self.recorder = Recorder(self.writer)
        self.env.add_observer(self.recorder)

    @cached_property
    def transfer(self) -> StateTransfer:
        """Transfers recorded simulation states to the scene of the environment."""
        source = compose(resolve(replace(self.scene.physics, assets="builtin"))).compile()
        return StateTransfer(source, self.env.simulation.world.model)

    def attempt(self, number: int) -> Any:
        """Make an episode, given its number in the dataset."""
        episode = self.dataset.episodes[number]
        if self._appearance is not None:
            self._appearance.episode_id = episode.id
        with self.recorder.discard_on_error():
            return self.recipe.make(self, episode)

    def play(self, episode: EpisodeRecord, agent: Agent, start: Mapping[str, Any], most: int) -> Iterator[Step]:
        """Run an agent from a given start, record that under the recorded episode's id, and yield every step.

        Args:
            episode: The recorded episode.
            agent: The agent.
            start: Options of the reset.
            most: Largest number of steps.
        """
        self.recorder.name_next(episode.id, instruction=episode.instruction)
        yield from play(self.env, agent, seed=episode.seed, options=start, most=most)

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

    def keep(self, episode: EpisodeRecord, last: Step, more: Mapping[str, Any]) -> None:
        """Keep the recording up to a last step; see `outcome`."""
        failure = None if last.success else "replay"
        self.recorder.finish(last.success, {"failure": failure, "reward": last.reward, **self.outcome(episode, more)})

    def close(self) -> None:
        """Close the environment and the writer."""
        self.env.close()
        self.writer.close()


def derive(recipe: Derivation, out: Path, info: DatasetInfo, workers: int) -> Iterator[Any]:
    """Make a dataset, and yield the result of each episode as it is done.

    Args:
        recipe: What to make.
        out: Folder of the new dataset; it must not exist.
        info: Info of the new dataset.
        workers: Number of processes; 1 for this one, 0 for one per core.

    Raises:
        InvalidSetup: The number of workers is not valid, or an episode cannot be made.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    if not isinstance(workers, int) or workers < 0:  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InvalidSetup(f"workers is {workers!r}; valid is 0 (one per core) and more.")
    numbers = range(len(Dataset.open(recipe.source)))
    processes = min(workers or os.cpu_count() or 1, max(len(numbers), 1))
    with new_output(out) as folder, DatasetWriter.open(folder, info):
        make = partial(EpisodeMaker, recipe, folder)
        if processes > 1:
            with WorkerPool(make, processes) as pool:
                yield from pool.map(iter(numbers))
            return
        worker = make()
        try:
            yield from map(worker.attempt, numbers)
        finally:
            worker.close()
