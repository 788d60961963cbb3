"""Connects to a Ray cluster, or starts one on this machine that ends with the connection."""

from __future__ import annotations

import functools
import importlib
import os
import secrets
import signal
import tempfile
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rcs_data.output import temporary_folder

from rcs.errors import InvalidSetup, MissingDependency, RcsError

LOCAL = "local"
"""The address of a cluster of this machine alone, started for one connection."""

# Of a local cluster [B]. An episode is fetched as soon as it ends; what does not fit goes to the disk.
_OBJECT_STORE = 256 << 20
# A path of a Unix socket has at most 107 bytes (unix(7)), of which Ray's own folders and names take 75.
_LONGEST_FOLDER = 32


@contextmanager
def connected(address: str, *, cpus: int) -> Generator[tuple[Any, dict[str, str]]]:
    """Yield the module `ray`, connected, and environment variables for worker processes.

    A connection that this process has already is used and stays.

    Args:
        address: `local` for a cluster of this machine, `auto` for the one that was started on this machine, or
            `host:port` for one that this machine is a part of.
        cpus: How many CPUs a local cluster offers.

    Raises:
        MissingDependency: Ray is not installed.
        InvalidSetup: The address is one of Ray Client.
        RcsError: There is no cluster at the address, or none can be started here.
    """
    if "://" in address:
        raise InvalidSetup(
            f"The address of the Ray cluster is {address!r}; valid is 'local', 'auto' or 'host:port'. "
            "Run the command on a machine of the cluster."
        )
    ray = _ray()
    if ray.is_initialized():
        yield ray, {}
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address != LOCAL:
        with _session(ray, address, address=address, **quiet):
            yield ray, {}
        return
    place = Path(tempfile.gettempdir()).resolve()
    if len(os.fsencode(place)) > _LONGEST_FOLDER - len("/.rcs-ray.partial-00000000"):
        place = Path("/tmp")
    with temporary_folder(place / "rcs-ray") as folder, _environment(_of_local()):
        own = folder / "tmp"
        own.mkdir(parents=True)
        about = {"num_cpus": cpus, "include_dashboard": False, "object_store_memory": _OBJECT_STORE}
        with _session(ray, address, address=LOCAL, _temp_dir=str(folder), **about, **quiet):
            yield ray, {"TMPDIR": str(own)}


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError as err:
        raise MissingDependency("Clusters need Ray: pip install 'robot-control-stack[ray]'.") from err


@contextmanager
def _session(ray: Any, name: str, **options: Any) -> Generator[None]:
    """Be connected inside, with this process's own reaction to SIGTERM, which Ray replaces."""
    is_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM) if is_main else None
    try:
        try:
            ray.init(**options)
        except (ConnectionError, RuntimeError, ValueError, OSError, ray.exceptions.RayError) as err:
            words = f"No Ray cluster could be started: {err}" if name == LOCAL else (
                f"Could not connect to the Ray cluster {name!r}: {err}. Is it running, and is this machine a part of "
                "it? `ray start --head` starts one, `ray start --address=host:port` adds a machine."
            )  # fmt: skip
            raise RcsError(words) from err
        finally:
            if is_main:
                signal.signal(signal.SIGTERM, before or signal.SIG_DFL)
        yield
    finally:
        ray.shutdown()


def _of_local() -> dict[str, str | None]:
    """Return environment variables of a local cluster: nothing is reported, and nobody else may connect."""
    mine: dict[str, str | None] = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": os.environ.get("RAY_AUTH_MODE")}
    if not {"RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"} & set(os.environ):
        # Ray demands a token of every local cluster, and would store its own in the home folder.
        mine["RAY_AUTH_TOKEN"] = _token()
    return mine


@functools.cache
def _token() -> str:
    # Ray remembers the first one that a process has.
    return secrets.token_hex(32)


@contextmanager
def _environment(variables: Mapping[str, str | None]) -> Generator[None]:
    """Set variables inside, and give them back their former values; one that is None may be set meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update({name: value for name, value in variables.items() if value is not None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
