"""Other programs on this machine, as messages name them."""

from __future__ import annotations

from pathlib import Path

LONGEST = 80
"""Most letters of a program's command."""


def program_of(process: int | str) -> str:
    """Return a process with its command, such as `process 4711 (python collect.py)`."""
    try:
        words = Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:  # it has ended
        words = ""
    words = words if len(words) <= LONGEST else f"{words[: LONGEST - 3]}..."
    return f"process {process} ({words})" if words else f"process {process}"
