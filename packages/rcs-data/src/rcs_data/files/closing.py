"""Context managers that are closed at the end of a `with` block."""

from __future__ import annotations

from abc import ABC, abstractmethod

from typing_extensions import Self


class Closing(ABC):
    """A context manager that is itself, and is closed at the end, however the block ends."""

    @abstractmethod
    def close(self) -> None:
        """Give back what it holds. Closing twice is harmless."""

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()
