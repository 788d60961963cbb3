"""A program that edits, and is killed before every single call that changes the disk, once each.

Run as `kill_every_edit.py SOURCE FOLDER EDIT [STRIDE]`: for n = 0, 1, 2 …, or every STRIDE-th of them, a copy of the
dataset in SOURCE is edited in FOLDER/n by a child that dies just before its n-th call, until one lives to the end.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path
from types import ModuleType

from rcs_data import Dataset, DatasetWriter, edit
from rcs_data.check.repair import repair


def sibling(path: Path) -> ModuleType:
    """Import a program that lies elsewhere."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(source: Path, folder: Path, name: str, stride: int = 1) -> None:
    """Kill one child after the other, until one is done before its time."""
    killing = sibling(Path(__file__).parent.parent / "record/kill_every_call.py")
    killing.CALLS = (*killing.CALLS, "link")
    for n in range(0, 1000, stride):
        path = folder / str(n)
        shutil.copytree(source, path)
        child = os.fork()
        if child == 0:
            killing.die_before_call(n)
            if name == "delete":
                edit.delete(path, ["000001"])
            elif name == "trim":
                edit.trim(path, "000000", first=2, last=5)
            elif name == "relabel":
                edit.relabel(path, "push")
            elif name == "undo":
                edit.undo(path)
            elif name == "prune":
                edit.prune(path)
            elif name == "repair":
                repair(path)
            elif name == "merge":
                edit.merge([path, source], folder / f"{n}-merged")
            elif name == "remove":
                with DatasetWriter.open(path, Dataset.open(path).info, resume=True) as writer:
                    writer.remove_episode("000001")
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if status == 0:
            return
        if os.waitstatus_to_exitcode(status) != 9:
            raise SystemExit(f"child {n} failed with {os.waitstatus_to_exitcode(status)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], *map(int, sys.argv[4:]))
