"""Statistics of evaluations on simulated verdicts: coverage of intervals, power of tests, errors of early decisions.

    python benchmarks/evaluation.py [--ledgers 4000]

Two policies meet the same seeds. An episode succeeds if its difficulty, which is uniform from 0 to 1, is below the rate
of the policy; a seed has the same difficulty for both policies with a probability of 0.8, else one for each. Prints one
line of JSON:

- `wilson`: smallest and largest coverage of Wilson's 95 % interval, exact, over success rates and numbers of episodes;
- `newcombe`: coverage of the paired interval;
- `power_paired`, `power_unpaired`: of 200 episodes each at rates of 0.80 and 0.85, by McNemar's exact test on the same
  seeds and by the chi-square test of two groups; `power_shares_nothing`: both, where seeds share nothing;
- `false_alarms`: of McNemar's test for equal policies;
- `early_false_alarms`: of looking after every pair up to 500, for equal policies;
- `early_half_decided`: pairs after which half of the comparisons of 0.80 and 0.95 are decided.
"""

from __future__ import annotations

import argparse
import json
from math import comb, erfc, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data.ledger.comparison import Pairs
from rcs_data.read.verdicts import wilson_interval

RATES, EPISODES = (0.5, 0.8, 0.85, 0.95, 0.99), (20, 50, 200)
SHARED = 0.8
LEVEL = 0.05


def coverage(rate: float, n: int) -> float:
    """Return the exact probability that Wilson's interval of n episodes has the rate."""
    inside = [k for k in range(n + 1) if wilson_interval(k, n)[0] <= rate <= wilson_interval(k, n)[1]]
    return sum(comb(n, k) * rate**k * (1 - rate) ** (n - k) for k in inside)


def verdicts(random: np.random.Generator, rates: tuple[float, float], shared: float, shape: tuple[int, ...]) -> Any:
    """Return verdicts (2, *shape) of two policies on the same seeds."""
    difficulty = np.broadcast_to(random.random(shape), (2, *shape))
    difficulty = np.where(random.random(shape) < shared, difficulty, random.random((2, *shape)))
    return difficulty < np.array(rates).reshape(2, *[1] * len(shape))


def pairs_of(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> Pairs:
    """Return the counts of verdicts (N,) of two policies."""
    return Pairs(
        both=int((a & b).sum()), only_a=int((a & ~b).sum()), only_b=int((~a & b).sum()), neither=int((~a & ~b).sum())
    )


def chi_square(wins_a: int, wins_b: int, n: int) -> float:
    """Return the p value of the chi-square test of two groups of n episodes, without a correction for continuity."""
    total = wins_a + wins_b
    return erfc(abs(wins_a - wins_b) * sqrt(n / (total * (2 * n - total)))) if 0 < total < 2 * n else 1.0


def rejected(random: np.random.Generator, rates: tuple[float, float], shared: float, ledgers: int) -> dict[str, float]:
    """Return the shares of comparisons over 200 seeds in which the tests find a difference, and the coverage."""
    a, b = verdicts(random, rates, shared, (ledgers, 200))
    paired, unpaired, covered = [], [], []
    for one, other in zip(a, b, strict=True):
        pairs = pairs_of(one, other)
        paired.append(pairs.p <= LEVEL)
        low, high = pairs.interval
        covered.append(low <= rates[0] - rates[1] <= high)
        unpaired.append(chi_square(int(one.sum()), int(other.sum()), 200) <= LEVEL)
    return {name: float(np.mean(found)) for name, found in (("p", paired), ("u", unpaired), ("c", covered))}


def decisions(random: np.random.Generator, rates: tuple[float, float], most: int, ledgers: int) -> NDArray[np.float64]:
    """Return after how many pairs (ledgers,) comparisons that look after each are decided, or infinity."""
    a, b = verdicts(random, rates, SHARED, (ledgers, most))
    only_a, only_b = np.cumsum(a & ~b, axis=1), np.cumsum(~a & b, axis=1)
    known: dict[tuple[int, int], bool] = {}
    ends = np.full(ledgers, np.inf)
    for row in range(ledgers):
        for k in np.flatnonzero(a[row] != b[row]):
            counts = (int(only_a[row, k]), int(only_b[row, k]))
            if counts not in known:
                known[counts] = Pairs(only_a=counts[0], only_b=counts[1]).is_decided(LEVEL)
            if known[counts]:
                ends[row] = k + 1
                break
    return ends


def main() -> None:
    """Simulate and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ledgers", type=int, default=4000, help="simulated comparisons of each kind")
    ledgers = parser.parse_args().ledgers
    random = np.random.default_rng(0)
    wilson = [coverage(rate, n) for rate in RATES for n in EPISODES]
    better = rejected(random, (0.80, 0.85), SHARED, ledgers)
    alone = rejected(random, (0.80, 0.85), 0.0, ledgers)
    equal = rejected(random, (0.85, 0.85), SHARED, ledgers)
    found = {
        "wilson": [round(min(wilson), 3), round(max(wilson), 3)],
        "newcombe": [round(min(better["c"], equal["c"]), 3), round(max(better["c"], equal["c"]), 3)],
        "power_paired": round(better["p"], 3),
        "power_unpaired": round(better["u"], 3),
        "power_shares_nothing": [round(alone["p"], 3), round(alone["u"], 3)],
        "false_alarms": round(equal["p"], 3),
        "early_false_alarms": round(float(np.isfinite(decisions(random, (0.85, 0.85), 500, ledgers)).mean()), 3),
        "early_half_decided": float(np.median(decisions(random, (0.80, 0.95), 500, ledgers))),
    }
    print(json.dumps({"benchmark": "evaluation", "ledgers": ledgers, **found}))


if __name__ == "__main__":
    main()
