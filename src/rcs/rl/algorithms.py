"""Algorithms that learn, with their hyperparameters, as frozen records that are stored with checkpoints."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from rcs_data.record import Meta, Natural, Positive, Record, Share, Whole

AlgorithmName = Literal["ppo", "sac", "dagger", "bc"]
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

    name: ClassVar[AlgorithmName] = "ppo"


class Sac(Record):
    """Soft actor-critic (Haarnoja et al. 2018) of Stable-Baselines3, with its names."""

    batch_size: Whole = 256
    """Transitions per gradient step."""
    gradient_steps: Whole = 8
    """Gradient steps after every step of all copies."""
    learning_rate: Positive = 3e-4
    """Step size of Adam at the start."""
    schedule: Schedule = "constant"
    """Keep the step size, or let it fall to zero by the last step."""
    buffer_size: Whole = 1_000_000
    """Capacity of the replay in transitions, of all copies together."""
    learning_starts: Natural = 5_000
    """Steps with random actions before the first update, of all copies together."""
    tau: Share = 0.005
    """Share of the new weights that the target network takes over in each gradient step."""
    ent_coef: Positive | None = None
    """Weight of the entropy; None to learn it."""
    network: tuple[Whole, ...] = (256, 256)
    """Neurons of the hidden layers, of the policy and of each critic."""
    activation: Activation = "relu"
    """Activation of the hidden layers."""

    name: ClassVar[AlgorithmName] = "sac"


class Dagger(Record):
    """Dataset aggregation (Ross et al. 2011): a student learns by regression what a teacher would do in its place.

    The teacher sees everything, with `privileged` and `contacts`; the student sees what the setup observes.
    """

    teacher: str = "PickTeacher"
    """The teacher: an agent without memory, by its name or as `module:Class`, or the folder of a checkpoint."""
    fade: Annotated[float, Meta(ge=0, le=1)] | None = 0.15
    """Over this share of all steps, the share of episodes in which the teacher acts falls from 1 to 0; None for all."""
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

    name: ClassVar[AlgorithmName] = "dagger"
    schedule: ClassVar[Schedule] = "linear"
    """The step size falls to zero by the last step, though not in a line."""


class Bc(Dagger):
    """Behaviour cloning: the teacher acts all the time, and the student never gets into states of its own making."""

    fade: None = None
    """The teacher acts in all episodes."""

    name: ClassVar[AlgorithmName] = "bc"


Algorithm = Ppo | Sac | Dagger
"""An algorithm with its hyperparameters. The discount is that of the setup, for which the reward is made."""

ALGORITHMS: dict[AlgorithmName, type[Ppo] | type[Sac] | type[Dagger]] = {
    kind.name: kind for kind in (Ppo, Sac, Dagger, Bc)
}
"""Algorithms by name."""
