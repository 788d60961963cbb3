"""Soft actor-critic with prior data, of Stable-Baselines3's parts: a teacher begins, and is never forgotten."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.rl.packages import package


@cache
def rlpd_model() -> Any:
    """Return the class of learners: `SAC` in whose first steps its attribute `teach` acts, in the place of chance.

    Raises:
        MissingDependency: Stable-Baselines3 is not installed.
    """
    base: Any = package("stable_baselines3").SAC

    class Rlpd(base):
        policy_aliases = {name: rlpd_policy(name) for name in ("MlpPolicy", "MultiInputPolicy")}  # noqa: RUF012
        teach: Callable[[], NDArray[np.float32]]
        """Returns the flat actions of the teacher in the present state of all copies, (copies, n)."""

        def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> Any:
            if self.num_timesteps >= learning_starts:
                return super()._sample_action(learning_starts, action_noise, n_envs)
            actions = self.teach()
            return actions, actions

    return Rlpd


@cache
def rlpd_policy(name: str) -> Any:
    """Return the class of policies whose critics normalise each hidden layer (Ball et al. 2023, section 4.2).

    Args:
        name: Stable-Baselines3's name of the policy.

    Raises:
        MissingDependency: Stable-Baselines3 is not installed.
    """
    nn = package("torch.nn")
    base: Any = package("stable_baselines3").SAC.policy_aliases[name]

    class Normed(base):
        def make_critic(self, features_extractor: Any = None) -> Any:
            critic = super().make_critic(features_extractor)
            for network in critic.q_networks:
                hidden = [index for index, part in enumerate(network) if isinstance(part, nn.Linear)][:-1]
                for index in reversed(hidden):
                    network.insert(index + 1, nn.LayerNorm(network[index].out_features))
            return critic.to(self.device)

    return Normed


@cache
def rlpd_replay(*, has_images: bool) -> Any:
    """Return the class of replays of which the first rows are a teacher's, and half of each sample.

    Its argument `teacher_rows` says how many rows these are; each has a step of every copy.

    Raises:
        MissingDependency: Stable-Baselines3 is not installed.
    """
    buffers = package("stable_baselines3.common.buffers")
    base: Any = buffers.DictReplayBuffer if has_images else buffers.ReplayBuffer

    class Halves(base):
        def __init__(self, *args: Any, teacher_rows: int, **options: Any) -> None:
            super().__init__(*args, **options)
            self._teacher_rows = teacher_rows

        def sample(self, batch_size: int, env: Any = None) -> Any:
            end = self.buffer_size if self.full else self.pos
            taught = batch_size // 2 if end > self._teacher_rows else batch_size
            rows = np.random.randint(0, min(self._teacher_rows, end), taught)
            own = np.random.randint(self._teacher_rows, max(end, self._teacher_rows + 1), batch_size - taught)
            return self._get_samples(np.concatenate([rows, own]), env=env)

    return Halves
