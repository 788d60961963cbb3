"""The confidence interval of a success rate."""

from __future__ import annotations

import math

from rcs.errors import InvalidSetup

# The two-sided 95 % point of the normal distribution.
_Z = 1.959963984540054


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate; it also holds near 0 and 1, and for few episodes.

    Args:
        successes: Episodes that succeeded.
        n: Episodes in all; with none, the interval is 0 to 1.

    Raises:
        InvalidSetup: `successes` is not from 0 to `n`.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
    American Statistical Association 22 (1927), 209-212.
    """
    if not 0 <= successes <= n:
        raise InvalidSetup(f"Expected successes from 0 to n; got {successes} of {n}.")
    if n == 0:
        return 0.0, 1.0
    rate = successes / n
    centre = rate + _Z**2 / (2 * n)
    half = _Z * math.sqrt(rate * (1 - rate) / n + _Z**2 / (4 * n**2))
    width = 1 + _Z**2 / n
    # Rounding must not take the exact results at 0 and n out of range.
    low = 0.0 if successes == 0 else (centre - half) / width
    high = 1.0 if successes == n else (centre + half) / width
    return low, high
