"""Collects a dataset of scripted episodes, in one process, several, on the machines of a cluster, or on real robots.

Episode i depends only on the seed of the collection and on i, so the number of workers, where they are, interruption
and resumption do not change the data. On real robots, it is where the objects lie that depends on them. Where the robot
itself places the objects (`placed_by`), an episode begins where the one before has ended, up to millimetres.
"""

from __future__ import annotations

import re
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rcs_data import Dataset, DatasetInfo, DatasetWriter
from rcs_data.files.durable import sync_folder
from rcs_data.files.layout import EPISODES_FOLDER

from rcs.agents import agent_for
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.record import recorder_of
from rcs.envs.step.judge import FAULT
from rcs.envs.step.stack import for_all
from rcs.errors import RcsError
from rcs.rollout.collection import Attempt, Collection, Progress, episode_id
from rcs.rollout.episode import randomisation_of, run_episode
from rcs.rollout.placing import PLACED, PlacesInSimulation, is_placed_by_robot
from rcs.rollout.pool import WorkerPool
from rcs.rollout.ray_pool import RayPool
from rcs.rollout.real_episodes import RealEpisodes, has_real_arms
from rcs.rollout.supervisor import Supervisor, supervisor_of
from rcs.setups.make import make

# The id of an attempt, made by `episode_id`.
_ATTEMPT = re.compile(r"\d{6,}")
# Lies in the folder of a dataset while several workers collect successes. If they are killed, attempts before the last
# one that is kept may never have ended, and must be made before the collection is complete.
_UNORDERED = ".unordered"


class Collector:
    """Makes attempts and keeps episodes: one process of a collection."""

    def __init__(
        self,
        collection: Collection,
        writer: DatasetWriter,
        env: Env | None = None,
        supervisor: Supervisor | None = None,
    ) -> None:
        """Make the environment and the expert; with real arms, there is a supervisor."""
        self._collection = collection
        self._env = env or make(collection.setup)
        self._writer = writer
        self._recorder = recorder_of(self._env, writer)
        self._env.add_observer(self._recorder)
        self._agent = agent_for(self._env, collection.agent)
        speed = collection.home_speed
        self._real = None if supervisor is None else RealEpisodes(self._env, self._agent, supervisor, speed=speed)
        is_carried = self._real is None and is_placed_by_robot(collection.setup)
        self._places = PlacesInSimulation(self._env) if is_carried else None

    def prepare(self, number: int) -> None:
        """Get real arms ready for an attempt, and remove what a fault has left of it.

        Raises:
            DeviceFault: The attempt ended as a fault that is not to be cleared; what was recorded until then is kept,
                without a verdict.
        """
        if self._real is None:
            return
        self._real.prepare(self._collection.seed_of(number))
        if episode_id(number) in Dataset.open(self._writer.path):
            self._writer.remove_episode(episode_id(number))

    def attempt(self, number: int) -> Attempt | None:
        """Make one attempt, and keep it if the collection wants it.

        Returns:
            The attempt; None if a fault of real devices has ended it, which does not count.
        """
        self._recorder.name_next(episode_id(number))
        with self._recorder.discard_on_error():
            attempt = self._attempt(number)
        is_fault = attempt.result.success is None and attempt.result.failure == FAULT  # not a judge's tag
        return None if self._real is not None and is_fault else attempt

    def _attempt(self, number: int) -> Attempt:
        seed = self._collection.seed_of(number)
        if self._real is not None:
            result, more = self._real.run(seed), self._real.outcome
        elif self._places is not None:
            options, placed = self._places.next(seed)
            result = run_episode(self._env, self._agent, seed=seed, options=options)
            self._places.is_held = result.success is True
            more = {**randomisation_of(self._env), PLACED: placed}
        else:
            result = run_episode(self._env, self._agent, seed=seed)
            more = randomisation_of(self._env)
        is_lost = self._agent.is_lost
        if not is_lost and (result.success or not self._collection.only_success):
            self._recorder.finish(result.success, {"attempt": number, **result.outcome(), **more})
        else:
            self._recorder.discard()
        return Attempt(number=number, result=result, is_lost=is_lost)

    def close(self) -> None:
        """Close agent and environment."""
        more = [one.close for one in (self._real, self._places) if one is not None]
        for_all([self._agent.close, *more, self._env.close])


