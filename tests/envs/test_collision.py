"""Arms that react to collisions: they stop in a fault as the real ones do, and not when they handle objects."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter

import rcs
from rcs.agents import Agent, agent_for
from rcs.envs import Observer, Recorder, dataset_info
from rcs.envs.step.judge import row
from rcs.errors import WrongOrder
from rcs.rollout.episode import run_episode
from rcs.testing.env_contract import require_same_bits

ARMS = [("fr3", None), ("ur5e", None), ("xarm7", "franka_hand"), ("so101", None)]
DEPTH = 0.1
"""How far into the table the tool is sent [m]."""
SPEED = 0.1
"""How fast it goes there [m/s]."""


def make(robot: str = "fr3", end_effector: str | None = None, *, task: str = "PickCuboid", **options: Any) -> Any:
    form: dict[str, Any] = {"control": "tquat", "relative": False, "max_episode_steps": None}
    observe = ("torques", "wrench", "contacts", "privileged")
    form |= {"robot": robot, "end_effector": end_effector, "observe": observe, **options}
    return rcs.make(task, **form)


def go_down(
    env: Any, observation: Any, to: float, *, gripper: float, steps: int = 400, speed: float = SPEED
) -> tuple[float, list[Any]]:
    """Send the tool straight down; return the largest force on it after a step [N], and the last step."""
    target, peak, last = observation["tquat"].copy(), 0.0, [observation]
    for _ in range(steps):
        target[2] = max(target[2] - speed / env.frequency, to)
        last = list(env.step({"tquat": target, "gripper": np.full(1, gripper, np.float32)}))
        peak = max(peak, float(np.linalg.norm(last[0]["tcp_wrench"][:3])))
        if last[2] or last[3]:
            break
    return peak, last


@pytest.mark.parametrize(("robot", "end_effector"), ARMS)
def test_an_arm_that_presses_on_the_table_goes_into_its_fault_state(
    robot: str, end_effector: str | None, record_property: Any
) -> None:
    env = make(robot, end_effector)
    observation, _ = env.reset(seed=0)
    peak, (_, _, terminated, truncated, info) = go_down(env, observation, -DEPTH, gripper=1.0)
    record_property("peak_force", peak)
    assert (terminated, truncated, info["end"]) == (False, True, "fault")
    assert list(info["faults"]) == [robot]
    assert "collision: " in info["faults"][robot]
    assert "the limit is" in info["faults"][robot]
    with pytest.raises(WrongOrder, match="call reset"):
        env.step({"tquat": observation["tquat"], "gripper": np.ones(1, np.float32)})
    env.recover()
    again, _ = env.reset(seed=0)
    require_same_bits(again, observation)
    assert env.step({"tquat": again["tquat"], "gripper": np.ones(1, np.float32)})[-1]["end"] == "period"


def test_the_reaction_limits_the_force_of_a_press() -> None:
    """At a low speed: the force of an impact, over within a physics step, is what it is before any reaction."""
    peaks: dict[bool, float] = {}
    for reacts in (True, False):
        env = make(collision_reaction=reacts)
        observation, _ = env.reset(seed=0)
        peaks[reacts], (_, _, _, truncated, _) = go_down(env, observation, -DEPTH, gripper=1.0, steps=1000, speed=0.02)
        assert truncated == reacts
    assert peaks[True] < 0.7 * peaks[False]


@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_a_step_that_ends_in_a_collision_ends_at_once(stepping: Any) -> None:
    env = make(stepping=stepping)
    substeps = []
    for speed in (SPEED, 0.9 * SPEED, 0.8 * SPEED):
        observation, _ = env.reset(seed=0)
        _, (*_, info) = go_down(env, observation, -DEPTH, gripper=1.0, speed=speed)
        assert info["end"] == "fault"
        substeps.append(int(env.simulation.world.substeps[0]))
    # A whole period has 16 or 17, and not all collisions come in the last of them.
    assert min(substeps) < (16 if stepping == "async" else 500)


@pytest.mark.parametrize(("robot", "end_effector"), ARMS)
def test_a_grasp_and_setting_down_what_is_held_are_no_collisions(robot: str, end_effector: str | None) -> None:
    env = make(robot, end_effector, task="Place", control="joints" if robot == "so101" else "tquat")
    expert = agent_for(env)
    observation, info = env.reset(seed=2)
    expert.reset(observation, info)
    was_grasped, is_over = False, False
    while not is_over:
        observation, _, is_over, _, info = env.step(expert.act(observation, info))
        assert info["end"] == "period", info
        was_grasped = was_grasped or bool(observation["is_grasped"].all())
    assert was_grasped
    assert info["success"]


def test_a_firm_push_is_no_collision() -> None:
    env = make()
    observation, _ = env.reset(seed=0)
    world = env.simulation.world
    hand = world.model.site_bodyid[env.simulation.robots[0].layout.tcp_site]
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        for share in np.linspace(0.0, 1.0, 10):
            world.data.xfrc_applied[hand, :3] = 35.0 * share * direction
            *_, info = env.step({"tquat": observation["tquat"], "gripper": np.ones(1, np.float32)})
            assert info["end"] == "period", info


def test_a_servo_that_is_overloaded_for_two_seconds_gives_up() -> None:
    env = make("so101")
    observation, _ = env.reset(seed=0)
    target = observation["tquat"].copy()
    touched, is_over, info = None, False, {}
    while not is_over:
        target[2] = max(target[2] - SPEED / env.frequency, -DEPTH)
        observation, _, _, is_over, info = env.step({"tquat": target, "gripper": np.ones(1, np.float32)})
        if touched is None and observation["tcp_wrench"].any():
            touched = info["time"]
    assert "torque at" in info["faults"]["so101"]
    assert "the limit is 2.352 Nm" in info["faults"]["so101"]
    assert touched is not None
    assert info["time"] > touched + 2.0 - 1 / env.frequency


def test_one_copy_collides_and_the_others_go_on() -> None:
    info: Any
    told: Any
    single = make()
    batch = rcs.make_vec(single.setup, copies=3, threads=2)
    seen, _ = single.reset(seed=1)
    observation, _ = batch.reset(seed=0)
    targets = observation["tquat"].copy()
    target = targets[1].copy()
    breaks = Breaks()
    batch.add_observer(breaks, copy=1)
    calm = Breaks()
    batch.add_observer(calm, copy=0)
    open_hands = np.ones((3, 1), np.float32)
    info, told = {}, {}
    for _ in range(300):
        target[2] = max(target[2] - SPEED / single.frequency, -DEPTH)
        targets[1] = target
        seen, _, _, over, told = single.step({"tquat": target, "gripper": open_hands[1]})
        observation, _, terminated, truncated, info = batch.step({"tquat": targets, "gripper": open_hands})
        require_same_bits(row(observation, 1), seen)
        assert not terminated.any()
        np.testing.assert_array_equal(truncated, [False, over, False])
        if over:
            break
    assert list(info["end"]) == ["period", "fault", "period"]
    assert list(info["faults"]["fr3"]) == ["", told["faults"]["fr3"], ""]
    assert breaks.ends == [("fault", told["faults"])]
    assert calm.ends == []
    # The next step starts the copy anew.
    targets = observation["tquat"].copy()
    _, _, _, truncated, info = batch.step({"tquat": targets, "gripper": open_hands})
    assert not truncated.any()
    assert "faults" not in info


def test_a_collision_counts_as_a_failure_of_the_agent() -> None:
    env = make()

    class Diver(Agent):
        def reset(self, observation: Any, info: Any) -> None:
            self._target = observation["tquat"].copy()

        def act(self, observation: Any, info: Any) -> Any:
            self._target[2] -= 0.1 / 30
            return {"tquat": self._target.copy(), "gripper": np.ones(1, np.float32)}

    result = run_episode(env, Diver(), seed=0)
    assert (result.success, result.failure) == (False, "fault")


def test_what_is_observed_of_a_collision_is_recorded(tmp_path: Any) -> None:
    env = make()
    with DatasetWriter.open(tmp_path, dataset_info(env)) as writer:
        recorder = Recorder(writer)
        env.add_observer(recorder)
        recorder.name_next("0")
        observation, _ = env.reset(seed=0)
        _, (last, *_) = go_down(env, observation, -DEPTH, gripper=1.0)
        env.reset(seed=1)
    (episode,) = Dataset.open(tmp_path).episodes
    assert episode.outcome["end"] == "fault"
    for key in ("joint_torques", "tcp_wrench", "finger_contacts", "is_grasped"):
        np.testing.assert_array_equal(episode.column(f"observation/{key}")[-1], last[key])
    poses = episode.column("observation/privileged/cuboid/tquat")
    np.testing.assert_array_equal(poses[-1], last["privileged"]["cuboid"]["tquat"])


class Breaks(Observer):
    """Remembers how episodes were broken off."""

    def __init__(self) -> None:
        self.ends: list[Any] = []

    def on_reset(self, first: Any, seed: Any) -> None:
        """Nothing."""

    def on_step(self, transition: Any) -> None:
        """Nothing."""

    def on_end(self, end: str, reasons: Any) -> None:
        self.ends.append((end, dict(reasons)))
