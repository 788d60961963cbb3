"""Laws of the rewards: what shaping adds up to, that it changes no optimal policy, and what success is worth."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.envs.reward import Rewards
from rcs.envs.task import Judgement, Task
from rcs.errors import InvalidSetup

DISCOUNT = 0.97
AUTORESETS = ["NextStep", "SameStep", "Disabled"]


class Wander(Task):
    """Progress goes up and down; far to one side of the first joint is success, far to the other the end."""

    def bind(self, world: Any, robots: Any) -> None:
        self._robot = robots[0]

    def reset(self, draws: Any, where: Any) -> None: ...

    def evaluate(self) -> Judgement:
        first = self._robot.joints[..., 0]
        progress = 0.5 + 0.5 * np.sin(40.0 * first)
        return Judgement(
            success=first > 0.11,
            terminated=np.abs(first) > 0.11,
            progress=progress,
            is_placed=progress > 0.5,
            info={"progress": progress},
        )

    def describe(self) -> dict[str, Any]:
        return {"progress": self.evaluate().progress}


def shaping_of(episode: list[tuple[float, bool]]) -> float:
    """Return the discounted sum of what shaping paid in an episode of rewards and successes."""
    return sum(DISCOUNT**step * (reward - success) for step, (reward, success) in enumerate(episode))


def wander(rng: np.random.Generator, space: Any) -> dict[str, np.ndarray]:
    """Return actions that turn the first joint by up to 2 degrees, mostly in the direction of the copy's parity."""
    shape = space["joints"].shape
    joints = np.zeros(shape)
    side = np.where(np.arange(shape[0]) % 2, 1.0, -1.0) if len(shape) == 2 else 1.0
    joints[..., 0] = 0.035 * (side * 0.3 + rng.uniform(-1.0, 1.0, shape[:-1]))
    return {"joints": joints, "gripper": np.ones(space["gripper"].shape, np.float32)}


@pytest.mark.parametrize("autoreset", AUTORESETS)
def test_shaping_adds_up_to_the_discounted_potential_of_the_end_minus_that_of_the_start(autoreset: str) -> None:
    envs = rcs.make_vec(Wander, copies=6, discount=DISCOUNT, max_episode_steps=25, autoreset=autoreset, threads=1)
    _, info = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    starts = info["progress"].copy()
    episodes: list[list[tuple[float, bool]]] = [[] for _ in range(6)]
    ends = {"success": 0, "failure": 0, "truncated": 0}
    was_over = np.zeros(6, np.bool_)
    for _ in range(90):
        _, reward, terminated, truncated, info = envs.step(wander(rng, envs.action_space))
        is_over = terminated | truncated
        last = info["final_info"] if autoreset == "SameStep" and is_over.any() else info
        for copy in range(6):
            if was_over[copy] and autoreset == "NextStep":
                assert reward[copy] == 0.0, "the start of an episode is no step"
                starts[copy], episodes[copy] = info["progress"][copy], []
                continue
            episodes[copy].append((float(reward[copy]), bool(last["success"][copy])))
            if is_over[copy]:
                end = 0.0 if terminated[copy] else DISCOUNT ** len(episodes[copy]) * last["progress"][copy]
                assert shaping_of(episodes[copy]) == pytest.approx(end - starts[copy], abs=1e-9)
                kind = "truncated" if truncated[copy] else "success" if last["success"][copy] else "failure"
                ends[kind] += 1
        was_over = is_over
        if autoreset == "Disabled" and is_over.any():
            envs.reset(options={"reset_mask": is_over})
        if autoreset != "NextStep":
            starts = np.where(is_over, envs.simulation.task.describe()["progress"], starts)
            episodes = [[] if over else own for own, over in zip(episodes, is_over, strict=True)]
    assert min(ends.values()) > 0, ends


