"""The networks of policies as torch modules: those of Stable-Baselines3, and the students of teachers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.extras import package_of
from rcs.rl.flat import STATE, Flat
from rcs.rl.training import Algorithm, Dagger, Ppo

LEAST_SPREAD = 0.05
"""Least spread that numbers of flat vectors are divided by: what hardly varies in teaching is not blown up later."""
_FEATURES = 64
"""Numbers that a student makes of the robot's state, and of each frame besides the places of its features."""


def make_policy(algorithm: Algorithm, flat: Flat) -> Any:
    """Return the policy of an algorithm as a torch module on the CPU, with weights to be loaded.

    Raises:
        MissingDependency: torch or Stable-Baselines3 is not installed.
    """
    if isinstance(algorithm, Dagger):
        return make_student(algorithm, flat).eval()
    sb3, has_images = package_of("rl", "stable_baselines3"), isinstance(flat.observation_space, spaces.Dict)
    options = network_options(algorithm, has_images=has_images)
    kind = sb3.PPO.policy_aliases["MultiInputPolicy" if has_images else "MlpPolicy"]
    policy = kind(flat.observation_space, flat.action_space, lambda _: 0.0, **options)
    policy.set_training_mode(False)
    return policy


def mean_action(policy: Any) -> Callable[[Any], Any]:
    """Return the function from observations to a policy's mean actions, both as tensors with a leading axis.

    It acts without exploration, and without the distributions that the policy's own methods make on the way. The
    tensors are on the CPU, wherever the policy is.
    """
    if not hasattr(policy, "action_net"):
        return policy  # a student, which is that function

    def act(observation: Any) -> Any:
        device = policy.device
        there = (
            {name: one.to(device) for name, one in observation.items()}
            if isinstance(observation, dict)
            else observation.to(device)
        )
        features = policy.extract_features(there, policy.pi_features_extractor)
        return policy.action_net(policy.mlp_extractor.forward_actor(features)).cpu()

    return act


def network_options(algorithm: Ppo, *, has_images: bool) -> dict[str, Any]:
    """Return the options of Stable-Baselines3's policies for PPO."""
    nn = package_of("rl", "torch.nn")
    options: dict[str, Any] = {
        "net_arch": list(algorithm.network),
        "activation_fn": {"tanh": nn.Tanh, "relu": nn.ReLU}[algorithm.activation],
        "log_std_init": algorithm.log_std_init,
    }
    if algorithm.near_and_far and not has_images:
        options["features_extractor_class"] = _near_and_far()
    return options


@cache
def _near_and_far() -> Any:
    """Return the class of features with every number x twice, as 2 tanh(x / 2) and as tanh(4 x)."""
    torch = package_of("rl", "torch")
    base: Any = package_of("rl", "stable_baselines3.common.torch_layers").BaseFeaturesExtractor

    class NearAndFar(base):
        def __init__(self, space: spaces.Box) -> None:
            super().__init__(space, 2 * space.shape[0])

        def forward(self, observations: Any) -> Any:
            return torch.cat([2.0 * torch.tanh(0.5 * observations), torch.tanh(4.0 * observations)], -1)

    return NearAndFar


def make_student(algorithm: Dagger, flat: Flat) -> Any:
    """Return a torch module from flat observations, with a leading axis, to flat actions.

    Frames pass three convolutions. A spatial softmax says where in the frame their features are (Levine et al. 2016,
    arXiv:1504.00702), and one more convolution what they are.

    Raises:
        MissingDependency: torch is not installed.
    """
    torch = package_of("rl", "torch")
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
        """The whole policy; mean and spread of its numbers are part of its weights."""

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
            return self.normalised(observation) * self.action_spread + self.action_mean

        def normalised(self, observation: Any) -> Any:
            """Return the actions in units of their spread, as they are learned."""
            state = observation[STATE] if isinstance(space, spaces.Dict) else observation
            seen = [camera(observation[name]) for name, camera in self.cameras.items()]
            return self.head(torch.cat([*seen, self.state((state - self.state_mean) / self.state_spread)], 1))

        def targets(self, action: Any) -> Any:
            """Return actions in units of their spread."""
            return (action - self.action_mean) / self.action_spread

        def set_normalisation(self, states: Any, actions: Any) -> None:
            """Set mean and spread to those of NumPy arrays, a row per step."""
            for name, rows in (("state", states), ("action", actions)):
                rows = rows.astype(np.float64)
                getattr(self, f"{name}_mean").copy_(torch.from_numpy(rows.mean(0)))
                getattr(self, f"{name}_spread").copy_(torch.from_numpy(np.maximum(rows.std(0), LEAST_SPREAD)))

    # Convolutions on the CPU are about a third faster with channels last.
    return Student().to(memory_format=torch.channels_last)
