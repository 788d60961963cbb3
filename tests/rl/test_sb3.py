from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup, MissingDependency, WrongOrder
from rcs.rl import Flat, Sb3VecEnv, sb3

COPIES = 3
STEPS = 5
"""Steps of an episode."""


def copies(**options: Any) -> VecEnv:
    options = {"copies": COPIES, "autoreset": "SameStep", "max_episode_steps": STEPS, **options}
    return rcs.make_vec(observe=("privileged",), collision_reaction=False, **options)


def test_without_the_package_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.rl.sb3._Base", object)
    envs = copies()
    with pytest.raises(MissingDependency, match=r"robot-control-stack\[rl\]"):
        Sb3VecEnv(envs)
    envs.close()


def succeed_at(monkeypatch: pytest.MonkeyPatch, envs: VecEnv, copy: int, steps: list[int]) -> None:
    """Have the task say that a copy has succeeded in some calls, which ends its episode."""
    task = envs.simulation.task
    judge: Callable[[], Any] = task.evaluate
    calls = iter(range(10**6))

    def evaluate() -> Any:
        judgement = judge()
        if next(calls) in steps:
            done = np.arange(COPIES) == copy
            judgement.success = judgement.terminated = judgement.info["success"] = judgement.success | done
        return judgement

    monkeypatch.setattr(task, "evaluate", evaluate)


@pytest.mark.extras
@pytest.mark.parametrize("cameras", [(), pytest.param(("side",), marks=pytest.mark.gl)])
def test_trajectories_are_those_of_the_copies_mapped_by_flat(
    monkeypatch: pytest.MonkeyPatch, cameras: tuple[str, ...]
) -> None:
    plain, wrapped = (
        copies(cameras=rcs.Cameras(names=cameras, image_size=40)),
        copies(cameras=rcs.Cameras(names=cameras, image_size=40)),
    )
    for envs in (plain, wrapped):
        succeed_at(monkeypatch, envs, 1, [3])  # the first call judges the start
    learner, flat = Sb3VecEnv(wrapped), Flat(plain)
    learner.seed(7)
    expected, _ = plain.reset(seed=7)
    require_same(learner.reset(), flat.observation(expected))
    random = np.random.default_rng(0)
    returns, lengths = np.zeros(COPIES), np.zeros(COPIES, int)
    ended = 0
    for _ in range(2 * STEPS + 2):
        vectors = random.uniform(-1.1, 1.1, (COPIES, *flat.action_space.shape)).astype(np.float32)
        observation, reward, done, infos = learner.step(vectors)
        expected, rewards, terminated, truncated, info = plain.step(flat.action(vectors))
        require_same(observation, flat.observation(expected))
        assert (reward.dtype, done.dtype) == (np.float32, np.bool_)
        np.testing.assert_array_equal(reward, rewards.astype(np.float32))
        np.testing.assert_array_equal(done, terminated | truncated)
        returns, lengths = returns + rewards, lengths + 1
        for copy in range(COPIES):
            if not done[copy]:
                assert infos[copy] == {}
                continue
            ended += 1
            last = flat.observation(info["final_obs"])
            require_same(
                infos[copy]["terminal_observation"],
                {key: value[copy] for key, value in last.items()} if cameras else last[copy],
            )
            assert infos[copy]["TimeLimit.truncated"] == truncated[copy]
            assert infos[copy]["is_success"] == terminated[copy]
            assert infos[copy]["end"] == info["final_info"]["end"][copy]
            episode = infos[copy]["episode"]
            assert (episode["r"], episode["l"]) == (returns[copy], lengths[copy])
            assert episode["t"] >= 0
            returns[copy], lengths[copy] = 0.0, 0
    assert ended == 2 * COPIES
    learner.close()
    learner.close()
    plain.close()


