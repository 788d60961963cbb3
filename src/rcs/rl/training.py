"""A training: everything that decides what a run learns, as one frozen record that is stored with its checkpoints."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from rcs_data.options import Meta, Natural, Positive, Record, Share, Whole

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.recorded_setup import require_trusted

AlgorithmName = Literal["ppo", "dagger"]
Schedule = Literal["constant", "linear"]
Activation = Literal["tanh", "relu"]


class Ppo(Record):
    """Proximal policy optimisation (Schulman et al. 2017) of Stable-Baselines3, with its names."""

    n_steps: Whole = 64
    """Steps of every copy between two updates."""
    batch_size: Whole = 1024
    """Steps per gradient step; fewer where `copies * n_steps` is no multiple of it, so that all have as many."""
    n_epochs: Whole = 8
    """Passes of an update through its steps."""
    learning_rate: Positive = 3e-4
    """Step size of Adam at the start."""
    schedule: Schedule = "linear"
    """Keep the step size, or let it fall to zero by the last step."""
    gae_lambda: Share = 0.95
    """From 0, the value of the next state, to 1, the whole return (Schulman et al. 2016)."""
    clip_range: Positive = 0.2
    """Range around 1 in which the ratio of new to old probabilities counts."""
    ent_coef: float = 0.0
    """Weight of the entropy; more explores for longer."""
    vf_coef: float = 0.5
    """Weight of the loss of the value."""
    max_grad_norm: Positive = 0.5
    """Longer gradients are shortened to this length."""
    target_kl: Positive | None = 0.1
    """An update ends early beyond this Kullback-Leibler divergence; None for never."""
    log_std_init: float = 0.0
    """Logarithm of the actions' standard deviation at the start, in units of the flat action, -1 … 1."""
    network: tuple[Whole, ...] = (256, 256)
    """Neurons of the hidden layers, of the policy and of the value each."""
    activation: Activation = "tanh"
    """Activation of the hidden layers."""
    near_and_far: bool = False
    """Show the network every number twice, coarsely and finely: it finds sooner both the way to an object and how to
    meet it to the millimetre. Only without images."""
    reward_scale: Positive = 1.0
    """Factor on the rewards that the learner sees: returns of about 1 are learned best."""
    name: Literal["ppo"] = "ppo"
    """Its name, by which files know it."""


class Dagger(Record):
    """Dataset aggregation (Ross et al. 2011): a student learns by regression what a teacher would do in its place.

    The teacher sees everything, with `privileged` and `contacts`; the student sees what the setup observes.
    """

    teacher: str = "PickTeacher"
    """The teacher: an agent that acts by the observation alone, without memory and info; by its name or as
    `module:Class`, or the folder of a checkpoint."""
    fade: Annotated[float, Meta(ge=0, le=1)] | None = 0.15
    """Over this share of all steps, the share of episodes in which the teacher acts falls from 1 to 0. With None it
    acts in all: behaviour cloning, in which the student never gets into states of its own."""
    n_steps: Whole = 16
    """Steps of every copy between two updates."""
    warm_up: Whole = 2_048
    """Steps before the first update, of all copies together; mean and spread of all numbers are those of these
    steps."""
    batch_size: Whole = 128
    """Steps per gradient step, from all that were seen."""
    gradient_steps: Whole = 100
    """Gradient steps of an update."""
    learning_rate: Positive = 1e-3
    """Step size of Adam; from the middle of the training on it falls to zero as a cosine."""
    channels: tuple[Whole, Whole, Whole] = (8, 16, 32)
    """Channels of the three convolutions of each camera."""
    network: tuple[Whole, ...] = (256, 256)
    """Neurons of the hidden layers."""
    name: Literal["dagger"] = "dagger"
    """Its name, by which files know it."""

    schedule: ClassVar[Schedule] = "linear"
    """The step size falls to zero by the last step, though not in a line."""


Algorithm = Ppo | Dagger
"""An algorithm with its hyperparameters. The discount is that of the setup, for which the reward is made."""


VERSION = 3
"""Raised when what is stored comes to mean something else."""

