"""A pool of worker processes on a Ray cluster, with the interface of `WorkerPool`.

Each worker is an actor with CPUs of its own. It maps one number at a time, and what it returns travels through Ray's
object store. Only this process knows which number is where: the number of a worker that is lost, alone or with its
machine, goes to another one. Machines that join get workers, too.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from rcs_data.closing import Closing

from rcs.envs.observers.recorder import versions
from rcs.errors import InvalidSetup, RcsError
from rcs.rollout.cluster import LOCAL, connected
from rcs.rollout.pool import Worker

_log = logging.getLogger(__name__)

# A number that has ended so many workers would end every other, too.
_MOST_LOSSES = 3
# How often machines are counted anew [s].
_LOOK_AGAIN = 2.0
# How long to wait for an answer at a time [s]: Python hears of Ctrl-C only in between.
_LISTEN = 0.2
# Without a worker for so long, the user is told what is waited for [s].
_PATIENCE = 30.0
# How long workers have for closing [s]; one that hangs is killed.
_FAREWELL = 10.0


@dataclass
class Tally:
    """Where the numbers of a pool were worked at."""

    workers: int = 0
    """Most workers at a time."""
    machines: set[str] = field(default_factory=set[str])
    """Ids of the machines that had workers."""
    lost: int = 0
    """Numbers that were lost with their worker, and done again."""

    def __str__(self) -> str:
        """Return the figures in words, such as "8 on 2 machines, 1 lost and made again"."""
        places = f"{len(self.machines)} machine{'s' if len(self.machines) != 1 else ''}"
        again = f", {self.lost} lost and made again" if self.lost else ""
        return f"{self.workers} on {places}{again}"


@dataclass
class _Place:
    """A worker on the cluster."""

    actor: Any
    node: str = ""
    answer: Any = None
    """What is waited for: the start, or the result for the number; None if it is idle."""
    number: int | None = None


class RayPool(Closing):
    """Workers on a cluster that map numbers to results, in order of completion."""

    def __init__(
        self,
        make: Callable[[], Worker],
        workers: int,
        address: str,
        *,
        most: int = 1 << 30,
        cpus: int = 1,
        gpus: float = 0.0,
    ) -> None:
        """Connect to a cluster; workers start with the first number.

        Args:
            make: Makes a worker in its process; it is pickled.
            workers: Number of processes; 0 for as many as the cluster's CPUs allow, including those that join later.
            address: Of the cluster; see `rcs.rollout.cluster.connected`.
            most: Largest number of processes; more than there are numbers are of no use.
            cpus: CPUs of each worker, and threads of its numerical libraries.
            gpus: GPUs of each worker; without one it sees none.

        Raises:
            MissingDependency: Ray is not installed.
            InvalidSetup: A local cluster is asked for without a number of workers, or a number makes no sense.
            RcsError: There is no cluster at the address.
        """
        if workers < 0 or cpus < 1 or gpus < 0:
            raise InvalidSetup(f"workers, cpus, gpus are {workers}, {cpus}, {gpus}; valid are 0, 1, 0 and more.")
        if workers == 0 and address == LOCAL:
            raise InvalidSetup("A local cluster needs a number of workers; valid is 1 and more.")
        self.tally = Tally()
        self._workers = workers
        self._most = most
        self._cpus = cpus
        self._places: list[_Place] = []
        self._failed_starts = 0
        self._counted = -_LOOK_AGAIN
        self._wanted = 0
        self._open = ExitStack()
        self._ray, variables = self._open.enter_context(connected(address, cpus=max(workers, 1) * cpus))
        threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "LP_NUM_THREADS")
        variables = {**variables, **dict.fromkeys(threads, str(cpus))}
        self._actor = self._ray.remote(
            num_cpus=cpus, num_gpus=gpus, scheduling_strategy="SPREAD", runtime_env={"env_vars": variables}
        )(_Actor)
        self._make = self._ray.put(make)
        self._rules = self._ray.put(([folder or os.getcwd() for folder in sys.path], _versions()))

    def map(self, numbers: Iterator[int]) -> Iterator[Any]:
        """Map numbers to results, and yield these in order of completion.

        A number is taken when a worker is free. One that is lost with its worker is done again.

        Raises:
            RcsError: A number has ended several workers, workers cannot start, or the cluster is gone.
            Exception: A worker raised it.
        """
        again: deque[int] = deque()
        losses: Counter[int] = Counter()
        is_exhausted = False
        waiting_since = time.monotonic()
        while True:
            for place in [place for place in self._places if place.answer is None]:
                number = again.popleft() if again else next(numbers, None)
                if number is None:
                    is_exhausted = True
                    break
                place.number, place.answer = number, place.actor.attempt.remote(number)
            is_at_work = any(place.number is not None for place in self._places)
            if is_exhausted and not again and not is_at_work:
                return
            if not is_exhausted or again:
                self._hire()
            if any(place.node for place in self._places):
                waiting_since = time.monotonic()
            elif time.monotonic() - waiting_since > _PATIENCE:
                waiting_since = float("inf")
                _log.warning("No worker has started yet: the cluster has no free CPU. Waiting for one.")
            for place in self._answered():
                number, place.number = place.number, None
                try:
                    result = self._result(place)
                except _Lost as err:
                    if number is None:
                        continue
                    self.tally.lost += 1
                    losses[number] += 1
                    if losses[number] == _MOST_LOSSES:
                        raise RcsError(f"Number {number} ended {_MOST_LOSSES} workers, the last so: {err}") from err
                    again.append(number)
                    continue
                if number is not None:
                    yield result

    def close(self) -> None:
        """End the workers, those at work at once, and leave the cluster. Closing twice is harmless."""
        places, self._places = self._places, []
        with self._open:
            farewells = [place.actor.close.remote() for place in places if place.answer is None]
            if farewells:
                self._ray.wait(farewells, num_returns=len(farewells), timeout=_FAREWELL)
            for place in places:
                self._ray.kill(place.actor)

    def _hire(self) -> None:
        """Start workers up to the number that is wanted and that the cluster has CPUs for."""
        now = time.monotonic()
        if now - self._counted >= _LOOK_AGAIN:
            self._counted = now
            there = int(self._ray.cluster_resources().get("CPU", 0)) // self._cpus
            self._wanted = min(self._workers or there, there, self._most)
        for _ in range(self._wanted - len(self._places)):
            actor = self._actor.remote()
            self._places.append(_Place(actor, answer=actor.start.remote(self._make, actor.check.remote(self._rules))))

    def _answered(self) -> list[_Place]:
        """Wait for an answer, and return the places that have one."""
        answers = {place.answer: place for place in self._places if place.answer is not None}
        if not answers:  # there is no machine
            time.sleep(_LISTEN)
            return []
        done, _ = self._ray.wait(list(answers), timeout=_LISTEN)
        return [answers[answer] for answer in done]

    def _result(self, place: _Place) -> Any:
        """Return what a place has answered.

        Raises:
            _Lost: The worker is gone.
            RcsError: Workers do not start, or the cluster is gone.
            Exception: The worker raised it.
        """
        errors = self._ray.exceptions
        answer, place.answer = place.answer, None
        try:
            result = self._ray.get(answer)
        except errors.RayTaskError as err:
            raise err.cause from err
        except (
            errors.RayActorError,
            errors.NodeDiedError,
            errors.ObjectLostError,
            errors.OutOfMemoryError,
            errors.WorkerCrashedError,
        ) as err:
            self._places.remove(place)
            self._ray.kill(place.actor)  # one that only could not be reached must not work on
            self._counted = -_LOOK_AGAIN
            if not place.node:
                self._failed_starts += 1
                if self._failed_starts >= _MOST_LOSSES and not any(other.node for other in self._places):
                    raise RcsError(f"Workers do not start on the cluster; the last one ended so: {err}") from err
            raise _Lost(str(err)) from err
        except errors.RayError as err:
            raise RcsError(f"The Ray cluster failed: {err}. Run the same again to go on.") from err
        if not place.node:
            place.node = result
            self.tally.machines.add(result)
            self.tally.workers = max(self.tally.workers, sum(bool(other.node) for other in self._places))
            self._failed_starts = 0
        return result


class _Lost(Exception):
    """A worker is gone."""


class _Actor:
    """The process of a worker on the cluster."""

    def check(self, rules: tuple[list[str], dict[str, str]]) -> None:
        """Let modules be imported as where the work comes from, and refuse what would make other bytes.

        Args:
            rules: The path of modules, and the versions of software.
        """
        path, wanted = rules
        sys.path += [folder for folder in path if folder not in sys.path]
        here = _versions()
        lines = [f"{name} {here.get(name)} instead of {version}" for name, version in wanted.items()]
        lines = [line for line, name in zip(lines, wanted, strict=True) if here.get(name) != wanted[name]]
        if lines:
            import socket

            raise RcsError(
                f"The machine {socket.gethostname()} of the cluster has {', '.join(lines)}. Install the same versions "
                "on all machines, so that all make the same episodes."
            )

    def start(self, make: Callable[[], Worker], _: None) -> str:
        """Make the worker, and return the machine's id."""
        import ray  # pyright: ignore[reportMissingImports]

        self._worker = make()
        return ray.get_runtime_context().get_node_id()

    def attempt(self, number: int) -> Any:
        """Return the worker's result for a number."""
        return self._worker.attempt(number)

    def close(self) -> None:
        """Close the worker."""
        self._worker.close()


def _versions() -> dict[str, str]:
    # Ray itself compares that of Python, as far as it matters.
    return {name: version for name, version in versions().items() if name != "python"}
