"""Counts of episodes that succeeded, failed, or were not judged; the success rate is of the judged ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rcs.data.wilson import wilson_interval


@dataclass(frozen=True, kw_only=True)
class Verdicts:
    """How many episodes succeeded, failed, and were not judged."""

    succeeded: int
    """Episodes whose task was done."""
    failed: int
    """Episodes whose task was not done."""
    not_judged: int
    """Episodes without a verdict, such as recovered, repaired or some imported ones."""

    @classmethod
    def of(cls, verdicts: Iterable[bool | None]) -> Verdicts:
        """Count values of `EpisodeRecord.success`."""
        given = list(verdicts)
        return cls(succeeded=given.count(True), failed=given.count(False), not_judged=given.count(None))

    @property
    def judged(self) -> int:
        """Episodes with a verdict."""
        return self.succeeded + self.failed

    @property
    def rate(self) -> float | None:
        """The share of successes among the judged episodes; None if there are none."""
        return self.succeeded / self.judged if self.judged else None

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % Wilson interval of the rate."""
        return wilson_interval(self.succeeded, self.judged)

    def __str__(self) -> str:
        """Return it in words: "67 of 67 judged = 100.0 % (95 % Wilson interval 94.6 to 100.0 %)", or "not judged"."""
        if self.rate is None:
            return "not judged"
        low, high = self.interval
        rate = f"{self.succeeded} of {self.judged} judged = {100 * self.rate:.1f} %"
        return f"{rate} (95 % Wilson interval {100 * low:.1f} to {100 * high:.1f} %)"
