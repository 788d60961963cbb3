"""A training: everything that decides what a run learns, as one frozen record that is stored with its checkpoints."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Annotated, Any

from rcs_data.record import Meta, Natural, Record, Whole

from rcs.envs.setup import Setup
from rcs.errors import CorruptCheckpoint, InvalidSetup, UnknownName
from rcs.rl.algorithms import ALGORITHMS, Algorithm, Sac
from rcs.rollout.recorded_setup import require_trusted

VERSION = 2
"""Raised when what is stored comes to mean something else."""

# Each kind of episode has its own range of seeds, so that none is seen by two of them.
_TRAINING_SEEDS = 1 << 62
_SELECTION_SEEDS = 1 << 61
_MOST_COPIES = 1 << 20
_MOST_SEEDS = 1 << 40


class Training(Record):
    """A training. The same record gives the same weights, bit for bit, on the same machine.

    Example:
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
    seed: Annotated[int, Meta(ge=0, lt=_MOST_SEEDS)] = 0
    """Seed of the weights, the episodes and the exploration."""
    evaluate_every: Natural = 0
    """Steps between two evaluations; 0 for a twentieth of all."""
    episodes: Natural = 50
    """Episodes of an evaluation; 0 for no evaluations."""
    evaluation_steps: Natural = 0
    """An episode of an evaluation is truncated after this many steps; 0 for as many as in training. Short episodes
    teach sooner, for they begin more often, and a policy may take longer where it is judged."""
    checkpoint_every: Natural = 0
    """Steps between two checkpoints; 0 for one at every evaluation. Every evaluation has one."""
    device: str = "cpu"
    """Device of the networks, as torch names it: `cpu`, `cuda`."""
    torch_threads: Natural = 0
    """Threads of torch on the CPU; 0 for one, or for one per CPU with cameras. Sums of another number differ in their
    last bits."""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range, or the setup has no simulated time.
        """
        super().__post_init__()
        if self.setup.stepping == "realtime":
            raise InvalidSetup("stepping is 'realtime'; training has no wall clock: use 'async'.")
        if isinstance(self.algorithm, Sac) and self.algorithm.buffer_size < self.copies:
            raise InvalidSetup(f"buffer_size is {self.algorithm.buffer_size}; it must hold a step of each copy.")

    def on(self, robot: str, end_effector: str | None = None) -> Training:
        """Return the training of another robot, with its usual end effector or another one."""
        return replace(self, setup=replace(self.setup, robot=robot, end_effector=end_effector))

    @property
    def evaluation_interval(self) -> int:
        """Steps between two evaluations."""
        return self.evaluate_every or max(self.steps // 20, 1)

    @property
    def checkpoint_interval(self) -> int:
        """Steps between two checkpoints."""
        return self.checkpoint_every or self.evaluation_interval

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

    def to_json(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        values = {**super().to_json(), "setup": self.setup.to_json()}
        return {**values, "algorithm": {"name": self.algorithm.name, **self.algorithm.to_json()}}

    @classmethod
    def from_json(cls, values: Mapping[str, Any], *, trust: Collection[str] = ()) -> Training:
        """Return the record that `to_json` wrote.

        Args:
            values: JSON values, from anywhere.
            trust: Modules that may be imported because the setup names a class of theirs.

        Raises:
            CorruptCheckpoint: Something is missing.
            InvalidSetup: A field is unknown or out of range, or a class of a module is named that is neither imported
                nor trusted.
            UnknownName: There is no such algorithm.
        """
        try:
            given = dict(values)
            setup, algorithm = dict(given["setup"]), dict(given["algorithm"])
            name = algorithm.pop("name")
        except (KeyError, TypeError, ValueError) as err:
            raise CorruptCheckpoint(f"The record of a training lacks something: {type(err).__name__}: {err}.") from err
        if name not in ALGORITHMS:
            raise UnknownName("algorithm", str(name), ALGORITHMS)
        require_trusted(setup, "The setup of the training", trust)
        own = {"setup": Setup.from_json(setup), "algorithm": ALGORITHMS[name].from_json(algorithm)}
        return super().from_json({**given, **own})

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
