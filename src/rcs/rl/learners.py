"""Which learner a training has, and the copies and vectors that it learns with."""

from __future__ import annotations

from rcs.envs.vector import VecEnv
from rcs.rl.algorithms import Dagger, has_teacher
from rcs.rl.flat import Flat
from rcs.rl.learner import Learner
from rcs.rl.networks import reward_scale
from rcs.rl.sb3 import Sb3VecEnv
from rcs.rl.teaching import TaughtLearner, student_flat, teaching_setup
from rcs.rl.training import Training
from rcs.setups.make import make_vec


def copies_for(training: Training, *, threads: int = 0) -> VecEnv:
    """Return copies of the environment to learn in: where there is a teacher, with what it observes besides.

    Args:
        training: What is learned.
        threads: Threads for physics and drawing, 0 for one per CPU.
    """
    setup = teaching_setup(training.setup) if has_teacher(training.algorithm) else training.setup
    return make_vec(setup, copies=training.copies, threads=threads, autoreset="SameStep")


def flat_for(training: Training, envs: VecEnv) -> Flat:
    """Return the maps of the policy that is learned in copies of an environment."""
    return student_flat(envs, training.setup) if has_teacher(training.algorithm) else Flat(envs)


def learner_for(training: Training, envs: VecEnv, flat: Flat) -> Learner | TaughtLearner:
    """Return the learner, and start an episode in every copy.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The algorithm does not fit the environment.
    """
    if isinstance(training.algorithm, Dagger):
        return TaughtLearner(training, envs, flat)
    return Learner(training, Sb3VecEnv(envs, flat, reward_scale=reward_scale(training)))
