"""Recipes: for each task the setup, the algorithm and its hyperparameters that learn it, by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, UnknownName

AlgorithmName = Literal["ppo", "sac"]
Schedule = Literal["constant", "linear"]
Activation = Literal["tanh", "relu"]


@dataclass(frozen=True, kw_only=True)
class Ppo:
    """Proximal policy optimisation (Schulman et al. 2017), as Stable-Baselines3 has it; the names are its own."""

    n_steps: int = 64
    """Steps of every copy between two updates."""
    batch_size: int = 1024
    """Steps per gradient step; `copies * n_steps` should be a multiple of it."""
    n_epochs: int = 8
    """How often an update goes through its steps."""
    learning_rate: float = 3e-4
    """Step size of Adam at the start."""
    schedule: Schedule = "linear"
    """Whether the step size stays, or falls to zero by the last step."""
    gae_lambda: float = 0.95
    """From 0, the value of the next state, to 1, the whole return (Schulman et al. 2016)."""
    clip_range: float = 0.2
    """How far the ratio of new to old probabilities counts."""
    ent_coef: float = 0.0
    """Weight of the entropy; more explores for longer."""
    vf_coef: float = 0.5
    """Weight of the loss of the value."""
    max_grad_norm: float = 0.5
    """Longer gradients are shortened to this length."""
    target_kl: float | None = 0.1
    """An update ends early beyond this Kullback-Leibler divergence; None for never."""
    log_std_init: float = 0.0
    """Logarithm of the actions' standard deviation at the start, in units of the flat action, -1 … 1."""
    network: tuple[int, ...] = (256, 256)
    """Neurons of the hidden layers, of the policy and of the value each."""
    activation: Activation = "tanh"
    """Of the hidden layers."""

    name: AlgorithmName = field(default="ppo", init=False)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        _check(self, whole=("n_steps", "batch_size", "n_epochs"), positive=("learning_rate", "clip_range"))
        _check(self, positive=("max_grad_norm",), unit=("gae_lambda",), finite=("ent_coef", "vf_coef", "log_std_init"))
        if self.target_kl is not None:
            _check(self, positive=("target_kl",))
        _check_network(self)


@dataclass(frozen=True, kw_only=True)
class Sac:
    """Soft actor-critic (Haarnoja et al. 2018), as Stable-Baselines3 has it; the names are its own."""

    batch_size: int = 256
    """Transitions per gradient step."""
    gradient_steps: int = 8
    """Gradient steps after every step of all copies."""
    learning_rate: float = 3e-4
    """Step size of Adam at the start."""
    schedule: Schedule = "constant"
    """Whether the step size stays, or falls to zero by the last step."""
    buffer_size: int = 1_000_000
    """How many transitions are remembered, of all copies together."""
    learning_starts: int = 5_000
    """Steps with random actions before the first update, of all copies together."""
    tau: float = 0.005
    """Share of the new weights that the target network takes over in each gradient step."""
    ent_coef: float | None = None
    """Weight of the entropy; None to learn it."""
    network: tuple[int, ...] = (256, 256)
    """Neurons of the hidden layers, of the policy and of each critic."""
    activation: Activation = "relu"
    """Of the hidden layers."""

    name: AlgorithmName = field(default="sac", init=False)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        _check(self, whole=("batch_size", "gradient_steps", "buffer_size"), positive=("learning_rate",))
        _check(self, unit=("tau",), natural=("learning_starts",))
        if self.ent_coef is not None:
            _check(self, positive=("ent_coef",))
        _check_network(self)


Algorithm = Ppo | Sac
"""What learns, with its hyperparameters. The discount is that of the setup, which the reward is made for."""

ALGORITHMS: dict[str, type[Ppo] | type[Sac]] = {"ppo": Ppo, "sac": Sac}


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
        _check(self, whole=("copies", "steps"))

    def on(self, robot: str) -> Recipe:
        """Return the recipe for another robot."""
        return replace(self, setup=replace(self.setup, robot=robot))


def algorithm_to_json(algorithm: Algorithm) -> dict[str, Any]:
    """Return an algorithm as JSON values."""
    values = dataclasses.asdict(algorithm)
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def algorithm_from_json(values: Mapping[str, Any]) -> Algorithm:
    """Return the algorithm that `algorithm_to_json` wrote.

    Raises:
        InvalidSetup: A field is unknown or out of range.
        UnknownName: There is no such algorithm.
    """
    kind = values.get("name")
    if kind not in ALGORITHMS:
        raise UnknownName("algorithm", str(kind), ALGORITHMS)
    given = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    own = {one.name for one in dataclasses.fields(ALGORITHMS[kind])}
    if unknown := sorted(set(given) - own):
        raise InvalidSetup(f"{kind} has no fields {unknown}; valid: {', '.join(sorted(own - {'name'}))}.")
    del given["name"]
    return ALGORITHMS[kind](**given)


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


def _check(
    record: Any,
    *,
    whole: tuple[str, ...] = (),
    natural: tuple[str, ...] = (),
    positive: tuple[str, ...] = (),
    unit: tuple[str, ...] = (),
    finite: tuple[str, ...] = (),
) -> None:
    for names, is_valid, valid in (
        (whole, lambda value: _is_whole(value) and value >= 1, "a whole number from 1"),
        (natural, lambda value: _is_whole(value) and value >= 0, "a whole number from 0"),
        (positive, lambda value: _is_number(value) and value > 0, "a number above 0"),
        (unit, lambda value: _is_number(value) and 0 <= value <= 1, "a number from 0 to 1"),
        (finite, _is_number, "a number"),
    ):
        for name in names:
            if not is_valid(getattr(record, name)):
                raise InvalidSetup(f"{name} is {getattr(record, name)!r}; valid is {valid}.")


def _check_network(algorithm: Ppo | Sac) -> None:
    is_valid = isinstance(algorithm.network, tuple) and all(_is_whole(n) and n >= 1 for n in algorithm.network)
    if not is_valid:
        raise InvalidSetup(f"network is {algorithm.network!r}; valid is a tuple of whole numbers from 1.")
    for name, choices in (("schedule", Schedule), ("activation", Activation)):
        if getattr(algorithm, name) not in get_args(choices):
            valid = ", ".join(map(repr, get_args(choices)))
            raise InvalidSetup(f"{name} is {getattr(algorithm, name)!r}; valid: {valid}.")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")