def rewards_of(kind: Any, shape: tuple[int, ...] = (), discount: float = DISCOUNT) -> Rewards:
    return Rewards(SimpleNamespace(leading=shape), [], kind, discount)  # type: ignore[arg-type]


def test_shaping_adds_up_over_states_that_are_set_and_starts_that_are_given() -> None:
    env = rcs.make(Wander, discount=DISCOUNT)
    envs = rcs.make_vec(Wander, copies=2, discount=DISCOUNT, threads=1)
    rng = np.random.default_rng(3)
    _, info = env.reset(seed=0)
    for _ in range(4):
        *_, info = env.step(wander(rng, env.action_space))
    _, info = env.reset(options={"state": env.simulation.world.states()})
    start = info["progress"]
    assert start != 0.5, "not that of the home pose"
    rewards = [(env.step(wander(rng, env.action_space))[1], False) for _ in range(3)]
    envs.reset(seed=5)
    envs.step(wander(rng, envs.action_space))
    envs.set_state(env.get_state(), [1])
    for _ in range(2):
        _, reward, _, _, info = envs.step(wander(rng, envs.action_space))
        rewards.append((reward[1], False))
    assert shaping_of(rewards) == pytest.approx(DISCOUNT**5 * info["progress"][1] - start, abs=1e-9)


@pytest.mark.parametrize("kind", ["shaped", "dense", "sparse"])
@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
def test_every_copy_is_paid_as_a_single_environment_is(kind: Any, autoreset: str) -> None:
    options: Any = {"reward": kind, "max_episode_steps": 10, "discount": 0.9}
    envs = rcs.make_vec(Wander, copies=3, autoreset=autoreset, threads=2, **options)
    singles = [rcs.make(Wander, **options) for _ in range(3)]
    envs.reset(seed=0)
    for copy, single in enumerate(singles):
        single.reset(seed=copy)
    rng = np.random.default_rng(0)
    was_over = [False] * 3
    for _ in range(40):
        actions = wander(rng, envs.action_space)
        _, reward, *_ = envs.step(actions)
        for copy, single in enumerate(singles):
            if was_over[copy]:
                single.reset()
                was_over[copy] = False
                if autoreset == "NextStep":
                    continue
            _, own, terminated, truncated, _ = single.step({key: value[copy] for key, value in actions.items()})
            assert reward[copy] == own
            was_over[copy] = terminated or truncated


