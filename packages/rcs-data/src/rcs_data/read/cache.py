"""A cache of limited size in bytes that drops what was used longest ago."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from rcs_data.errors import InvalidSetup

T = TypeVar("T")


class ByteCache(Generic[T]):
    """Values by key; the least recently used go first. Not thread-safe."""

    def __init__(self, capacity: int) -> None:
        """Start empty.

        Args:
            capacity: Bytes that all values together may take; the newest stays even if it alone takes more.

        Raises:
            InvalidSetup: The capacity is negative.
        """
        if capacity < 0:
            raise InvalidSetup(f"A cache cannot hold {capacity} bytes; it must be 0 or more.")
        self.capacity = capacity
        self.nbytes = 0
        self._values: OrderedDict[Hashable, tuple[T, int]] = OrderedDict()

    def __len__(self) -> int:
        """Return how many values are held."""
        return len(self._values)

    def get(self, key: Hashable, make: Callable[[], tuple[T, int]]) -> T:
        """Return a value; make it if it is not in the cache.

        Args:
            key: Its key.
            make: Returns the value and its size [B].
        """
        held = self._values.get(key)
        if held is not None:
            self._values.move_to_end(key)
            return held[0]
        value, size = make()
        self._values[key] = (value, size)
        self.nbytes += size
        while self.nbytes > self.capacity and len(self._values) > 1:
            _, (_, freed) = self._values.popitem(last=False)
            self.nbytes -= freed
        return value
