"""How long something may take."""

from __future__ import annotations

import time

from vlagents.errors import DeadlineExceeded


class Deadline:
    """A moment by which something must be done; every wait on the way gets what is left of it."""

    def __init__(self, seconds: float | None, what: str) -> None:
        """Start.

        Args:
            seconds: How long from now; None for ever.
            what: What must be done, for the error: "the server's answer".
        """
        self.seconds = seconds
        self._what = what
        self._end = None if seconds is None else time.monotonic() + seconds

    def left(self) -> float | None:
        """Return how long there is left [s], above 0; None for ever.

        Raises:
            DeadlineExceeded: It is over.
        """
        if self._end is None:
            return None
        left = self._end - time.monotonic()
        if left <= 0:
            raise self.exceeded()
        return left

    def exceeded(self) -> DeadlineExceeded:
        """Return the error that says what did not come in time."""
        return DeadlineExceeded(f"{self._what} did not come within {self.seconds:g} s.")
