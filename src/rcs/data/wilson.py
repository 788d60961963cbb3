"""How sure a success rate is."""

from __future__ import annotations

import math

from rcs.errors import InvalidSetup

# The two-sided 95 % point of the normal distribution.
_Z = 1.959963984540054


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