# Each kind of episode has its own range of seeds, so that none is seen by two of them.
_TRAINING_SEEDS = 1 << 62
_SELECTION_SEEDS = 1 << 61
_MOST_COPIES = 1 << 20
_MOST_SEEDS = 1 << 40


class Course(Record):
    """The course of a training, whatever is learned."""

    seed: Annotated[int, Meta(ge=0, lt=_MOST_SEEDS)] = 0
    """Seed of the weights, the episodes and the exploration."""
    evaluate_every: Natural = 0
    """Steps between two evaluations; 0 for a twentieth of all."""
    episodes: Natural = 50
    """Episodes of an evaluation, none of which training sees; 0 for no evaluations."""
    checkpoint_every: Natural = 0
    """Steps between two checkpoints; 0 for one at every evaluation. Every evaluation has one."""
    device: str = "cpu"
    """Device of the networks, as torch names it: `cpu`, `cuda`."""
    torch_threads: Natural = 0
    """Threads of torch on the CPU; 0 for one, or for one per CPU with cameras. Sums of another number differ in their
    last bits."""


class Training(Course):
    """A training. The same record gives the same weights, bit for bit, on the same machine.

    Examples:
        >>> from dataclasses import replace
        >>> from rcs.rl import recipe_for
        >>> training = recipe_for("PickCuboid", "ppo")
        >>> faster = replace(training, algorithm=replace(training.algorithm, learning_rate=1e-3))
    """

    setup: Setup
    """The environment."""
    copies: Annotated[int, Meta(ge=1, lt=_MOST_COPIES)]
    """Copies of the environment that are stepped together."""
    steps: Whole
    """Environment steps of the whole training, of all copies together."""
    algorithm: Algorithm
    """The algorithm that learns, with its hyperparameters."""
    evaluation_steps: Natural = 0
    """An episode of an evaluation is truncated after this many steps; 0 for as many as in training. Short episodes
    teach sooner, for they begin more often, and a policy may take longer where it is judged."""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range, or the setup has no simulated time.
        """
        super().__post_init__()
        if self.setup.stepping == "realtime":
            raise InvalidSetup("stepping is 'realtime'; training has no wall clock: use 'async'.")

    @property
    def evaluation_setup(self) -> Setup:
        """The environment in which the policy is judged."""
        return replace(self.setup, max_episode_steps=self.evaluation_steps) if self.evaluation_steps else self.setup

    @property
    def first_seed(self) -> int:
        """Seed of the first copy; the others follow."""
        return _TRAINING_SEEDS + self.seed * _MOST_COPIES

    @property
    def first_selection_seed(self) -> int:
        """Seed of the first episode of each evaluation, on which checkpoints are compared; the others follow.

        `rcs eval` uses seeds below 2**32, so the episodes that choose a checkpoint are none of those that judge it.
        """
        return _SELECTION_SEEDS + self.seed * _MOST_COPIES

    @classmethod
    def from_json(cls, values: Mapping[str, Any], *, trust: Collection[str] = ()) -> Training:
        """Return the record that `to_json` wrote.

        Args:
            values: JSON values, from anywhere.
            trust: Modules that may be imported because the setup names a class of theirs.

        Raises:
            InvalidSetup: A field is missing, unknown or out of range, or a class of a module is named that is neither
                imported nor trusted.
        """
        require_trusted(values.get("setup"), "The setup of the training", trust)
        return super().from_json(values)

    def difference(self, other: Training) -> list[str]:
        """Return in words where another record differs, a line each; threads of torch that are 0 agree with any.

        Hyperparameters of another algorithm are left out: most have no counterpart.
        """
        if self.algorithm.name != other.algorithm.name:
            return [f"the algorithm is {other.algorithm.name!r}, not {self.algorithm.name!r}"]
        mine, theirs = _flat(self.to_json()), _flat(other.to_json())
        either = 0 in (self.torch_threads, other.torch_threads)
        return [
            f"{name} is {theirs.get(name)!r}, not {mine.get(name)!r}"
            for name in sorted({*mine, *theirs})
            if mine.get(name) != theirs.get(name) and not (name == "torch_threads" and either)
        ]


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat.update(_flat(value) if isinstance(value, dict) and name != "task_options" else {name: value})
    return flat
