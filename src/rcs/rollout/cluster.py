"""Connects to a Ray cluster, or starts one on this machine that ends with the connection."""

from __future__ import annotations

import importlib
import os
import signal
import tempfile
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rcs_data.output import temporary_folder

from rcs.errors import InvalidSetup, MissingDependency, RcsError

LOCAL = "local"
"""The address of a cluster of this machine alone, started for one connection."""

_OBJECT_STORE = 256 << 20
"""Memory of a local cluster for results [B]; they are fetched at once, and what does not fit goes to the disk."""
_LONGEST_FOLDER = 32
"""Longest path of Ray's folder: that of a Unix socket has at most 107 bytes (unix(7)), of which Ray's names take 75."""


@contextmanager
def connected(address: str, *, cpus: int) -> Generator[tuple[Any, dict[str, str]]]:
    """Yield the module `ray`, connected, and environment variables for worker processes.

    An existing connection of this process is used and stays.

    Args:
        address: `local` for a cluster of this machine, `auto` for the one that was started on this machine, or
            `host:port` for one that this machine is a part of.
        cpus: Number of CPUs that a local cluster offers.

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
    try:
        ray = importlib.import_module("ray")
    except ImportError as err:
        raise MissingDependency("Clusters need Ray: pip install 'robot-control-stack[ray]'.") from err
    if ray.is_initialized():
        yield ray, {}
        return
    if address != LOCAL:
        with _session(ray, address=address):
            yield ray, {}
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    place = Path(tempfile.gettempdir()).resolve()
    if len(os.fsencode(place)) > _LONGEST_FOLDER - len("/.rcs-ray.partial-00000000"):
        place = Path("/tmp")
    with temporary_folder(place / "rcs-ray") as folder:
        (folder / "tmp").mkdir(parents=True)
        options = {"num_cpus": cpus, "include_dashboard": False, "object_store_memory": _OBJECT_STORE}
        with _session(ray, address=LOCAL, _temp_dir=str(folder), **options):
            yield ray, {"TMPDIR": str(folder / "tmp")}


@contextmanager
def _session(ray: Any, address: str, **options: Any) -> Generator[None]:
    """Connect, and keep this process's own reaction to SIGTERM, which Ray replaces."""
    is_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM) if is_main else None
    try:
        try:
            ray.init(address, log_to_driver=False, logging_level="ERROR", **options)
        except (ConnectionError, RuntimeError, ValueError, OSError, ray.exceptions.RayError) as err:
            if address == LOCAL:
                raise RcsError(f"No Ray cluster could be started: {err}") from err
            raise RcsError(
                f"Could not connect to the Ray cluster {address!r}: {err}. Is it running, and is this machine a part "
                "of it? `ray start --head` starts one, `ray start --address=host:port` adds a machine."
            ) from err
        finally:
            if is_main:
                signal.signal(signal.SIGTERM, before or signal.SIG_DFL)
        yield
    finally:
        ray.shutdown()
