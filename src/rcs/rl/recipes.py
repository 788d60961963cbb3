"""Recipes: for each task the environment, the algorithm and the figures that learn it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rcs.envs.setup import Setup
from rcs.errors import UnknownName
from rcs.rl.algorithms import ALGORITHMS, Algorithm, AlgorithmName, Ppo, Sac, check_fields


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What learns a task: an environment, how many copies of it, an algorithm and how long.

    Example:
        >>> from dataclasses import replace
        >>> from rcs.rl.recipes import recipe_for
        >>> recipe = recipe_for("PickCuboid", "ppo")
        >>> faster = replace(recipe, algorithm=replace(recipe.algorithm, learning_rate=1e-3))
    """

    setup: Setup
    """The environment. `rcs train` puts in the robot, and whatever else its options say."""
    copies: int
    """Copies of the environment that are stepped together."""
    steps: int
    """Environment steps of the whole training, of all copies together."""
    algorithm: Algorithm
    """What learns, with its hyperparameters."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: One is out of range.
        """
        check_fields(self, whole=("copies", "steps"))

    def on(self, robot: str) -> Recipe:
        """Return the recipe for another robot."""
        return replace(self, setup=replace(self.setup, robot=robot))


_STATE = Setup(
    control="xyzrpy",
    relative="last_step",
    frequency=10.0,
    max_episode_steps=75,
    observe=("privileged", "contacts"),
    collision_reaction=False,
    reward="dense",
    discount=0.97,
)
"""The robot's proprioception and the objects' poses; ten decisions a second, and 7.5 s for an episode."""

RECIPES: dict[tuple[str, AlgorithmName], Recipe] = {
    ("PickCuboid", "ppo"): Recipe(setup=_STATE, copies=32, steps=1_500_000, algorithm=Ppo()),
    ("PickCuboid", "sac"): Recipe(setup=_STATE, copies=8, steps=200_000, algorithm=Sac()),
}
"""Recipes by task and algorithm."""


def recipe_for(task: str, algorithm: AlgorithmName = "ppo", *, cameras: tuple[str, ...] = ()) -> Recipe:
    """Return the recipe for a task; one that has none of its own gets that of PickCuboid.

    Args:
        task: Name of the task, or `module:Class`.
        algorithm: What learns.
        cameras: Cameras for a policy that sees; without any, it is told where the objects are.

    Raises:
        UnknownName: There is no such algorithm.
    """
    if algorithm not in ALGORITHMS:
        raise UnknownName("algorithm", str(algorithm), ALGORITHMS)
    recipe = RECIPES.get((task, algorithm), RECIPES["PickCuboid", algorithm])
    setup = replace(recipe.setup, task=task)
    if cameras:
        setup = replace(setup, cameras=cameras, image_size=(84, 84), observe=())
        recipe = replace(recipe, steps=4 * recipe.steps)
        if isinstance(recipe.algorithm, Sac):  # frames are large: 2 cameras of 84 px and their successors are 85 kB
            recipe = replace(recipe, algorithm=replace(recipe.algorithm, buffer_size=50_000))
    return replace(recipe, setup=setup)
