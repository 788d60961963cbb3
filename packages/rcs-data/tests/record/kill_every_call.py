"""A program that records, and is killed before every single call that changes the disk, once each.

Run as `kill_every_call.py FOLDER [STRIDE]`. For n = 0, 1, 2 …, or every STRIDE-th of them, a forked child records into
FOLDER/n and dies without any clean-up just before its n-th call, until one lives to the end. Its progress is in
FOLDER/n.progress.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data import DatasetInfo, DatasetWriter, Feature

CALLS = ("write", "fsync", "rename", "replace", "unlink", "mkdir", "rmdir", "open", "ftruncate")
ROWS = 70  # more than are kept in memory, so that some are on disk before the end

INFO = DatasetInfo(
    frequency=30,
    features=(
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
    ),
    setup={},
    instruction="",
    sim_state_size=2,
)


def record(path: Path, note: Callable[[bytes], object]) -> None:
    """Record two episodes and discard one between them; all values of an episode are one number."""
    with DatasetWriter.open(path, INFO) as writer:
        note(b"opened\n")
        for value, name in enumerate(("first", "discarded", "second")):
            with writer.episode(name, seed=value) as episode:
                numbers = np.full(2, float(value))
                episode.add({"observation/joints": numbers}, numbers)
                for _ in range(ROWS - 1):
                    episode.add({"observation/joints": numbers, "action/joints": numbers}, numbers)
                if name == "discarded":
                    episode.discard()
                else:
                    episode.finish(True, {})
            note(f"{name}\n".encode())


def die_before_call(n: int) -> None:
    """Let the process end at once, as if killed, before its n-th call of any of `CALLS`."""
    left = n

    def counting(call: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*args: Any, **kwargs: Any) -> Any:
            nonlocal left
            if left == 0:
                os._exit(9)
            left -= 1
            return call(*args, **kwargs)

        return counted

    for name in CALLS:
        setattr(os, name, counting(getattr(os, name)))


def main(folder: Path, stride: int = 1) -> None:
    """Kill one child after the other, until one is done before its time."""
    for n in range(0, 1000, stride):
        child = os.fork()
        if child == 0:
            note = functools.partial(os.write, os.open(folder / f"{n}.progress", os.O_WRONLY | os.O_CREAT))
            die_before_call(n)
            record(folder / str(n), note)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if status == 0:
            return
        if os.waitstatus_to_exitcode(status) != 9:
            raise SystemExit(f"child {n} failed with {os.waitstatus_to_exitcode(status)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
