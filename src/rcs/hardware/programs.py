"""Other programs on this machine, as messages name them."""

from __future__ import annotations

import os
from pathlib import Path

LONGEST = 80
"""Most letters of a program's command."""


def program_of(process: int | str) -> str:
    """Return a process with its command, such as `process 4711 (python collect.py)`.

    The folder of the executable is left out: a long one would leave no room for what the process runs.
    """
    try:
        executable, *arguments = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:  # it has ended
        executable, arguments = "", []
    words = " ".join([executable.rpartition("/")[2], *arguments]).strip()
    words = words if len(words) <= LONGEST else f"{words[: LONGEST - 3]}..."
    return f"process {process} ({words})" if words else f"process {process}"


def holders(path: str) -> list[str]:
    """Return the other programs that have a file open, as far as this user may see them."""
    found: list[str] = []
    for entry in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.readlink(entry) == path and int(entry.parts[2]) != os.getpid():
                found.append(program_of(entry.parts[2]))
        except OSError:  # another user's, or it has ended
            continue
    return sorted(set(found))
