"""Counts of episodes that succeeded, failed, or were not judged; the success rate is of the judged ones."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from rcs_data.errors import InvalidSetup

# The two-sided 95 % point of the normal distribution.
_Z = 1.959963984540054


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


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate; it is right also near 0 and 1, and for few episodes.

    Args:
        successes: Episodes that succeeded.
        n: Episodes in all; with none, nothing is known and the interval is 0 to 1.

    Raises:
        InvalidSetup: There are more successes than episodes, or fewer than none.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
    American Statistical Association 22 (1927), 209-212.
    """
    if not 0 <= successes <= n:
        raise InvalidSetup(f"{successes} successes of {n} episodes make no sense.")
    if n == 0:
        return 0.0, 1.0
    rate = successes / n
    centre = rate + _Z**2 / (2 * n)
    half = _Z * math.sqrt(rate * (1 - rate) / n + _Z**2 / (4 * n**2))
    width = 1 + _Z**2 / n
    # At 0 and at n the formula is exact but for rounding, which must not leave the range of a rate.
    low = 0.0 if successes == 0 else (centre - half) / width
    high = 1.0 if successes == n else (centre + half) / width
    return low, high
