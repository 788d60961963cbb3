"""Comparisons of success rates: of two agents on the same seeds, of many agents, and of two domains.

Episodes with the same seed share their difficulty, so their verdicts form pairs. Only the pairs with different verdicts
say which agent is better; the tests below are exact on those. Verdicts that are None are left out and counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist, correlation

from rcs_data.errors import InvalidSetup
from rcs_data.read.verdicts import wilson_interval

FEWEST = 6
"""Pairs with different verdicts below which no verdict is possible: five that agree have a p value of 2/32 = 0.0625."""


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Numbers of seeds by the verdicts of two agents, A and B."""

    both: int = 0
    """Both succeeded."""
    only_a: int = 0
    """A alone succeeded."""
    only_b: int = 0
    """B alone succeeded."""
    neither: int = 0
    """Both failed."""
    left_out: int = 0
    """Seeds that only one agent has, or where a verdict is missing."""

    @classmethod
    def of(cls, a: Mapping[int, bool | None], b: Mapping[int, bool | None]) -> Pairs:
        """Count the verdicts of two agents by seed; None is an episode without a verdict."""
        shared = [(a.get(seed), b.get(seed)) for seed in a.keys() | b.keys()]
        return cls(
            both=shared.count((True, True)),
            only_a=shared.count((True, False)),
            only_b=shared.count((False, True)),
            neither=shared.count((False, False)),
            left_out=sum(None in pair for pair in shared),
        )

    def __add__(self, other: Pairs) -> Pairs:
        """Return the numbers of both, of different seeds."""
        return Pairs(**{name: count + getattr(other, name) for name, count in vars(self).items()})

    @property
    def n(self) -> int:
        """Seeds with two verdicts."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def discordant(self) -> int:
        """Seeds with different verdicts."""
        return self.only_a + self.only_b

    @property
    def difference(self) -> float | None:
        """Rate of A less rate of B; None without pairs."""
        return (self.only_a - self.only_b) / self.n if self.n else None

    @property
    def p(self) -> float:
        """The two-sided p value of McNemar's exact test: the verdicts are as likely either way round.

        Source: Q. McNemar, "Note on the sampling error of the difference between correlated proportions or
        percentages", Psychometrika 12 (1947), 153-157; here with the binomial distribution in place of chi square.
        """
        n, least = self.discordant, min(self.only_a, self.only_b)
        return min(1.0, 2 * sum(math.comb(n, k) for k in range(least + 1)) / 2**n)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the difference of the rates, A less B; -1 to 1 without pairs.

        Source: R. G. Newcombe, "Improved confidence intervals for the difference between binomial proportions based on
        paired data", Statistics in Medicine 17 (1998), 2635-2650, method 10.
        """
        if not self.n:
            return -1.0, 1.0
        wins_a, wins_b = self.both + self.only_a, self.both + self.only_b
        rate_a, rate_b = wins_a / self.n, wins_b / self.n
        (low_a, high_a), (low_b, high_b) = wilson_interval(wins_a, self.n), wilson_interval(wins_b, self.n)
        phi = self._correlation(wins_a, wins_b)
        below, above = (rate_a - low_a, high_b - rate_b), (high_a - rate_a, rate_b - low_b)
        low, high = (math.sqrt(max(one**2 - 2 * phi * one * other + other**2, 0.0)) for one, other in (below, above))
        # Exact but for rounding, which must not leave the range of a difference.
        return max(rate_a - rate_b - low, -1.0), min(rate_a - rate_b + high, 1.0)

    def _correlation(self, wins_a: int, wins_b: int) -> float:
        """Return the phi coefficient of the verdicts, corrected for continuity if positive, as method 10 has it."""
        product = wins_a * (self.n - wins_a) * wins_b * (self.n - wins_b)
        if not product:
            return 0.0
        cross = self.both * self.neither - self.only_a * self.only_b
        return (max(cross - self.n / 2, 0.0) if cross > 0 else cross) / math.sqrt(product)

    @property
    def evidence(self) -> float:
        """The e value against equal agents; 1 is none, 20 rejects at a level of 0.05, at whatever moment one looks.

        Each discordant pair is a fair coin if the agents are equal. The value is the likelihood ratio of a coin with
        an unknown bias, mixed over Beta(1/2, 1/2), to the fair coin. It is a martingale with mean 1, so it ever reaches
        1/alpha with a probability of at most alpha (Ville's inequality).

        Source: R. E. Krichevsky and V. K. Trofimov, "The performance of universal encoding", IEEE Transactions on
        Information Theory 27 (1981), 199-207; A. Ramdas et al., "Game-theoretic statistics and safe anytime-valid
        inference", Statistical Science 38 (2023), 576-601.
        """
        a, b = self.only_a, self.only_b
        log_mixture = math.lgamma(a + 0.5) + math.lgamma(b + 0.5) - math.lgamma(a + b + 1) - math.log(math.pi)
        return math.exp(min(log_mixture + (a + b) * math.log(2), 700.0))

    def is_decided(self, alpha: float) -> bool:
        """Return whether one agent is better, at a level `alpha` that holds however often one looks."""
        return self.discordant >= FEWEST and self.evidence >= 1 / alpha

    def needed(self, alpha: float = 0.05) -> int | None:
        """Return about how many pairs would show the difference seen here by McNemar's test; None if there is none.

        They show it with a probability of 0.8, if the rates are as seen here, and have at least as many discordant ones
        as the test needs if all of those agree.

        Args:
            alpha: Level of the two-sided test.

        Source: R. J. Connor, "Sample size for testing differences in proportions for the paired-sample design",
        Biometrics 43 (1987), 207-211.
        """
        if not self.difference:
            return None
        share = self.discordant / self.n
        z_alpha, z_power = NormalDist().inv_cdf(1 - alpha / 2), NormalDist().inv_cdf(0.8)
        root = z_alpha * math.sqrt(share) + z_power * math.sqrt(max(share - self.difference**2, 0.0))
        fewest = math.ceil(math.log2(2 / alpha))  # as `FEWEST` for 0.05
        return math.ceil(max((root / self.difference) ** 2, fewest * self.n / self.discordant))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values adjusted for their number, so that the error of the whole family keeps its level.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
    (1979), 65-70.
    """
    adjusted, largest = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted


def pearson(real: Sequence[float], simulated: Sequence[float]) -> float | None:
    """Return Pearson's correlation of the rates of the same policies in two domains; None if either does not vary."""
    _check_domains(real, simulated)
    if min(len(set(real)), len(set(simulated))) == 1:  # a mean is rounded, so that the spread is not quite 0
        return None
    return correlation(real, simulated)


def mean_maximum_rank_violation(real: Sequence[float], simulated: Sequence[float]) -> float:
    """Return by how much the simulation misleads about the order of policies: 0 if it never does.

    For each policy, the largest difference in real rates to a policy that the simulation ranks the other way round; the
    mean of these.

    Source: X. Li et al., "Evaluating real-world robot manipulation policies in simulation" (SIMPLER), CoRL 2024.
    """
    _check_domains(real, simulated)
    policies = range(len(real))
    worst = [
        max(abs(real[i] - real[j]) * ((simulated[i] < simulated[j]) != (real[i] < real[j])) for j in policies)
        for i in policies
    ]
    return sum(worst) / len(worst)


def _check_domains(real: Sequence[float], simulated: Sequence[float]) -> None:
    """Refuse rates that are not of the same policies.

    Raises:
        InvalidSetup: The lengths differ, or there are fewer than two.
    """
    if len(real) != len(simulated) or len(real) < 2:
        raise InvalidSetup(
            f"{len(real)} real and {len(simulated)} simulated rates: give both rates of at least two policies."
        )