def test_a_simulation_that_diverges_keeps_its_potential(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    for kind, expected in (("shaped", (DISCOUNT - 1.0) * 0.5), ("dense", 0.0), ("sparse", 0.0)):
        env = rcs.make(Wander, discount=DISCOUNT, reward=kind)
        _, info = env.reset(seed=0)
        assert info["progress"] == 0.5
        env.simulation.world.qvel[0] = np.nan
        assert env.step(wander(np.random.default_rng(0), env.action_space))[1] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("kind", ["shaped", "dense", "sparse"])
def test_a_success_in_the_step_of_a_fault_pays_nothing_and_the_learner_goes_on_from_the_potential(kind: Any) -> None:
    rewards, done = rewards_of(kind, (2,)), np.array([True, True])
    judgement = Judgement(success=done, progress=np.array([0.5, 0.5]))
    failed = np.array([False, True])
    success, fault = rewards.pay(judgement, terminated=~failed, failed=failed)
    assert success == pytest.approx(1.0 / (1.0 - DISCOUNT) if kind == "dense" else 1.0)
    assert fault == pytest.approx({"shaped": DISCOUNT * 0.5, "dense": 0.6 * 0.5, "sparse": 0.0}[kind])


def test_shaping_changes_no_optimal_policy() -> None:
    rng = np.random.default_rng(0)
    states, actions, goal = 8, 3, 7
    transition = rng.dirichlet(np.full(states, 0.3), (states, actions))
    potential = rng.uniform(0.0, 1.0, states)
    shape = (states, actions, states)
    before, after = np.broadcast_to(potential[:, None, None], shape), np.broadcast_to(potential, shape)
    is_goal = np.broadcast_to(np.arange(states) == goal, shape)

    def values(kind: Any) -> np.ndarray:
        rewards = rewards_of(kind, shape)
        rewards.begin(Judgement(progress=before), ...)
        paid = rewards.pay(Judgement(success=is_goal, progress=after), terminated=is_goal)
        q = np.zeros((states, actions))
        for _ in range(2000):
            q = (transition * (paid + DISCOUNT * np.where(is_goal, 0.0, q.max(axis=1)))).sum(axis=-1)
        return q[:goal]

    shaped, sparse = values("shaped"), values("sparse")
    np.testing.assert_array_equal(shaped.argmax(axis=1), sparse.argmax(axis=1))
    np.testing.assert_allclose(shaped, sparse - potential[:goal, None], atol=1e-9)


def test_the_dense_reward_has_the_terms_of_pick_cube_and_success_is_worth_what_1_per_step_is_for_ever() -> None:
    env = rcs.make("PickCuboid", reward="dense", discount=0.9)
    agent = agent_for(env)
    observation, info = env.reset(seed=1)
    agent.reset(observation, info)
    world, robot = env.simulation.world, env.simulation.robots[0]
    seen = set()
    while True:
        observation, reward, terminated, _, info = env.step(agent.act(observation, info))
        if terminated:
            break
        grasped = float(info["is_grasped"])
        away = np.linalg.norm(info["cuboid"][:3] - robot.tcp_tquat[:3])
        reach = 1.0 - 0.5 * (np.tanh(5.0 * away) + np.tanh(25.0 * away))
        corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * info["edges"]
        height = (
            rcs.Pose.from_tquat(world.poses[..., env.simulation.task._poses_in_scene["cuboid"], :])
            .apply(corners)[:, 2]
            .min()
        )
        place = np.clip(height / 0.10, 0.0, 1.0)
        is_placed = float(grasped and height >= 0.10)
        static = 1.0 - np.tanh(5.0 * np.linalg.norm(robot.joint_velocities))
        assert reward == pytest.approx((reach + grasped + grasped * place + is_placed * static) / 5.0, abs=1e-9)
        seen.add((grasped, is_placed))
    assert seen == {(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)}
    assert reward == pytest.approx(10.0)


def test_a_task_may_pay_a_reward_of_its_own() -> None:
    for kind in ("shaped", "dense", "sparse"):
        rewards = rewards_of(kind)
        judgement = Judgement(success=np.array(True), progress=np.array(0.3), reward=np.array(-7.0))
        assert rewards.pay(judgement, terminated=True) == -7.0


def test_the_judgement_of_a_task_tells_success_and_ends_the_episode_with_it() -> None:
    success = np.array([True, False])
    assert Judgement(success=success).info["success"] is success
    assert Judgement(success=success).terminated is success
    assert Judgement().info == {}
    assert Judgement(success=success, terminated=~success).terminated is not success


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"reward": "progress"}, "reward is 'progress'; valid: 'shaped', 'dense', 'sparse'"),
        ({"discount": 0.0}, "discount is 0.0; valid: a finite number above 0"),
        ({"discount": 1.01}, "discount is 1.01; valid: .* up to 1"),
        ({"discount": "0.9"}, "discount is '0.9'"),
        ({"discount": float("nan")}, "discount is nan"),
        ({"reward": "dense", "discount": 1.0}, "the dense reward needs one below 1"),
    ],
)
def test_a_reward_or_discount_that_makes_no_sense_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetup, match=message):
        rcs.Setup(**values)


def test_a_reward_among_the_options_of_a_task_is_refused_with_where_it_belongs() -> None:
    with pytest.raises(InvalidSetup, match="no option of a task but of the setup: reward='sparse'"):
        rcs.make("PickCuboid", task_options={"reward": "sparse"})
