"""A training: everything that decides what a run learns, as one frozen record that is stored with its checkpoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from rcs.envs.setup import Setup
from rcs.errors import CorruptCheckpoint, InvalidSetup, require_fields
from rcs.rl.algorithms import Algorithm, Rlpd, Sac, algorithm_from_json, algorithm_to_json
from rcs.rl.recipes import Recipe
from rcs.rollout.recorded_setup import require_trusted

VERSION = 1
"""Raised when what is stored comes to mean something else."""

# Each kind of episode has its own range of seeds, so that none is seen by two of them.
_TRAINING_SEEDS = 1 << 62
_SELECTION_SEEDS = 1 << 61
_MOST_COPIES = 1 << 20
_MOST_SEEDS = 1 << 40


@dataclass(frozen=True, kw_only=True)
class Training:
    """What is trained. The same record gives the same weights, bit for bit, on the same machine."""

    setup: Setup
    """The environment."""
    copies: int
    """Copies of the environment that are stepped together."""
    steps: int
    """Environment steps of the whole training, of all copies together."""
    algorithm: Algorithm
    """What learns, with its hyperparameters."""
    seed: int = 0
    """Of the weights, the episodes and the exploration."""
    evaluate_every: int = 0
    """Steps between two evaluations; 0 for a twentieth of all."""
    episodes: int = 50
    """Episodes of an evaluation; 0 for no evaluations."""
    evaluation_steps: int = 0
    """An episode of an evaluation is truncated after this many steps; 0 for as many as in training. Short episodes
    teach sooner, for they begin more often, and a policy may take longer where it is judged."""
    checkpoint_every: int = 0
    """Steps between two checkpoints; 0 for one at every evaluation. Every evaluation has one."""
    device: str = "cpu"
    """Where the networks are, as torch names it: `cpu`, `cuda`."""
    torch_threads: int = 0
    """Threads of torch on the CPU; 0 to measure which number is fastest. Sums of another number differ in their last
    bits."""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            InvalidSetup: One is out of range.
        """
        limits = {
            "copies": (1, _MOST_COPIES),
            "steps": (1, None),
            "seed": (0, _MOST_SEEDS),
            "evaluate_every": (0, None),
            "episodes": (0, None),
            "evaluation_steps": (0, None),
            "checkpoint_every": (0, None),
            "torch_threads": (0, None),
        }
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            is_whole = isinstance(value, int) and not isinstance(value, bool)
            if not is_whole or value < least or (most is not None and value >= most):
                end = "" if most is None else f" to {most - 1}"
                raise InvalidSetup(f"{name} is {value!r}; valid is a whole number from {least}{end}.")
        for name, share in (("evaluate_every", 20), ("checkpoint_every", 0)):
            if not getattr(self, name):
                own = max(self.steps // share, 1) if share else self.evaluate_every
                object.__setattr__(self, name, own)
        if not isinstance(self.setup, Setup):
            raise InvalidSetup(f"setup is {self.setup!r}; valid is a Setup.")
        if self.setup.stepping == "realtime":
            raise InvalidSetup("stepping is 'realtime'; training has no wall clock: use 'async'.")
        if isinstance(self.algorithm, Sac) and self.algorithm.buffer_size < self.copies:
            raise InvalidSetup(f"buffer_size is {self.algorithm.buffer_size}; it must hold a step of each copy.")
        if isinstance(self.algorithm, Rlpd) and self.algorithm.buffer_size < self.steps + self.copies:
            raise InvalidSetup(
                f"buffer_size is {self.algorithm.buffer_size}; RLPD forgets nothing: it must hold all {self.steps} "
                "steps, and one more of each copy."
            )

    @classmethod
    def of(cls, recipe: Recipe, **options: Any) -> Training:
        """Return the training of a recipe.

        Args:
            recipe: The recipe.
            options: Other fields of this record.

        Raises:
            InvalidSetup: A number is out of range.
        """
        fields = {own.name: getattr(recipe, own.name) for own in dataclasses.fields(Recipe)}
        return cls(**{**fields, **options})

    @property
    def evaluation_setup(self) -> Setup:
        """The environment in which the policy is judged."""
        if not self.evaluation_steps:
            return self.setup
        return dataclasses.replace(self.setup, max_episode_steps=self.evaluation_steps)

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
        values = {own.name: getattr(self, own.name) for own in dataclasses.fields(self)}
        return {**values, "setup": self.setup.to_json(), "algorithm": algorithm_to_json(self.algorithm)}

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
        """
        try:
            given = dict(values)
            setup, algorithm = dict(given.pop("setup")), given.pop("algorithm")
        except (KeyError, TypeError, ValueError) as err:
            raise CorruptCheckpoint(f"The record of a training lacks something: {type(err).__name__}: {err}.") from err
        require_fields("field of a training", given, (own.name for own in dataclasses.fields(cls)))
        require_trusted(setup, "The setup of the training", trust)
        return cls(setup=Setup.from_json(setup), algorithm=algorithm_from_json(algorithm), **given)

    def difference(self, other: Training) -> list[str]:
        """Return in words where another record differs, a line each; threads of torch that are 0 agree with any.

        Of another algorithm, nothing more is said: most of its figures have no counterpart.
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
