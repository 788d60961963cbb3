"""Imitation of a teacher, which says what to do in every state that the student, or the teacher itself, gets into."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from rcs.agents import agent_for
from rcs.envs.setup import Setup
from rcs.envs.spaces import FINGER_CONTACTS, IS_GRASPED, PRIVILEGED
from rcs.envs.step.state import EnvState
from rcs.envs.vector import VecEnv
from rcs.extras import package_of
from rcs.rl.flat import STATE, Flat
from rcs.rl.learner import Learner
from rcs.rl.networks import make_student
from rcs.rl.training import Dagger, Training

_HIDDEN = {"privileged": (PRIVILEGED,), "contacts": (FINGER_CONTACTS, IS_GRASPED)}
"""Keys that the teacher observes besides, by the setup's word for them."""
_EPISODES = 100
"""So many of the student's last episodes are counted."""
_ACTION = "action"


def teaching_setup(setup: Setup) -> Setup:
    """Return the setup of an environment in which a teacher observes everything."""
    return replace(setup, observe=(*setup.observe, *(word for word in _HIDDEN if word not in setup.observe)))


def student_flat(envs: VecEnv, setup: Setup) -> Flat:
    """Return the maps of a student, which observes what its setup says and no more.

    Args:
        envs: Copies of `teaching_setup(setup)`.
        setup: The student's.
    """
    hidden = {key for word, own in _HIDDEN.items() if word not in setup.observe for key in own}
    hidden |= {"xyzrpy", "frames"}  # the pose is there as `tquat`, frames are no part of the state
    space: Any = envs.single_observation_space
    return Flat(envs, keys=[key for key in space.spaces if key not in hidden])