def require_same(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            np.testing.assert_array_equal(a[key], b[key])
    else:
        np.testing.assert_array_equal(a, b)


@pytest.mark.extras
def test_arrays_of_a_step_stay_as_they_are() -> None:
    learner = Sb3VecEnv(copies())
    learner.seed(0)
    kept = [learner.reset()]
    copied = [kept[0].copy()]
    for _ in range(STEPS + 1):
        observation, reward, done, _ = learner.step(np.full((COPIES, *learner.action_space.shape), 0.5, np.float32))
        kept += [observation, reward, done]
        copied += [observation.copy(), reward.copy(), done.copy()]
        reward += 1.0  # PPO adds the value of a truncated episode's end
        kept.pop(-2)
        copied.pop(-2)
    for one, other in zip(kept, copied, strict=True):
        np.testing.assert_array_equal(one, other)
    assert learner.step(np.zeros((COPIES, *learner.action_space.shape)))[1].max() < 1.0
    learner.close()


@pytest.mark.extras
def test_a_seed_decides_what_follows_and_no_seed_goes_on_with_the_next_episodes() -> None:
    learner = Sb3VecEnv(copies())
    assert learner.seed(4) == [4, 5, 6]
    first = learner.reset()
    second = learner.reset()
    learner.seed(4)
    np.testing.assert_array_equal(learner.reset(), first)
    np.testing.assert_array_equal(learner.reset(), second)
    assert not np.array_equal(first, second)
    learner.close()


@pytest.mark.extras
def test_rewards_are_scaled_and_the_returns_that_are_told_are_not() -> None:
    learner, plain = Sb3VecEnv(copies(), reward_scale=4.0), Sb3VecEnv(copies())
    for one in (learner, plain):
        one.seed(0)
        one.reset()
    action = np.full((COPIES, *learner.action_space.shape), 0.3, np.float32)
    for _ in range(STEPS):
        (_, scaled, done, infos), (_, reward, _, expected) = learner.step(action), plain.step(action)
        np.testing.assert_allclose(scaled, 4.0 * reward, rtol=1e-6)
    assert done.all()
    assert [one["episode"]["r"] for one in infos] == [one["episode"]["r"] for one in expected]
    assert any(one["episode"]["r"] != 0.0 for one in infos)
    learner.close()
    plain.close()


@pytest.mark.extras
def test_what_was_counted_goes_on_in_other_copies() -> None:
    first, second = (Sb3VecEnv(copies(max_episode_steps=6)) for _ in range(2))
    action = np.full((COPIES, *first.action_space.shape), 0.3, np.float32)
    first.reset()
    for _ in range(3):
        first.step(action)
    second.reset()
    second.envs.set_state(first.envs.get_state())
    second.returns[:], second.lengths[:] = first.returns, first.lengths
    for _ in range(8):
        ours, theirs = first.step(action), second.step(action)
        for one, other in zip(ours[:3], theirs[:3], strict=True):
            np.testing.assert_array_equal(one, other)
        for one, other in zip(ours[3], theirs[3], strict=True):
            assert one.keys() == other.keys()
            assert {**one.get("episode", {}), "t": 0} == {**other.get("episode", {}), "t": 0}
    first.close()
    second.close()


@pytest.mark.extras
def test_a_copy_that_diverged_is_not_bootstrapped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    learner = Sb3VecEnv(copies())
    learner.reset()
    learner.envs.simulation.world.qvel[1, 0] = np.nan
    observation, _, done, infos = learner.step(np.zeros((COPIES, *learner.action_space.shape)))
    np.testing.assert_array_equal(done, [False, True, False])
    assert infos[1]["end"] == "diverged"
    assert infos[1]["TimeLimit.truncated"] is False
    assert np.isfinite(infos[1]["terminal_observation"]).all()
    assert np.isfinite(observation).all()
    learner.close()


@pytest.mark.extras
def test_what_the_library_asks_of_its_environments_is_answered() -> None:
    from stable_baselines3.common.env_util import is_wrapped
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor, VecNormalize
    from stable_baselines3.common.vec_env import VecEnv as TheirVecEnv

    learner = Sb3VecEnv(copies())
    assert isinstance(learner, TheirVecEnv)
    assert learner.unwrapped is learner
    assert learner.render_mode is None
    assert not is_wrapped(learner, Monitor)
    assert learner.env_is_wrapped(Monitor) == [True] * COPIES
    assert learner.env_is_wrapped(VecMonitor, indices=[0, 2]) == [False] * 2
    assert learner.get_attr("frequency") == [30.0] * COPIES
    assert learner.get_attr("frequency", indices=1) == [30.0]
    assert learner.has_attr("setup")
    assert not learner.has_attr("no_such_attribute")
    learner.set_attr("instruction", "do it")
    assert learner.get_attr("instruction") == ["do it"] * COPIES
    states = learner.reset() is not None and learner.env_method("get_state")
    assert len(states) == COPIES
    for call in (lambda: learner.set_attr("instruction", "", 1), lambda: learner.env_method("close", indices=[0])):
        with pytest.raises(InvalidSetup, match="the copies are one environment"):
            call()
    with pytest.raises(WrongOrder, match="step_wait was called without step_async"):
        learner.step_wait()
    learner.set_options({"state": 1})
    with pytest.raises(InvalidSetup, match="set_options was called"):
        learner.reset()
    learner.set_options()
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        wrapped = VecNormalize(VecCheckNan(VecMonitor(learner), raise_exception=True))
    observation = wrapped.reset()
    for _ in range(STEPS):
        observation, _, done, infos = wrapped.step(np.zeros((COPIES, *learner.action_space.shape)))
        assert np.isfinite(observation).all()
    assert done.all()
    assert infos[2]["episode"]["l"] == STEPS
    learner.close()


@pytest.mark.extras
def test_only_copies_that_start_anew_in_the_step_of_the_end_are_taken() -> None:
    envs = copies(autoreset="NextStep")
    with pytest.raises(InvalidSetup, match="autoreset='SameStep'"):
        Sb3VecEnv(envs)
    envs.close()


@pytest.mark.extras
@pytest.mark.slow
def test_ppo_and_sac_learn_on_it() -> None:
    import torch
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.evaluation import evaluate_policy

    torch.set_num_threads(1)
    learner = Sb3VecEnv(copies(copies=4, max_episode_steps=10, control="xyzrpy"))
    ppo = PPO("MlpPolicy", learner, n_steps=32, batch_size=64, n_epochs=2, seed=0)
    ppo.learn(256)
    assert len(ppo.ep_info_buffer or ()) == 24
    assert [one["l"] for one in ppo.ep_info_buffer or ()] == [10] * 24
    sac = SAC("MlpPolicy", learner, learning_starts=32, buffer_size=1000, seed=0)
    sac.learn(160)
    for model in (ppo, sac):
        assert model.num_timesteps >= 160
        assert all(torch.isfinite(own).all() for own in model.policy.parameters())
        returns, lengths = evaluate_policy(model, learner, n_eval_episodes=4, return_episode_rewards=True)
        assert lengths == [10] * 4
        assert np.isfinite(returns).all()
    learner.close()


@pytest.mark.extras
@pytest.mark.gl
@pytest.mark.slow
def test_ppo_learns_from_frames() -> None:
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    learner = Sb3VecEnv(copies(cameras=rcs.Cameras(names=("side", "wrist"), image_size=36), max_episode_steps=4))
    model = PPO("MultiInputPolicy", learner, n_steps=8, batch_size=24, n_epochs=1, seed=0)
    model.learn(24)
    assert model.get_env() is learner  # nothing was wrapped around it to turn the frames
    assert all(torch.isfinite(own).all() for own in model.policy.parameters())
    learner.close()


def test_the_module_does_not_hide_the_class() -> None:
    assert sb3.Sb3VecEnv is Sb3VecEnv
