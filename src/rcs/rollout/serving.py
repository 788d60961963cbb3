"""Servers of policies and simulators that are started for an evaluation, and ended with it.

Each has a port, and one of several GPUs, to itself.
"""

from __future__ import annotations

import fcntl
import os
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from rcs.errors import InvalidSetup, RcsError
from rcs.policy import ServedPolicy
from rcs.policy.agent import TOKEN
from rcs.policy.interface import vlagents

T = TypeVar("T")

PATIENCE = 180.0
"""How long a server may take until it answers [s]: large weights are read from a slow disk."""
PORTS = range(20_000, 32_768)
"""Ports of servers, below those that the system chooses by itself: the first free one, so that few locks are needed."""
VARIABLE = "CUDA_VISIBLE_DEVICES"
"""Environment variable that names the GPUs that a program sees."""
_KNOWN = Path("/proc/driver/nvidia/gpus")
_PAUSE, _GRACE = 0.2, 10.0
_TOLD = 15
"""Lines of a server's output that are shown when it fails."""
_WATCH = "import os, sys; sys.stdin.read(); os.killpg(int(sys.argv[1]), 9)"
"""Program that kills a group of processes once the one that started it, and has the other end of its input, is gone."""


class ServerProcess:
    """A program that serves something at an address of this machine.

    It ends with this program, however that ends, and its children with it: also where it is a shell, or `conda run`.
    """

    def __init__(self, words: Sequence[str], log: Path, *, gpu: str | None = None) -> None:
        """Start it.

        Args:
            words: The command, with `{port}` where the port belongs.
            log: File to which everything is appended that it prints.
            gpu: The only GPU that it sees; None for all that this program sees.

        Raises:
            InvalidSetup: There is no such program.
        """
        self._taken = ExitStack()
        port = str(self._taken.enter_context(_first_free("ports", _free_ports())))
        words = [word.replace("{port}", port) for word in words]
        self.address, self._log = f"vla://127.0.0.1:{port}", log
        """Where it listens, once it does."""
        environment = os.environ if gpu is None else {**os.environ, VARIABLE: gpu}
        with log.open("ab") as output:
            try:
                self._process = subprocess.Popen(
                    words,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            except OSError as err:
                self._taken.close()
                raise InvalidSetup(f"Could not start {words[0]!r}: {err.strerror or err}.") from err
        watch = [sys.executable, "-ISc", _WATCH, str(self._process.pid)]
        self._watch = subprocess.Popen(
            watch, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )

    def wait(self, ask: Callable[[], T], patience: float) -> T:
        """Return what a call returns, once it answers.

        Args:
            ask: Calls the server; raises `RcsError` as long as it does not answer.
            patience: How long it may take [s].

        Raises:
            InvalidSetup: It answers, and what it serves does not fit.
            RcsError: It ended, does not answer in time, or wants another token; the message has its last lines, and the
                file with all.
        """
        until = time.monotonic() + patience
        while True:
            try:
                return ask()
            except InvalidSetup:
                raise
            except RcsError as err:
                if (code := self._process.poll()) is not None:
                    raise RcsError(f"The server ended with {code}. {self._said()}") from err
                if isinstance(err.__cause__, vlagents().Unauthorized):
                    raise RcsError(
                        f"The server does not take the token of the environment variable {TOKEN}, or wants one while "
                        f"there is none; give both the same. {self._said()}"
                    ) from err
                if time.monotonic() > until:
                    raise RcsError(f"The server does not answer after {patience:g} s: {err} {self._said()}") from err
            time.sleep(_PAUSE)

    def _said(self) -> str:
        lines = self._log.read_text(errors="replace").splitlines()[-_TOLD:]
        return "\n".join([f"All that it printed is in {self._log}:", *lines])

    def end(self, grace: float = _GRACE) -> None:
        """End it and its children, which are a session of their own. A second call does nothing.

        Args:
            grace: How long they may take to end by themselves [s].
        """
        if grace:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(grace)
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._watch.kill()  # while the number of the group is not given to another one
        self._watch.communicate()
        self._process.wait()
        self._taken.close()


@contextmanager
def serving(command: str, checkpoint: Path, log: Path, *, patience: float = PATIENCE) -> Generator[str]:
    """Start the server of a checkpoint, and yield its address once it answers; it is ended with all its children.

    Where there are several GPUs, it sees one that no other server started so has.

    Args:
        command: Words as for a shell, with `{checkpoint}` and `{port}`, such as
            `envs/lerobot/bin/vlagents serve act --checkpoint {checkpoint} --port {port}`.
        checkpoint: The checkpoint that it serves.
        log: File for what it prints.
        patience: How long it may take until it answers [s].

    Raises:
        InvalidSetup: The command has an open quotation, or lacks a place for checkpoint or port, or there is no such
            program.
        RcsError: The server ended, or does not answer in time.
    """
    try:
        words = shlex.split(command)
    except ValueError as err:
        raise InvalidSetup(f"The command {command!r} is no line of a shell: {err}. Correct its quotes.") from err
    for name in ("{checkpoint}", "{port}"):
        if not any(name in word for word in words):
            raise InvalidSetup(f"The command {command!r} has no {name}; give it a place, as in `--port {{port}}`.")
    with own_gpu() as gpu:
        server = ServerProcess([word.replace("{checkpoint}", str(checkpoint)) for word in words], log, gpu=gpu)
        try:
            server.wait(ServedPolicy(address=server.address).metadata, patience)
            yield server.address
        finally:
            server.end()


def _free_ports() -> Iterator[str]:
    """Yield ports at which nothing listens now: of several servers at a time, each takes some seconds until it does."""
    for port in PORTS:
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        yield str(port)


@contextmanager
def own_gpu() -> Generator[str | None]:
    """Yield a GPU that no other program of this user has taken here; one is given back at the end, or with its program.

    None where there are not several, or all are taken.
    """
    names = [str(number) for number, _ in enumerate(_KNOWN.iterdir())] if _KNOWN.is_dir() else []
    if (given := os.environ.get(VARIABLE)) is not None:
        names = [name.strip() for name in given.split(",") if name.strip()]
    with _first_free("gpus", names if len(names) > 1 else ()) as found:
        yield found


@contextmanager
def _first_free(kind: str, names: Iterable[str]) -> Generator[str | None]:
    """Yield the first name that no other program of this user has taken here; it is given back as in `own_gpu`.

    None where all are taken.

    Args:
        kind: Kind of things that have the names, such as `gpus`.
        names: Their names; no more of them are taken than are needed.
    """
    folder = Path(tempfile.gettempdir(), f"rcs-{kind}-{os.getuid()}")
    found: str | None = None
    lock = -1
    try:
        for name in names:
            folder.mkdir(mode=0o700, exist_ok=True)
            lock = os.open(
                folder / name.replace("/", "-"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600
            )
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                lock = -1
            else:
                found = name
                break
        yield found
    finally:
        if lock >= 0:
            os.close(lock)
