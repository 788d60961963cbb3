"""A pool of worker processes on a Ray cluster, with the interface of `WorkerPool`.

Each number is a task of Ray, which finds a free CPU for it on any machine, those that join later among them, and makes
it again when its process or its machine is lost. A process keeps its worker for its next task, in a temporary folder,
and the files that an attempt leaves in the worker's outbox return with the result: machines need no shared disk.
"""

from __future__ import annotations

import atexit
import importlib
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data.files.closing import Closing
from rcs_data.files.durable import remove_tree, write_file
from rcs_data.files.output import temporary_folder
from rcs_data.options import require_whole

from rcs.agents.agent import is_path
from rcs.envs.observers.dataset_info import versions
from rcs.errors import InvalidSetup, MissingDependency, RcsError
from rcs.rollout.pool import Worker

_log = logging.getLogger(__name__)

FOLDER = "rcs-worker"
"""In the name of a worker's own folder, which lies in that for temporary files."""
_RETRIES = 2
"""How often a number that has lost its worker is tried again; one that ends every worker must end the work."""
_POLL = 0.2
"""How long to wait for a result at a time [s]: Python reacts to Ctrl-C only in between."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "LP_NUM_THREADS"), "1")

Files = Mapping[str, NDArray[np.uint8]]
"""Contents of files by relative path, with `/`. As arrays they reach another process uncopied."""


class RayPool(Closing):
    """Workers on a cluster that map numbers to results, in order of completion."""

    def __init__(
        self, make: Callable[[Path, Any], Worker], workers: int, address: str, *, outbox: str = "", agent: Any = None
    ) -> None:
        """Connect to a cluster; workers start with the first number.

        Args:
            make: Makes a worker in its process, given the path of its folder, which does not exist yet, and the agent;
                it is pickled.
            workers: Number of processes; 0 for as many as the cluster's CPUs allow, including those that join later.
            address: Address of the cluster; see `connected`.
            outbox: The folder in the worker's own, relative, whose files are returned after each number and removed;
                the default is the whole folder.
            agent: The agent of the workers; the files of a checkpoint are sent along.

        Raises:
            MissingDependency: Ray is not installed.
            InvalidSetup: The number of workers is below 0.
            RcsError: There is no cluster at the address.
            OSError: The checkpoint cannot be read.
        """
        require_whole("workers", workers)
        files: Files = {}
        if is_path(agent):
            checkpoint = Path(agent).resolve()
            agent, files = checkpoint.name, read_files(checkpoint, checkpoint.parent)
        self._workers = workers
        self._pending: dict[Any, int] = {}
        self._open = ExitStack()
        self._ray = self._open.enter_context(connected(address))
        self._task = self._ray.remote(
            num_cpus=1, max_retries=_RETRIES, scheduling_strategy="SPREAD", runtime_env={"env_vars": _ONE_THREAD}
        )(_attempt)
        path = [folder or os.getcwd() for folder in sys.path]
        self._source = _Source(uuid.uuid4().hex, path, _versions(), self._ray.put((make, outbox, agent, files)))

    def map(self, numbers: Iterator[int]) -> Iterator[tuple[Any, Files]]:
        """Map numbers to results and files, and yield these in order of completion.

        A number is taken when a CPU is free. Without any CPU, one is taken to see whether there is work left.

        Raises:
            RcsError: A number has ended several workers, or the cluster is gone.
            Exception: A worker raised it.
        """
        waiting: list[int] = []
        while True:
            room = max(self._most() - len(self._pending), 0)
            for number in islice(chain(waiting, numbers), room):
                self._pending[self._task.remote(self._source, number)] = number
            waiting = waiting[room:]
            if self._pending:
                for done in self._ray.wait(list(self._pending), timeout=_POLL)[0]:
                    yield self._result(done, self._pending.pop(done))
            elif not (waiting := waiting or list(islice(numbers, 1))):
                return

    def _most(self) -> int:
        """Return how many tasks there may be at a time."""
        there = int(self._ray.cluster_resources().get("CPU", 0))
        if there == 0:
            _log.warning("The cluster has no machine with a CPU. Waiting for one.")
            time.sleep(1.0)
        return min(self._workers or there, there)

    def _result(self, done: Any, number: int) -> tuple[Any, Files]:
        errors = self._ray.exceptions
        try:
            return self._ray.get(done)
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
    worker: Any
    """Reference to the arguments of `FileWorker`."""


class FileWorker:
    """A worker in a temporary folder; each result is returned with the files that were written for it."""

    def __init__(
        self, make: Callable[[Path, Any], Worker], outbox: str = "", agent: Any = None, files: Files | None = None
    ) -> None:
        """Make the folder and the worker; arguments as those of `RayPool`, and the files of the agent's checkpoint."""
        self._open = ExitStack()
        place = Path(tempfile.gettempdir()).resolve() / FOLDER
        folder = self._open.enter_context(temporary_folder(place))
        self._outbox = folder / outbox
        try:
            write_files(files or {}, folder / "agent")
            self._worker = make(folder, folder / "agent" / agent if files else agent)
        except BaseException:
            self._open.close()
            raise
        self._open.callback(self._worker.close)

    def attempt(self, number: int) -> tuple[Any, Files]:
        """Return the worker's result for a number, and the files."""
        result = self._worker.attempt(number)
        files = read_files(self._outbox, self._outbox)
        for path in list(self._outbox.iterdir()) if self._outbox.is_dir() else []:
            remove_tree(path)
        return result, files

    def close(self) -> None:
        """Close the worker and remove the folder, whatever fails."""
        self._open.close()


