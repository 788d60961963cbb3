"""Soft actor-critic with prior data: who acts at first, what a batch is made of, and what the critics do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.rl.algorithms import Rlpd
from rcs.rl.recipes import recipe_for

pytestmark = pytest.mark.extras


@pytest.fixture
def learner(small: Any) -> Any:
    from rcs.rl.learners import copies_for, flat_for, learner_for

    training = small.training("rlpd")
    envs = copies_for(training, threads=1)
    yield learner_for(training, envs, flat_for(training, envs))
    envs.close()


def test_the_teacher_acts_at_first_and_the_learner_from_then_on(learner: Any) -> None:
    from rcs.rl.teaching import teacher_for

    envs = learner.envs
    teacher = teacher_for(envs.envs, "PickTeacher")
    wanted = []
    for _ in range(20):
        wanted.append(envs.flat.action_vector(teacher.act(envs.observation, {})))
        learner.advance()
    taught = learner.model.replay_buffer.actions[:20]
    differs = np.abs(taught - np.array(wanted)).max(axis=(1, 2))
    assert (differs[:15] == 0.0).all()  # 30 steps of two copies
    assert (differs[15:] > 0.0).all()


def test_half_of_each_batch_is_the_teachers(learner: Any) -> None:
    for _ in range(40):
        learner.advance()
    replay = learner.model.replay_buffer
    replay.rewards[:15], replay.rewards[15:] = 1.0, 0.0
    rewards = [replay.sample(8).rewards.numpy()[:, 0] for _ in range(50)]
    assert all(drawn.sum() == 4 for drawn in rewards)


def test_values_of_actions_far_from_all_that_was_tried_stay_bounded(learner: Any) -> None:
    """What layer normalisation is for (Ball et al. 2023, section 4.2)."""
    import torch

    critic, size = learner.policy.critic, learner.envs.observation_space.shape[0]
    torch.manual_seed(0)
    near = torch.randn(64, size)
    actions = torch.zeros(64, learner.envs.action_space.shape[0])
    with torch.no_grad():
        spread = [torch.stack(critic(scale * near, actions)).abs().max().item() for scale in (1.0, 1000.0)]
    assert spread[1] < 10.0 * spread[0]


def test_an_environment_without_what_the_teacher_sees_has_it_for_the_teacher_alone(small: Any) -> None:
    from rcs.rl.learners import copies_for, flat_for

    training = small.training("rlpd")
    training = replace(training, setup=replace(training.setup, observe=()))
    envs = copies_for(training, threads=1)
    names = {entry.path[0] for entry in flat_for(training, envs).layout.state}
    envs.close()
    assert "privileged" not in names and "joints" in names


def test_a_memory_that_would_forget_the_teacher_is_refused(small: Any) -> None:
    with pytest.raises(InvalidSetup, match="forgets nothing"):
        small.training("rlpd", algorithm=Rlpd(learning_starts=30, buffer_size=100))
    with pytest.raises(InvalidSetup, match="dagger"):
        recipe_for("PickCuboid", "rlpd", cameras=("wrist",))
