"""A trained policy acts the same alone, in a batch, in evaluations and after its weights were read from a file."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import Pace, agent_for
from rcs.errors import CorruptCheckpoint, InvalidSetup
from rcs.rollout.batch import run_batch
from rcs.rollout.episode import run_episode

pytestmark = pytest.mark.extras


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any, str], Path]:
    """Return a function that trains, once per algorithm and kind of observation."""
    made: dict[str, Path] = {}

    def train(small: Any, name: str) -> Path:
        if name not in made:
            algorithm, _, sees = name.partition(" ")
            training = small.training(algorithm)
            if sees:
                setup = replace(training.setup, cameras=rcs.Cameras(names=("wrist", "side"), image_size=40), observe=())
                training = replace(training, setup=setup, steps=40)
            made[name] = tmp_path_factory.mktemp("runs") / algorithm
            small.run(training, made[name])
        return made[name]

    return train


@pytest.mark.parametrize("name", ["ppo", pytest.param("ppo sees", marks=pytest.mark.gl)])
def test_alone_and_in_a_batch_it_does_the_same(small: Any, runs: Any, name: str) -> None:
    from rcs.rl.checkpoint import find_checkpoint
    from rcs.rl.policy import PolicyAgent

    checkpoint = find_checkpoint(runs(small, name))
    agent = PolicyAgent.load(checkpoint)
    with rcs.make(checkpoint.training.setup) as env:
        alone = [run_episode(env, agent, seed=seed) for seed in range(4)]
    envs = rcs.make_vec(checkpoint.training.setup, copies=3, threads=1, autoreset="Disabled")
    attempts = sorted(run_batch(envs, agent, range(4), lambda seed: seed), key=lambda attempt: attempt.number)
    envs.close()
    assert [attempt.result for attempt in attempts] == alone


def test_it_is_the_learners_policy_without_exploration(small: Any, runs: Any) -> None:
    from rcs.rl.checkpoint import find_checkpoint
    from rcs.rl.networks import make_policy
    from rcs.rl.policy import PolicyAgent

    checkpoint = find_checkpoint(runs(small, "ppo"))
    agent = PolicyAgent.load(checkpoint)
    policy = make_policy(checkpoint.training.algorithm, agent.flat)
    policy.load_state_dict(checkpoint.policy())
    with rcs.make(checkpoint.training.setup) as env:
        observation, info = env.reset(seed=5)
        theirs, _ = policy.predict(agent.flat.observation(observation), deterministic=True)
        ours = agent.flat.action_vector(agent.act(observation, info))
    assert np.allclose(ours, theirs, atol=1e-6)
    assert np.abs(ours).max() > 1e-4


def test_an_evaluation_has_the_same_results_in_a_batch_in_processes_and_alone(small: Any, runs: Any) -> None:
    from rcs.rl.checkpoint import find_checkpoint
    from rcs.rl.evaluate import evaluate_in_batch
    from rcs.rollout import Evaluation, Summary, evaluate

    checkpoint = find_checkpoint(runs(small, "ppo"))
    evaluation = Evaluation(setup=checkpoint.training.setup, agent=str(checkpoint.path), episodes=5, seed=3)
    batch, alone, processes = Summary(), Summary(), Summary()
    list(evaluate_in_batch(evaluation, batch, copies=2, threads=1))
    list(evaluate(evaluation, alone))
    list(evaluate(replace(evaluation, workers=2), processes))
    assert batch.results == alone.results == processes.results
    assert {attempt.weights for attempt in (*batch.attempts, *processes.attempts)} == {checkpoint.files["policy.pt"]}


def test_a_run_stands_for_its_best_checkpoint_and_for_the_newest_where_none_was_evaluated(
    small: Any, runs: Any, tmp_path: Path
) -> None:
    from rcs.rl.checkpoint import Score, best_of, find_checkpoint

    run = runs(small, "ppo")
    best = find_checkpoint(run)
    scored = [place for place in sorted((run / "checkpoints").iterdir()) if find_checkpoint(place).score is not None]
    assert best.score is not None
    assert all(find_checkpoint(place).score.order <= best.score.order for place in scored)  # pyright: ignore
    few = replace(best, score=Score(episodes=9, successes=2, judged=9, reward=9.0, length=1.0), steps=1)
    most = replace(best, score=Score(episodes=9, successes=3, judged=9, reward=0.0, length=1.0), steps=2)
    later = replace(most, score=replace(most.score, reward=-1.0), steps=3)  # pyright: ignore[reportArgumentType]
    assert best_of([few, later, most, replace(best, score=None, steps=4)]) == later
    small.run(small.training(episodes=0, steps=40), tmp_path / "run")
    assert find_checkpoint(tmp_path / "run").steps == 40


def test_agents_are_found_by_the_path_of_a_checkpoint(small: Any, runs: Any) -> None:
    from rcs.rl.policy import PolicyAgent

    run = runs(small, "ppo")
    with rcs.make(small.training().setup) as env:
        assert isinstance(agent_for(env, str(run)), PolicyAgent)
        assert isinstance(agent_for(env, run / "checkpoints" / "000000160"), PolicyAgent)
        with pytest.raises(InvalidSetup, match="There is no checkpoint in runs/nothing"):
            agent_for(env, "runs/nothing")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": "ur5e"}, "robot is 'ur5e', not 'fr3'"),
        ({"control": "xyzrpy"}, "control is 'xyzrpy', not 'joints'"),
        ({"frequency": 15.0}, "frequency is 15.0, not 30.0"),
    ],
)
def test_an_environment_in_which_actions_mean_something_else_is_refused(
    small: Any, runs: Any, changes: dict[str, Any], words: str
) -> None:
    with rcs.make(replace(small.training().setup, **changes)) as env, pytest.raises(InvalidSetup, match=words):
        agent_for(env, str(runs(small, "ppo")))


def test_where_steps_are_more_frequent_it_decides_at_the_rate_of_its_training(small: Any, runs: Any) -> None:
    from rcs.rl.checkpoint import find_checkpoint
    from rcs.rl.policy import PolicyAgent

    checkpoint = find_checkpoint(runs(small, "ppo"))
    setup = replace(checkpoint.training.setup, relative="absolute")
    absolute = replace(checkpoint, training=replace(checkpoint.training, setup=setup))
    with rcs.make(replace(setup, frequency=90.0)) as env:
        pace = Pace(env, PolicyAgent.load(absolute, env))
        observation, info = env.reset(seed=0)
        pace.reset(observation, info)
        decided = []
        for _ in range(4):
            pace.act(observation, info)
            decided.append(pace.has_decided)
        assert decided == [True, False, False, True]
    with rcs.make(replace(checkpoint.training.setup, frequency=90.0)) as env:
        agent = PolicyAgent.load(checkpoint, env)
        with pytest.raises(InvalidSetup, match="would add up"):
            Pace(env, agent)


def test_an_environment_without_what_it_observes_is_refused(small: Any, runs: Any) -> None:
    with rcs.make(replace(small.training().setup, observe=())) as env:
        agent = agent_for(env, str(runs(small, "ppo")))
        with pytest.raises(InvalidSetup, match=r"does not fit this environment: .* is missing"):
            run_episode(env, agent, seed=0)


def test_more_that_is_observed_does_no_harm(small: Any, runs: Any) -> None:
    """Cameras may record what a policy does that does not see."""
    setup = small.training().setup
    with rcs.make(setup) as env:
        plain = run_episode(env, agent_for(env, str(runs(small, "ppo"))), seed=1)
    with rcs.make(replace(setup, observe=("torques", *setup.observe))) as env:
        assert run_episode(env, agent_for(env, str(runs(small, "ppo"))), seed=1) == plain


def test_damage_and_other_versions_are_named(small: Any, runs: Any, tmp_path: Path) -> None:
    from rcs_data.files.durable import sealed, unsealed

    from rcs.rl.checkpoint import find_checkpoint

    place = shutil.copytree(runs(small, "ppo") / "checkpoints" / "000000160", tmp_path / "000000160")
    about = place / "checkpoint.json"
    values = unsealed(about.read_bytes(), about)
    about.write_bytes(sealed({**values, "version": 99}))
    with pytest.raises(InvalidSetup, match="version 99 of the format of checkpoints; this program reads version 3"):
        find_checkpoint(place)
    about.write_bytes(sealed({name: value for name, value in values.items() if name != "layout"}))
    with pytest.raises(InvalidSetup, match=r"checkpoint\.json: Checkpoint lacks 'layout'"):
        find_checkpoint(place)
    about.write_bytes(sealed(values))
    (place / "policy.pt").write_bytes(b"")
    with pytest.raises(CorruptCheckpoint, match=r"policy.pt is damaged: its bytes are not what was written"):
        find_checkpoint(place).policy()
