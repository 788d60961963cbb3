"""How episodes went: each succeeded, failed, or was not judged, and only those that were judged make a rate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rcs.data.wilson import wilson_interval


@dataclass(frozen=True, kw_only=True)
class Verdicts:
    """How many episodes succeeded, failed, and were not judged."""

    succeeded: int
    """The task was done."""
    failed: int
    """It was not."""
    not_judged: int
    """Nobody said: a recovered or repaired part of an episode, or one imported from where that is not kept."""

    @classmethod
    def of(cls, verdicts: Iterable[bool | None]) -> Verdicts:
        """Count verdicts, as `EpisodeRecord.success` has them."""
        given = list(verdicts)
        return cls(succeeded=given.count(True), failed=given.count(False), not_judged=given.count(None))

    @property
    def judged(self) -> int:
        """Episodes of which somebody said how they went."""
        return self.succeeded + self.failed

    @property
    def rate(self) -> float | None:
        """The share of successes among those that were judged; None if none was."""
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
