"""Algorithms that learn, with their hyperparameters, as frozen records that are stored with checkpoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, TypeGuard, get_args

from rcs.errors import InvalidSetup, UnknownName, require_fields

AlgorithmName = Literal["ppo", "sac", "rlpd", "dagger", "bc"]
Schedule = Literal["constant", "linear"]
Activation = Literal["tanh", "relu"]


@dataclass(frozen=True, kw_only=True)
class Ppo:
    """Proximal policy optimisation (Schulman et al. 2017), as Stable-Baselines3 has it; the names are its own."""

    n_steps: int = 64
    """Steps of every copy between two updates."""
    batch_size: int = 1024
    """Steps per gradient step; fewer where `copies * n_steps` is no multiple of it, so that all have as many."""
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
    near_and_far: bool = False
    """Whether the network is told every number twice, coarsely and finely: then it finds sooner both the way to an
    object and how to meet it to the millimetre. Only without images."""
    reward_scale: float = 1.0
    """Factor on the rewards that the learner sees: returns of about 1 are learned best."""

    name: AlgorithmName = field(default="ppo", init=False)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        check_fields(self, whole=("n_steps", "batch_size", "n_epochs"), positive=("learning_rate", "clip_range"))
        check_fields(self, positive=("reward_scale",))
        check_fields(
            self, positive=("max_grad_norm",), unit=("gae_lambda",), finite=("ent_coef", "vf_coef", "log_std_init")
        )
        if self.target_kl is not None:
            check_fields(self, positive=("target_kl",))
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
        check_fields(self, whole=("batch_size", "gradient_steps", "buffer_size"), positive=("learning_rate",))
        check_fields(self, unit=("tau",), natural=("learning_starts",))
        if self.ent_coef is not None:
            check_fields(self, positive=("ent_coef",))
        _check_network(self)


@dataclass(frozen=True, kw_only=True)
class Rlpd(Sac):
    """Reinforcement learning with prior data (Ball et al. 2023, arXiv:2302.02948): SAC that begins with demonstrations.

    At first a teacher acts, in the place of chance. Of every batch, half are steps of the teacher and half the
    learner's own, and the critics have layer normalisation, so that they do not overrate what nobody has tried. The
    paper has ten critics and twenty gradient steps per step; here they are two and as many as `gradient_steps` says.
    """

    teacher: str = "PickTeacher"
    """Who acts at first: an agent that remembers nothing, by its name or as `module:Class`, or the folder of a
    checkpoint."""
    learning_starts: int = 6_400
    """Steps of the teacher before the first update, of all copies together, none of which is forgotten."""

    name: AlgorithmName = field(default="rlpd", init=False)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        super().__post_init__()
        check_fields(self, whole=("learning_starts",))
        _check_teacher(self.teacher)


@dataclass(frozen=True, kw_only=True)
class Dagger:
    """Dataset aggregation (Ross et al. 2011): a student learns by regression what a teacher would do where it gets to.

    The teacher sees everything, with `privileged` and `contacts`; the student sees what the setup observes.
    """

    teacher: str = "PickTeacher"
    """Who says what to do: an agent that remembers nothing, by its name or as `module:Class`, or the folder of a
    checkpoint."""
    fade: float | None = 0.15
    """Over this share of all steps, the share of episodes in which the teacher acts falls from 1 to 0; None for all."""
    n_steps: int = 16
    """Steps of every copy between two updates."""
    warm_up: int = 2_048
    """Steps before the first update, of all copies together; they decide what is normal in the numbers."""
    batch_size: int = 128
    """Steps per gradient step, from all that were seen."""
    gradient_steps: int = 100
    """Gradient steps of an update."""
    learning_rate: float = 1e-3
    """Step size of Adam; from the middle of the training on it falls to zero as a cosine."""
    channels: tuple[int, int, int] = (8, 16, 32)
    """Of the three convolutions of each camera."""
    network: tuple[int, ...] = (256, 256)
    """Neurons of the hidden layers."""

    name: AlgorithmName = field(default="dagger", init=False)
    schedule: ClassVar[Schedule] = "linear"
    """The step size falls to zero by the last step, though not in a line."""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        check_fields(self, whole=("n_steps", "batch_size", "gradient_steps", "warm_up"), positive=("learning_rate",))
        if self.fade is not None:
            check_fields(self, unit=("fade",))
        _check_teacher(self.teacher)
        if len(self.channels) != 3 or not all(_is_whole(n) and n >= 1 for n in self.channels):
            raise InvalidSetup(f"channels is {self.channels!r}; valid are three whole numbers from 1.")
        _check_layers(self.network)


@dataclass(frozen=True, kw_only=True)
class Bc(Dagger):
    """Behaviour cloning: the teacher acts all the time, and the student never gets into states of its own making."""

    fade: None = None
    """The teacher acts in all episodes."""

    name: AlgorithmName = field(default="bc", init=False)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        super().__post_init__()
        if self.fade is not None:
            raise InvalidSetup(f"fade is {self.fade!r}; in behaviour cloning it is None. Use 'dagger'.")


Algorithm = Ppo | Sac | Dagger
"""What learns, with its hyperparameters. The discount is that of the setup, which the reward is made for."""

ALGORITHMS: dict[str, type[Ppo] | type[Sac] | type[Dagger]] = {
    "ppo": Ppo,
    "sac": Sac,
    "rlpd": Rlpd,
    "dagger": Dagger,
    "bc": Bc,
}


def has_teacher(algorithm: Algorithm) -> TypeGuard[Rlpd | Dagger]:
    """Return whether an algorithm learns from somebody who sees everything."""
    return isinstance(algorithm, Rlpd | Dagger)


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
    given: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    require_fields(f"field of {kind}", given, (one.name for one in dataclasses.fields(ALGORITHMS[kind])))
    del given["name"]
    return ALGORITHMS[kind](**given)


def check_fields(
    record: Any,
    *,
    whole: tuple[str, ...] = (),
    natural: tuple[str, ...] = (),
    positive: tuple[str, ...] = (),
    unit: tuple[str, ...] = (),
    finite: tuple[str, ...] = (),
) -> None:
    """Check numbers of a record.

    Args:
        record: The record.
        whole: Fields that are whole numbers from 1.
        natural: Fields that are whole numbers from 0.
        positive: Fields that are above 0.
        unit: Fields that are from 0 to 1.
        finite: Fields that are finite numbers.

    Raises:
        InvalidSetup: One is not.
    """
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


def _check_layers(network: Any) -> None:
    if not (isinstance(network, tuple) and all(_is_whole(n) and n >= 1 for n in network)):
        raise InvalidSetup(f"network is {network!r}; valid is a tuple of whole numbers from 1.")


def _check_teacher(teacher: Any) -> None:
    if not isinstance(teacher, str):
        raise InvalidSetup(f"teacher is {teacher!r}; valid is the name of an agent, or a checkpoint's folder.")


def _check_network(algorithm: Ppo | Sac) -> None:
    _check_layers(algorithm.network)
    for name, choices in (("schedule", Schedule), ("activation", Activation)):
        if getattr(algorithm, name) not in get_args(choices):
            valid = ", ".join(map(repr, get_args(choices)))
            raise InvalidSetup(f"{name} is {getattr(algorithm, name)!r}; valid: {valid}.")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")