_workers: dict[str, FileWorker] = {}
"""The worker of this process, by pool."""


def _attempt(source: _Source, number: int) -> tuple[Any, Files]:
    """Return the worker's result for a number, and its files: the task."""
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
        arguments: Any = ray.get(source.worker)
        _workers[source.pool] = worker = FileWorker(*arguments)
        atexit.register(worker.close)
    return _workers[source.pool].attempt(number)


def read_files(path: Path, root: Path) -> Files:
    """Return the contents of a file, or of all files below a folder, by path relative to a root.

    Raises:
        OSError: A file cannot be read.
    """
    paths = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    return {each.relative_to(root).as_posix(): np.fromfile(each, np.uint8) for each in paths}


def write_files(files: Files, folder: Path) -> None:
    """Write files into a folder, which is made if there are any; each is there whole or as it was before.

    Raises:
        OSError: The disk fails.
    """
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_file(folder / path, data.data)


def _versions() -> dict[str, str]:
    # Ray itself compares that of Python, as far as it matters.
    return {name: version for name, version in versions().items() if name != "python"}


@contextmanager
def connected(address: str) -> Generator[Any]:
    """Yield the module `ray`, connected; an existing connection of this process is used and stays.

    Args:
        address: `auto` for the cluster that was started on this machine, or `host:port` for one that this machine is a
            part of.

    Raises:
        MissingDependency: Ray is not installed.
        InvalidSetup: The address is one of Ray Client.
        RcsError: There is no cluster at the address.
    """
    if "://" in address:
        raise InvalidSetup(
            f"The address of the Ray cluster is {address!r}; valid is 'auto' or 'host:port'. "
            "Run the command on a machine of the cluster."
        )
    try:
        ray = importlib.import_module("ray")
    except ImportError as err:
        raise MissingDependency("Clusters need Ray: pip install 'robot-control-stack[ray]'.") from err
    if ray.is_initialized():
        yield ray
        return
    is_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM) if is_main else None
    try:
        try:
            ray.init(address, log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, RuntimeError, ValueError, OSError, ray.exceptions.RayError) as err:
            raise RcsError(
                f"Could not connect to the Ray cluster {address!r}: {err}. Is it running, and is this machine a part "
                "of it? `ray start --head` starts one, `ray start --address=host:port` adds a machine."
            ) from err
        finally:
            if is_main:  # Ray replaces this process's own reaction
                signal.signal(signal.SIGTERM, before or signal.SIG_DFL)
        yield ray
    finally:
        ray.shutdown()