class DaggerLearner(Learner):
    """Collects what a teacher would do, and fits a student to it.

    All observations stay in memory: two frames of 64 px are 25 kB a step, 40 000 steps 1 GB.
    """

    def __init__(self, training: Training, envs: VecEnv) -> None:
        """Make the student and start an episode in every copy.

        Args:
            training: The training, by `Dagger`.
            envs: Copies of its `teaching_setup`, made with `autoreset="SameStep"`.

        Raises:
            MissingDependency: torch is not installed.
            InvalidSetup: The teacher does not fit the environment, or is no agent.
            UnknownName: There is no agent of the teacher's name.
            CorruptCheckpoint: The teacher's checkpoint is damaged.
        """
        algorithm = training.algorithm
        assert isinstance(algorithm, Dagger)
        torch = self._torch = package_of("rl", "torch")
        self.training, self.envs, self._algorithm = training, envs, algorithm
        self.flat = student_flat(envs, training.setup)
        self._teacher = agent_for(envs, algorithm.teacher)  # pyright: ignore[reportArgumentType]  that acts in copies
        self._rng = np.random.default_rng(training.seed)
        torch.manual_seed(training.seed)
        self.policy = make_student(algorithm, self.flat)
        self._optimiser = torch.optim.AdamW(self.policy.parameters(), lr=algorithm.learning_rate, weight_decay=1e-4)
        copies, layout = training.copies, self.flat.layout
        rows = -(-training.steps // copies) + algorithm.n_steps
        self.replay = {
            STATE: np.zeros((rows, copies, layout.state_size), np.float32),
            _ACTION: np.zeros((rows, copies, layout.action_size), np.float32),
            **{image.name: np.zeros((rows, copies, *image.shape), np.uint8) for image in layout.images},
        }
        self._row = 0
        self._is_taught = np.ones(copies, np.bool_)
        self._ends: deque[bool] = deque(maxlen=_EPISODES)
        self._losses: list[float] = []
        self._observation, self._info = envs.reset(seed=[training.first_seed + copy for copy in range(copies)])
        self._teacher.reset(self._observation, self._info)

    @property
    def steps(self) -> int:
        """Environment steps so far, of all copies together."""
        return self._row * self.training.copies

    @property
    def _is_warm(self) -> bool:
        return self.steps >= min(self._algorithm.warm_up, self.training.steps)

    def advance(self) -> None:
        """Make the steps of one update, and the update."""
        was_warm = self._is_warm
        for _ in range(self._algorithm.n_steps):
            self._step()
        if not self._is_warm:
            return
        if not was_warm:
            seen = (self.replay[name][: self._row].reshape(self.steps, -1) for name in (STATE, _ACTION))
            self.policy.set_normalisation(*seen)
        progress = self.steps / self.training.steps
        rate = self._algorithm.learning_rate * 0.5 * (1.0 + np.cos(np.pi * np.clip(2.0 * progress - 1.0, 0.0, 1.0)))
        for group in self._optimiser.param_groups:
            group["lr"] = max(float(rate), 1e-3 * self._algorithm.learning_rate)
        for _ in range(self._algorithm.gradient_steps):
            self._fit()

    def _step(self) -> None:
        """Remember what the teacher would do, and do it, or what the student would."""
        flat = self.flat.observation(self._observation)
        action = self._teacher.act(self._observation, self._info)
        wanted = self.flat.action_vector(action)
        given = flat if isinstance(flat, dict) else {STATE: flat}
        for name, rows in {**given, _ACTION: wanted}.items():
            self.replay[name][self._row] = rows
        self._row += 1
        if not self._is_taught.all():
            torch = self._torch
            with torch.no_grad():
                tensors = {name: torch.from_numpy(self.replay[name][self._row - 1]) for name in given}
                own = self.policy(tensors if isinstance(flat, dict) else tensors[STATE]).numpy()
            action = self.flat.action(np.where(self._is_taught[:, None], wanted, own))
        self._observation, _, terminated, truncated, self._info = self.envs.step(action)
        if (is_over := terminated | truncated).any():
            if (success := self._info["final_info"].get("success")) is not None:
                self._ends.extend(success[is_over & ~self._is_taught].tolist())
            self._is_taught[is_over] = self._rng.random(int(is_over.sum())) < self._share()

    def _share(self) -> float:
        """Return the share of episodes that begin now in which the teacher acts."""
        fade = self._algorithm.fade
        if fade is None:
            return 1.0
        return max(0.0, 1.0 - self.steps / (fade * self.training.steps)) if fade else 0.0

    def _fit(self) -> None:
        """Make one gradient step."""
        torch = self._torch
        picked = self._rng.integers(0, self.steps, self._algorithm.batch_size)
        where = np.unravel_index(picked, (self._row, self.training.copies))
        batch = {name: torch.from_numpy(rows[where]) for name, rows in self.replay.items()}
        wanted = self.policy.targets(batch.pop(_ACTION))
        made = self.policy.normalised(batch if self.flat.layout.images else batch[STATE])
        loss = torch.nn.functional.smooth_l1_loss(made, wanted, beta=0.1)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self._optimiser.step()
        self._losses.append(loss.item())

    def figures(self) -> dict[str, float]:
        """Return the loss since the last call, the share of the teacher, and the student's success in training."""
        figures = {"train/teacher_share": self._share()}
        if self._losses:
            figures["train/loss"] = float(np.mean(self._losses))
            self._losses.clear()
        if self._ends:
            figures["rollout/success_rate"] = float(np.mean(self._ends))
        return figures

    def state(self) -> dict[str, Any]:
        """Return everything but weights and replay: optimiser, random numbers, running episodes."""
        return {
            "optimiser": self._optimiser.state_dict(),
            "row": self._row,
            "random": self._rng.bit_generator.state,
            "is_taught": self._is_taught,
            "ends": list(self._ends),
            "environment": vars(self.envs.get_state()),
        }

    def _load(self, weights: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        self.policy.load_state_dict(weights)
        self._optimiser.load_state_dict(state["optimiser"])
        self._rng.bit_generator.state = state["random"]
        self._row, self._is_taught[:] = state["row"], state["is_taught"]
        self._ends.extend(state["ends"])
        self._observation = self.envs.set_state(EnvState(**state["environment"]))
        self._info = {}