def collect(
    collection: Collection, progress: Progress, env: Env | None = None, supervisor: Supervisor | None = None
) -> Iterator[Attempt]:
    """Collect until the dataset is complete, yielding every attempt as it ends.

    Attempts that an earlier collection left unfinished, recovered or not, are made again from the start. Closing the
    iterator, or setting `progress.is_interrupted`, ends the collection after the running episodes; the dataset stays
    resumable. On a cluster, closing the iterator drops the running episodes.

    Args:
        collection: The recipe.
        progress: Updated while it runs.
        env: An environment of the collection's setup to use in this process; None for a new one. It is closed at the
            end.
        supervisor: Supervisor of real arms; None for the world of the virtual robot at their address, or the user at
            the terminal.

    Raises:
        DeviceFault: A real device failed, or a gate ended an episode on one, and the supervisor did not agree to go on.
            The episode has no verdict, and is made again when the collection is resumed.
        Refused: The supervisor does not agree that real arms go home.
        DatasetError: The dataset cannot be written, is locked, or belongs to another setup.
        InvalidSetup: The setup is not valid.
        RcsError: Too many attempts were no success, a worker process died, the policy was lost, or the cluster cannot
            be reached.
    """
    env = env or make(collection.setup, hardware=collection.hardware)
    try:
        if not has_real_arms(env):
            supervisor = None
        elif supervisor is None:
            supervisor = supervisor_of(collection.setup, collection.hardware)
        with closing(agent_for(env, collection.agent)) as agent:
            notes = agent.note_fields
        info = dataset_info(env, colour=collection.colour, jpeg_quality=collection.jpeg_quality, notes=notes)
        # Two collections are the same only if they number and seed episodes alike.
        actor = None if collection.agent is None else lookup.name_of("agent", collection.agent)
        made = {"seed": collection.seed, "only_success": collection.only_success, "agent": actor}
        info = replace(info, origin={**info.origin, "collection": made})
        with DatasetWriter.open(collection.out, info, resume=True, leftovers="discard") as writer:
            progress.again = _remove_fragments(writer)
            taken = {episode.id for episode in Dataset.open(collection.out)}
            progress.kept = progress.found = len(taken)
            start = time.perf_counter()
            is_here = collection.workers == 1 and collection.ray is None
            unordered = collection.out / _UNORDERED
            later = [int(name) for name in taken if _ATTEMPT.fullmatch(name)] if unordered.exists() else []
            if collection.only_success and not is_here:
                unordered.touch()
                sync_folder(collection.out)
            numbers = _numbers(collection, progress, taken, later)
            try:
                if is_here:
                    making = _here(collection, writer, env, supervisor, numbers, progress)
                else:
                    env.close()
                    making = _elsewhere(collection, writer, numbers)
                with closing(making):
                    for attempt in making:
                        _count(attempt, collection, progress)
                        yield attempt
                if unordered.exists() and not progress.is_interrupted:
                    _remove_surplus(collection, writer, progress)
                    unordered.unlink()
                _require_enough(collection, progress)
            finally:
                progress.seconds = time.perf_counter() - start
    finally:
        env.close()


def _remove_fragments(writer: DatasetWriter) -> int:
    """Remove the attempts without a verdict, and return how many there were.

    A kill cut them short, and they were recovered since. An attempt depends only on the seed and its number, so
    recording them again gives the dataset of an uninterrupted collection.
    """
    fragments = [e.id for e in Dataset.open(writer.path) if e.success is None and _ATTEMPT.fullmatch(e.id)]
    for name in fragments:
        writer.remove_episode(name)
    return len(fragments)


