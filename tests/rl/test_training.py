"""Records of what is trained: they survive JSON, refuse what makes no sense, and keep kinds of episodes apart."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from typing import Any

import pytest

import rcs
from rcs.errors import InvalidSetup, UnknownName
from rcs.rl import RECIPES, Ppo, Training, recipe_for
from rcs.rollout.collection import seed_of

PICK = RECIPES["PickCuboid", "ppo"]
TRAININGS = [
    *RECIPES.values(),
    replace(PICK, algorithm=Ppo(network=(8,), target_kl=None)),
]


@pytest.mark.parametrize("training", TRAININGS, ids=str)
def test_a_training_survives_json(training: Training) -> None:
    assert Training.from_json(json.loads(json.dumps(training.to_json()))) == training


@pytest.mark.parametrize(
    ("algorithm", "words"),
    [
        (lambda: Ppo(n_steps=0), "n_steps is 0; valid: a whole number from 1"),
        (lambda: Ppo(learning_rate=-1.0), "learning_rate is -1.0; valid: a finite number above 0"),
        (lambda: Ppo(gae_lambda=1.5), "gae_lambda is 1.5; valid: a finite number from 0"),
        (lambda: Ppo(network=(0,)), "network is"),
        (lambda: Ppo(activation="gelu"), "valid: 'tanh', 'relu'"),  # pyright: ignore[reportArgumentType]
        (lambda: Ppo(ent_coef=float("nan")), "ent_coef is nan"),
        (lambda: replace(PICK, steps=True), "steps is True"),
        (lambda: replace(PICK, seed=1 << 40), "seed is 1099511627776; valid: a whole number from 0 and below"),
        (lambda: Ppo.from_json({"n_step": 3}), "no option of Ppo named 'n_step'"),
    ],
)
def test_a_number_that_makes_no_sense_is_refused(algorithm: Any, words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        algorithm()


def test_there_is_no_other_algorithm() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'ppo'"):
        recipe_for("PickCuboid", "ppoo")  # pyright: ignore[reportArgumentType]


def test_no_two_kinds_of_episodes_share_a_seed() -> None:
    """Those that are learned from, those on which checkpoints are compared, and those of `rcs eval`."""
    most = replace(PICK, seed=(1 << 40) - 1, copies=(1 << 20) - 1, episodes=(1 << 20) - 1)
    least = replace(most, seed=0)
    learned = (least.first_seed, most.first_seed + most.copies - 1)
    compared = (least.first_selection_seed, most.first_selection_seed + most.episodes - 1)
    evaluated = (0, max(seed_of(seed, number) for seed in range(20) for number in range(50)))
    assert evaluated[1] < 1 << 32 < compared[0] < compared[1] < learned[0] < learned[1] < 1 << 63


def test_two_seeds_of_trainings_share_no_episode() -> None:
    first = replace(PICK, copies=(1 << 20) - 1)
    second = replace(first, seed=1)
    assert first.first_seed + first.copies <= second.first_seed
    assert first.first_selection_seed + first.episodes <= second.first_selection_seed


def test_a_record_from_elsewhere_imports_nothing() -> None:
    values = TRAININGS[0].to_json()
    values["setup"]["task"] = "antigravity:Task"
    with pytest.raises(InvalidSetup, match="names a class of the module 'antigravity'"):
        Training.from_json(values)
    assert "antigravity" not in sys.modules


def test_a_record_that_lacks_something_says_so() -> None:
    values = TRAININGS[0].to_json()
    del values["algorithm"]
    with pytest.raises(InvalidSetup, match="Training lacks 'algorithm'"):
        Training.from_json(values)


def test_differences_are_told_by_name() -> None:
    one = TRAININGS[0]
    other = replace(one, copies=7, setup=replace(one.setup, robot="ur5e"), torch_threads=3)
    assert one.difference(other) == [f"copies is 7, not {one.copies}", "robot is 'ur5e', not 'fr3'"]
    assert one.difference(one) == []


def test_a_policy_that_sees_is_not_told_where_objects_are() -> None:
    recipe = recipe_for("PickCuboid", cameras=("wrist", "side"))
    assert recipe.setup.cameras.names == ("wrist", "side")
    assert recipe.setup.observe == ()


def test_the_recipe_of_a_task_without_one_is_for_that_task() -> None:
    assert recipe_for("StackCuboid").setup == replace(recipe_for("PickCuboid").setup, task="StackCuboid")
    assert isinstance(rcs.Setup(), type(recipe_for("PickCuboid").setup))


def test_a_recipe_by_sight_has_small_pictures_whatever_the_task() -> None:
    assert recipe_for("Place", "dagger", cameras=("wrist",)).setup.cameras.image_size == (64, 64)
