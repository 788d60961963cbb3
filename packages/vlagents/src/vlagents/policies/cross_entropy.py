"""Planning by the cross-entropy method: draw motions, keep those that end nearest to the goal, draw closer to them.

After the first rounds of Rubinstein's method (1999) as V-JEPA 2 (Assran et al., 2025, section 3.2) uses it: a normal
distribution over motions of the hand, whose mean and deviation move towards the best of those that were drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from vlagents.errors import InvalidInput
from vlagents.record import check

LARGEST_GRIP = 0.75
"""Most that the gripper closes or opens in a step, as a share of its range."""
SMALLEST_GRIP = 0.25
"""Smaller shares of its range are noise of the search, and become 0."""
FREE = 4
"""Numbers that are searched for: translation and gripper. Rotation is kept, as in V-JEPA 2's experiments."""


Rounds = Annotated[int, Meta(ge=1, le=100_000)]


@dataclass(frozen=True, kw_only=True)
class Search:
    """The size of the search."""

    horizon: Rounds = 2
    """Steps that are planned ahead."""
    samples: Rounds = 400
    """Motions that are drawn in each round. More find better plans, at proportional time and memory."""
    best: Annotated[int, Meta(ge=2)] = 10
    """Motions that are kept of them."""
    rounds: Rounds = 10
    """Number of rounds."""
    inertia: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.15
    """Share of the mean and deviation that stays from round to round; higher converges later."""
    reach: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.05
    """Most that the hand moves in a step along each axis [m]."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            InvalidInput: One is wrong.
        """
        check(self)
        if self.best > self.samples:
            raise InvalidInput(f"best of Search is {self.best}; valid is 2 to its {self.samples} samples.")


def plan(torch: Any, imagine: Callable[[Any], Any], search: Search, generator: Any, device: Any) -> Any:
    """Return the motion that ends nearest to the goal, (horizon, 4): translation [m], and how far the gripper closes.

    Args:
        torch: The module.
        imagine: A function of motions, (samples, horizon, 4), that returns how far from the goal each ends, (samples,).
        search: The size of the search.
        generator: Random numbers, on the CPU, so that a seed means the same on all devices.
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
