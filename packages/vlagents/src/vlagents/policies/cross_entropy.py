"""Planning by the cross-entropy method: draw motions, keep those that end nearest to the goal, draw closer to them.

After the first rounds of Rubinstein's method (1999) as V-JEPA 2 (Assran et al., 2025, section 3.2) uses it: a normal
distribution over motions of the hand, whose mean and deviation move towards the best of those that were drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vlagents.errors import InvalidInput

LARGEST_GRIP = 0.75
"""Most that the gripper closes or opens in a step, of its whole way."""
SMALLEST_GRIP = 0.25
"""Less than that of the whole way is noise of the search, and becomes 0."""
FREE = 4
"""Numbers that are searched for: translation and gripper. Rotation stays, as in V-JEPA 2's experiments."""


@dataclass(frozen=True, kw_only=True)
class Search:
    """How much is drawn, and how far."""

    horizon: int = 2
    """Steps that are planned ahead."""
    samples: int = 400
    """Motions that are drawn in each round. More find better plans, at proportional time and memory."""
    best: int = 10
    """Motions that are kept of them."""
    rounds: int = 10
    """How often."""
    inertia: float = 0.15
    """Part of the mean and deviation that stays from round to round; higher converges later."""
    reach: float = 0.05
    """Most that the hand moves in a step along each axis [m]."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            InvalidInput: One is wrong.
        """
        for name in ("horizon", "samples", "best", "rounds"):
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= 100_000:
                raise InvalidInput(f"{name} of the search is {value!r}; valid is a whole number from 1.")
        if not 2 <= self.best <= self.samples:
            raise InvalidInput(f"best of the search is {self.best}; valid is 2 to its {self.samples} samples.")
        if not (isinstance(self.inertia, (int, float)) and 0 <= self.inertia < 1):
            raise InvalidInput(f"inertia of the search is {self.inertia!r}; valid is a number from 0, below 1.")
        if not (isinstance(self.reach, (int, float)) and math.isfinite(self.reach) and self.reach > 0):
            raise InvalidInput(f"reach of the search is {self.reach!r}; valid is a number of metres above 0.")


def plan(torch: Any, imagine: Callable[[Any], Any], search: Search, generator: Any, device: Any) -> Any:
    """Return the motion that ends nearest to the goal, (horizon, 4): translation [m], and how far the gripper closes.

    Args:
        torch: The module.
        imagine: Takes motions (samples, horizon, 4), returns how far from the goal each ends, (samples,).
        search: How much is drawn, and how far.
        generator: Of random numbers, on the CPU, so that a seed means the same on all devices.
        device: Where `imagine` works.
    """
    limit = torch.tensor([search.reach] * 3 + [LARGEST_GRIP], device=device)
    mean = torch.zeros(search.horizon, FREE, device=device)
    deviation = torch.tensor([search.reach] * 3 + [1.0], device=device).repeat(search.horizon, 1)
    for _ in range(search.rounds):
        drawn = torch.randn(search.samples, search.horizon, FREE, generator=generator).to(device)
        motions = torch.clamp(mean + deviation * drawn, -limit, limit)
        best = motions[torch.topk(imagine(motions), search.best, largest=False).indices]
        mean = search.inertia * mean + (1.0 - search.inertia) * best.mean(dim=0)
        deviation = search.inertia * deviation + (1.0 - search.inertia) * best.std(dim=0)
    grip = mean[:, 3:]
    return torch.cat([mean[:, :3], torch.where(grip.abs() < SMALLEST_GRIP, 0.0, grip)], dim=1)