def _numbers(collection: Collection, progress: Progress, taken: set[str], later: Sequence[int]) -> Iterator[int]:
    """Yield numbers of attempts until enough episodes are kept.

    Args:
        collection: The recipe.
        progress: How many episodes are kept.
        taken: Ids of the episodes that are there.
        later: Numbers of attempts that are kept, where some before them may never have ended: they count once all
            before them have.
    """
    number = 0
    while not progress.is_interrupted:
        if collection.only_success:
            counted = progress.kept - sum(one >= number for one in later)
            if counted >= collection.episodes or number >= collection.attempts_before_giving_up(progress.kept):
                return
        elif number >= collection.episodes:
            return
        if episode_id(number) not in taken:
            yield number
        number += 1


def _require_enough(collection: Collection, progress: Progress) -> None:
    """Raise if a collection of successes alone has given up."""
    if progress.kept < collection.episodes and collection.only_success and not progress.is_interrupted:
        most = collection.attempts_before_giving_up(progress.kept)
        raise RcsError(
            f"Of {most} attempts {progress.kept} succeeded, and {collection.episodes} were wanted; the collection in "
            f"{collection.out} gives up. Look why attempts fail (without only_success they are recorded), or allow "
            f"more with most_attempts, now {most}."
        )


def _here(
    collection: Collection,
    writer: DatasetWriter,
    env: Env,
    supervisor: Supervisor | None,
    numbers: Iterator[int],
    progress: Progress,
) -> Generator[Attempt]:
    """Make attempts in this process, each again after a fault of real devices."""
    with closing(Collector(collection, writer, env, supervisor)) as collector:
        for number in numbers:
            while not progress.is_interrupted:
                collector.prepare(number)
                if progress.is_interrupted:  # while somebody placed the objects
                    break
                if (attempt := collector.attempt(number)) is not None:
                    yield attempt
                    break


def _remove_surplus(collection: Collection, writer: DatasetWriter, progress: Progress) -> None:
    """Remove successes of other workers that had running attempts when the last one succeeded.

    Those with the lowest numbers stay, so that the dataset does not depend on the workers' speed.
    """
    names = [episode.id for episode in Dataset.open(collection.out).episodes]
    numbers = sorted(int(name) for name in names if _ATTEMPT.fullmatch(name))
    most = max(collection.episodes - (len(names) - len(numbers)), 0)
    for number in numbers[most:]:
        writer.remove_episode(episode_id(number))
    progress.kept = len(names) - len(numbers[most:])


def _elsewhere(collection: Collection, writer: DatasetWriter, numbers: Iterator[int]) -> Generator[Attempt]:
    """Make attempts in processes of this machine, or on a cluster."""
    if collection.ray is None:
        with WorkerPool(partial(_worker, collection), collection.workers) as pool:
            yield from pool.map(numbers)
        return
    make, outbox = partial(_remote_worker, collection, writer.info), f"dataset/{EPISODES_FOLDER}"
    with RayPool(make, collection.workers, collection.ray, outbox=outbox, agent=collection.agent) as pool:
        for attempt, files in pool.map(numbers):
            episodes: dict[str, dict[str, memoryview]] = {}
            for path, data in files.items():
                episode, _, name = path.partition("/")
                episodes.setdefault(episode, {})[name] = data.data
            for episode, contents in episodes.items():
                writer.adopt(episode, contents)
            yield attempt


def _count(attempt: Attempt, collection: Collection, progress: Progress) -> None:
    """Count an attempt.

    Raises:
        RcsError: The connection to the policy was lost in it.
    """
    if attempt.is_lost:
        raise RcsError(
            f"The policy was lost: {attempt.result.message}. Episode {attempt.number} is left out; start the server, "
            "and run the same again to go on."
        )
    progress.attempts.append(attempt)
    progress.kept += bool(attempt.result.success) or (attempt.result.success is False and not collection.only_success)


def _worker(collection: Collection) -> Collector:
    return Collector(collection, DatasetWriter.join(collection.out))


def _remote_worker(collection: Collection, info: DatasetInfo, folder: Path, agent: Any) -> Collector:
    """Return a worker on another machine, which records into a dataset of its own."""
    return Collector(replace(collection, agent=agent), DatasetWriter.open(folder / "dataset", info))
