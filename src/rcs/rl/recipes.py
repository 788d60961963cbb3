"""Recipes: for each task the training that learns it."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.errors import UnknownName
from rcs.rl.training import AlgorithmName, Dagger, Ppo, Training

RATE = 10.0
"""Decisions per second [Hz]. Nearly all that a step costs is physics, and from the same simulated time less was learned
with 30 Hz than with 10 Hz."""

DISCOUNT = 0.98
"""Worth of a reward a tenth of a second later. With 0.96 it hardly paid to let go of a cuboid that is held but
jammed, and to grasp it anew: policies stayed there."""
_JUDGED = 10.0
"""Least duration of an episode of an evaluation [s]: the usual one of a `Setup`, 300 steps at 30 Hz."""


def _setup(task: str, seconds: float) -> Setup:
    """Return the environment of a policy that observes the poses of the objects."""
    return Setup(
        task=task,
        control="xyzrpy",
        relative="last_step",
        # Translation, yaw and gripper are what these tasks need. An arm is up to 20 cm behind its target, and
        # overshoots when that is unknown: a simple controller picked 30 of 40 cuboids, and 40 with the target.
        # The target of an arm that presses on the table must not sink in: a policy that acts by chance would never
        # get it out again, and hold an object for ever without having lifted it once.
        layers=("BoundLead", "KeepTilt", "ObserveTarget"),
        frequency=RATE,
        max_episode_steps=round(seconds * RATE),
        observe=("privileged", "contacts"),
        collision_reaction=False,
        reward="dense",
        discount=DISCOUNT,
        # Twice as fast as 2 ms, and what is learned holds with 2 ms, too: 288 of 300 after 300 000 steps.
        physics_step=0.004,
    )


_SEEN = Setup(
    task="PickCuboid",
    control="joints",
    relative="last_step",
    layers=("ObserveTarget",),  # from which its teacher counts, too
    cameras=Cameras(names=("wrist", "side"), image_size=64),
    frequency=RATE,
    max_episode_steps=75,
    collision_reaction=False,
    physics_step=0.004,
)
"""The environment of a policy with cameras, which observes its own joints and two cameras."""


def _ppo(task: str, *, seconds: float, steps: int) -> Training:
    """Return the recipe of a task of which an episode lasts some seconds: each update sees all of it."""
    algorithm = Ppo(
        n_steps=round(seconds * RATE),
        batch_size=512,
        learning_rate=5e-4,
        gae_lambda=0.9,
        vf_coef=0.1,
        log_std_init=-0.5,
        near_and_far=True,
        reward_scale=0.25,
    )
    judged = round(max(seconds, _JUDGED) * RATE)
    return Training(setup=_setup(task, seconds), copies=32, steps=steps, algorithm=algorithm, evaluation_steps=judged)


RECIPES: dict[tuple[str, AlgorithmName], Training] = {
    ("PickCuboid", "ppo"): _ppo("PickCuboid", seconds=6.0, steps=500_000),
    ("Push", "ppo"): _ppo("Push", seconds=8.0, steps=1_000_000),
    ("Place", "ppo"): _ppo("Place", seconds=9.0, steps=1_500_000),
    ("PickCuboid", "dagger"): Training(setup=_SEEN, copies=32, steps=20_480, algorithm=Dagger()),
    ("Place", "dagger"): Training(
        setup=replace(_SEEN, task="Place", cameras=(), observe=("privileged", "contacts"), max_episode_steps=90),
        copies=32,
        steps=20_480,
        algorithm=Dagger(teacher="PlaceTeacher", gradient_steps=300),
    ),
}
"""Recipes by task and algorithm. Nothing in them depends on the robot; cameras are those of the FR3's lab."""


def recipe_for(task: str, algorithm: AlgorithmName = "ppo", *, cameras: tuple[str, ...] = ()) -> Training:
    """Return the recipe for a task; one that has none of its own gets that of PickCuboid.

    Args:
        task: Name of the task, or `module:Class`.
        algorithm: The algorithm.
        cameras: Cameras of the policy; without any, it observes the poses of the objects.

    Raises:
        UnknownName: There is no such algorithm.
    """
    if algorithm not in get_args(AlgorithmName):
        raise UnknownName("algorithm", str(algorithm), get_args(AlgorithmName))
    recipe = RECIPES.get((task, algorithm), RECIPES["PickCuboid", algorithm])
    setup = replace(recipe.setup, task=task)
    if cameras and isinstance(recipe.algorithm, Dagger):
        setup = replace(setup, cameras=replace(_SEEN.cameras, names=cameras), observe=())
    elif cameras:
        setup = replace(setup, cameras=Cameras(names=cameras, image_size=84, pixels=True), observe=())
        setup = replace(setup, control="joints", layers=())
        recipe = replace(recipe, steps=4 * recipe.steps)
    return replace(recipe, setup=setup)
