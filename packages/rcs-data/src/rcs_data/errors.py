"""Named errors for all that can go wrong: every error says what was given, what is valid and what to do."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterable
from typing import Any


class RcsError(Exception):
    """The parent of every error that the libraries of the Robot Control Stack raise on purpose."""


class InvalidSetup(RcsError, ValueError):
    """A setup, an option or an argument does not make sense."""


class UnknownName(RcsError, KeyError):
    """No robot, task, camera or other part has the given name."""

    def __init__(self, kind: str, given: str, known: Iterable[str], hint: str = "") -> None:
        """Build the message: what was given, the nearest match, all known names.

        Args:
            kind: Kind of thing that was looked up, such as "robot".
            given: The given name.
            known: The names that exist.
            hint: One more sentence on what to do, if there is one.
        """
        names = sorted(known)
        near = difflib.get_close_matches(given.lower(), [n.lower() for n in names], n=1, cutoff=0.5)
        match = next((n for n in names if near and n.lower() == near[0]), None)
        nearest = f" Did you mean {match!r}?" if match else ""
        self.message = f"There is no {kind} named {given!r}.{nearest} Known: {', '.join(names) or 'none'}."
        if hint:
            self.message += f" {hint}"
        super().__init__(kind, given, names, hint)  # with which another process makes it anew

    def __str__(self) -> str:
        """Return the message itself; a KeyError would show it in quotes."""
        return self.message


class WrongOrder(RcsError, RuntimeError):
    """A call was made when it has no meaning: a step before reset, a use after close."""


class MissingDependency(RcsError, ImportError):
    """An optional package or system library is not installed; the message has the remedy."""


class DatasetError(RcsError, OSError):
    """A dataset cannot be written, or is locked by another writer, or does not fit this setup."""


class CorruptEpisode(RcsError, ValueError):
    """A stored episode is incomplete or its bytes are not what was written."""


def package_of(name: str, extra: str, purpose: str) -> Any:
    """Import and return a package of an extra, or a module of it.

    Args:
        name: The package or module.
        extra: The extra, such as "hdf5".
        purpose: The part and the package that it needs, as a sentence without its end.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(name)
    except ImportError as err:
        raise MissingDependency(f"{purpose}: pip install 'rcs-data[{extra}]'.") from err


def require_fields(kind: str, given: Iterable[object], valid: Iterable[str]) -> None:
    """Check the keys of what was read.

    Args:
        kind: Name of the kind of key, such as "field of a selection".
        given: The keys.
        valid: The fields that there are.

    Raises:
        InvalidSetup: A key is none of them; the words name it, and the nearest field.
    """
    valid = set(valid)
    if unknown := sorted(str(key) for key in given if key not in valid):
        raise InvalidSetup(UnknownName(kind, unknown[0], valid).message)
