"""The network of a policy that is taught: convolutions for each camera, and layers for the robot's numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.rl.algorithms import Dagger
from rcs.rl.flat import STATE, Flat
from rcs.rl.packages import package

FLOOR = 0.05
"""Least spread that numbers of flat vectors are divided by: what hardly varies in teaching is not blown up later."""
_FEATURES = 64
"""Numbers made of the robot's state, and of each frame besides the places of its features."""


def make_student(algorithm: Dagger, flat: Flat) -> Any:
    """Return a torch module from flat observations, with a leading axis, to flat actions.

    Frames pass three convolutions. A spatial softmax tells where in the frame their features are (Levine et al. 2016,
    arXiv:1504.00702), and one more convolution what they are.

    Raises:
        MissingDependency: torch is not installed.
    """
    torch = package("torch")
    nn = torch.nn
    space = flat.observation_space
    images = flat.layout.images

    class Camera(nn.Module):
        """Makes numbers of a camera's frames."""

        def __init__(self, shape: tuple[int, int, int]) -> None:
            super().__init__()
            first, second, third = algorithm.channels
            self.convolutions = nn.Sequential(
                nn.Conv2d(shape[0], first, 5, 2), nn.ReLU(), nn.Conv2d(first, second, 3, 2), nn.ReLU(),
                nn.Conv2d(second, third, 3, 1),
            )  # fmt: skip
            self.last = nn.Sequential(nn.ReLU(), nn.Conv2d(third, third, 3, 2), nn.ReLU(), nn.Flatten())
            with torch.no_grad():
                made = self.convolutions(torch.zeros(1, *shape))
                rows, columns = (torch.linspace(-1.0, 1.0, size) for size in made.shape[2:])
                grid = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1).reshape(-1, 2)
                self.register_buffer("grid", grid, persistent=False)
                self.what = nn.Sequential(nn.Linear(self.last(made).shape[1], _FEATURES), nn.ReLU())
            self.size = 2 * third + _FEATURES

        def forward(self, frames: Any) -> Any:
            made = self.convolutions(frames.float() * (2.0 / 255.0) - 1.0)
            where = made.flatten(2).softmax(-1) @ self.grid
            return torch.cat([where.flatten(1), self.what(self.last(made))], 1)

    class Student(nn.Module):
        """The whole policy; what is normal is part of its weights."""

        def __init__(self) -> None:
            super().__init__()
            given, made = flat.layout.state_size, flat.layout.action_size
            for name, size in (("state", given), ("action", made)):
                self.register_buffer(f"{name}_mean", torch.zeros(size))
                self.register_buffer(f"{name}_spread", torch.ones(size))
            self.cameras = nn.ModuleDict({image.name: Camera(image.shape) for image in images})
            self.state = nn.Sequential(nn.Linear(given, _FEATURES if images else algorithm.network[0]), nn.ReLU())
            size = sum(camera.size for camera in self.cameras.values()) + self.state[0].out_features
            layers: list[Any] = []
            for hidden in algorithm.network:
                layers += [nn.Linear(size, hidden), *([] if layers else [nn.LayerNorm(hidden)]), nn.ReLU()]
                size = hidden
            self.head = nn.Sequential(*layers, nn.Linear(size, made))

        def forward(self, observation: Any) -> Any:
            """Return the actions."""
            return self.normal(observation) * self.action_spread + self.action_mean

        def normal(self, observation: Any) -> Any:
            """Return the actions in units of their spread, as they are learned."""
            state = observation[STATE] if isinstance(space, spaces.Dict) else observation
            seen = [camera(observation[name]) for name, camera in self.cameras.items()]
            return self.head(torch.cat([*seen, self.state((state - self.state_mean) / self.state_spread)], 1))

        def wanted(self, action: Any) -> Any:
            """Return actions in units of their spread."""
            return (action - self.action_mean) / self.action_spread

        def take_normal(self, states: Any, actions: Any) -> None:
            """Take over what is normal from NumPy arrays, a row per step."""
            for name, rows in (("state", states), ("action", actions)):
                rows = rows.astype(np.float64)
                getattr(self, f"{name}_mean").copy_(torch.from_numpy(rows.mean(0)))
                getattr(self, f"{name}_spread").copy_(torch.from_numpy(np.maximum(rows.std(0), FLOOR)))

    # Convolutions on the CPU are about a third faster with channels last.
    return Student().to(memory_format=torch.channels_last)
