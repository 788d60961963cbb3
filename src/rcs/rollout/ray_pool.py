"""A pool of worker processes on a Ray cluster, with the interface of `WorkerPool`.

Each number is a task of Ray, which finds a free CPU for it on any machine, those that join later among them, and makes
it again when its process or its machine is lost. A process keeps its worker for its next task.
"""

from __future__ import annotations

import atexit
import logging
import os
import socket
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from rcs_data.closing import Closing

from rcs.envs.observers.dataset_info import versions
from rcs.errors import InvalidSetup, RcsError
from rcs.rollout.cluster import LOCAL, connected
from rcs.rollout.pool import Worker

_log = logging.getLogger(__name__)

_RETRIES = 2
"""How often a number that has lost its worker is tried again; one that ends every worker must end the work."""
_POLL = 0.2
"""How long to wait for a result at a time [s]: Python reacts to Ctrl-C only in between."""


@dataclass
class ClusterUsage:
    """The workers of a pool."""

    workers: int = 0
    """Largest number of tasks at a time."""
    machines: set[str] = field(default_factory=set[str])
    """Ids of the machines that returned a result."""

    def __str__(self) -> str:
        """Return the figures in words, such as "8 on 2 machines"."""
        return f"{self.workers} on {len(self.machines)} machine{'s' if len(self.machines) != 1 else ''}"


class RayPool(Closing):
    """Workers on a cluster that map numbers to results, in order of completion."""

    def __init__(
        self,
        make: Callable[[], Worker],
        workers: int,
        address: str,
        *,
        cpus: int = 1,
        gpus: float = 0.0,
    ) -> None:
        """Connect to a cluster; workers start with the first number.

        Args:
            make: Makes a worker in its process; it is pickled.
            workers: Number of processes; 0 for as many as the cluster's CPUs allow, including those that join later.
            address: Address of the cluster; see `rcs.rollout.cluster.connected`.
            cpus: CPUs of each worker, and threads of its numerical libraries.
            gpus: GPUs of each worker; without one it sees none.

        Raises:
            MissingDependency: Ray is not installed.
            InvalidSetup: A local cluster needs a number of workers, or a number is not valid.
            RcsError: There is no cluster at the address.
        """
        if workers < 0 or cpus < 1 or gpus < 0:
            raise InvalidSetup(f"workers, cpus, gpus are {workers}, {cpus}, {gpus}; valid are 0, 1, 0 and more.")
        if workers == 0 and address == LOCAL:
            raise InvalidSetup("A local cluster needs a number of workers; valid is 1 and more.")
        self.usage = ClusterUsage()
        self._workers, self._cpus = workers, cpus
        self._pending: dict[Any, int] = {}
        self._open = ExitStack()
        self._ray, variables = self._open.enter_context(connected(address, cpus=max(workers, 1) * cpus))
        threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "LP_NUM_THREADS")
        variables = {**variables, **dict.fromkeys(threads, str(cpus))}
        self._task = self._ray.remote(
            num_cpus=cpus,
            num_gpus=gpus,
            max_retries=_RETRIES,
            scheduling_strategy="SPREAD",
            runtime_env={"env_vars": variables},
        )(_attempt)
        path = [folder or os.getcwd() for folder in sys.path]
        self._source = _Source(uuid.uuid4().hex, path, _versions(), self._ray.put(make))

    def map(self, numbers: Iterator[int]) -> Iterator[Any]:
        """Map numbers to results, and yield these in order of completion.

        A number is taken when a CPU is free.

        Raises:
            RcsError: A number has ended several workers, or the cluster is gone.
            Exception: A worker raised it.
        """
        while True:
            most = self._most()
            for number in islice(numbers, max(most - len(self._pending), 0)):
                self._pending[self._task.remote(self._source, number)] = number
            self.usage.workers = max(self.usage.workers, len(self._pending))
            if self._pending:
                for done in self._ray.wait(list(self._pending), timeout=_POLL)[0]:
                    yield self._result(done, self._pending.pop(done))
            elif most:
                return

    def _most(self) -> int:
        """Return how many tasks there may be at a time."""
        there = int(self._ray.cluster_resources().get("CPU", 0)) // self._cpus
        if there == 0:
            _log.warning("The cluster has no machine with %d CPUs. Waiting for one.", self._cpus)
            time.sleep(1.0)
        return min(self._workers or there, there)

    def _result(self, done: Any, number: int) -> Any:
        errors = self._ray.exceptions
        try:
            machine, result = self._ray.get(done)
        except errors.RayTaskError as err:
            raise err.cause from err
        except (
            errors.WorkerCrashedError,
            errors.NodeDiedError,
            errors.ObjectLostError,
            errors.OutOfMemoryError,
        ) as err:
            raise RcsError(f"Number {number} ended {_RETRIES + 1} workers, the last one with: {err}") from err
        except errors.RayError as err:
            raise RcsError(f"The Ray cluster failed: {err}. Run the same again to go on.") from err
        self.usage.machines.add(machine)
        return result

    def close(self) -> None:
        """End the workers and leave the cluster. Closing twice is harmless."""
        with self._open:
            for task in self._pending:
                self._ray.cancel(task, force=True)
            self._pending = {}


@dataclass(frozen=True)
class _Source:
    """The ingredients of a pool's worker, sent with every task."""

    pool: str
    path: list[str]
    """Folders of modules."""
    versions: dict[str, str]
    make: Any
    """Reference to the function that makes the worker."""


_workers: dict[str, Worker] = {}
"""The worker of this process, by pool."""


def _attempt(source: _Source, number: int) -> tuple[str, Any]:
    """Return this machine's id and the worker's result for a number: the task."""
    import ray  # pyright: ignore[reportMissingImports]

    if source.pool not in _workers:
        sys.path += [folder for folder in source.path if folder not in sys.path]
        here = _versions()
        wrong = [
            f"{name} {here.get(name)} instead of {v}" for name, v in source.versions.items() if here.get(name) != v
        ]
        if wrong:
            raise RcsError(
                f"The machine {socket.gethostname()} of the cluster has {', '.join(wrong)}. Install the same versions "
                "on all machines, so that all make the same episodes."
            )
        make: Any = ray.get(source.make)
        _workers[source.pool] = worker = make()
        atexit.register(worker.close)
    return ray.get_runtime_context().get_node_id(), _workers[source.pool].attempt(number)


def _versions() -> dict[str, str]:
    # Ray itself compares that of Python, as far as it matters.
    return {name: version for name, version in versions().items() if name != "python"}
