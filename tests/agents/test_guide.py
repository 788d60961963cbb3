"""A target that is dragged becomes actions, and the arm arrives: every control mode, every robot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents.guide import JOINT_SPEED, SPEED, Guide
from rcs.envs import Gate
from rcs.envs.layers import Layer
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, Refused
from rcs.rollout.interactive.session import Session, playable
from rcs.spatial import compose, distance


@contextmanager
def quick(task: str = "Free", robot: str = "fr3", **options: Any) -> Iterator[tuple[Session, Guide]]:
    """A session that does not wait for the wall clock, and the guide of its first robot."""
    with Session(replace(playable(Setup(task=task, robot=robot, **options)), stepping="async")) as session:
        yield session, next(iter(session.guides.values()))


def run(session: Session, seconds: float) -> None:
    for _ in range(round(30 * seconds)):
        session.step()
    assert not session.problem


@pytest.mark.parametrize(
    ("control", "relative"),
    [
        *((control, how) for control in ("joints", "tquat", "xyzrpy") for how in ("last_step", "origin", "absolute")),
        ("twist", "last_step"),
    ],
)
def test_the_tcp_arrives_where_the_target_is_dragged(control: Any, relative: Any) -> None:
    with quick(control=control, relative=relative) as (session, guide):
        goal = guide.tcp_in_scene
        goal[:3] += 0.06, 0.05, -0.08
        guide.lead_to(goal)
        run(session, 3.0)
        assert (distance(guide.tcp_in_scene, goal) < (2e-3, 2e-2)).all()
        assert not guide.is_out_of_reach


def test_under_a_layer_that_keeps_the_tilt_the_tcp_arrives_and_turns_about_the_vertical() -> None:
    with quick(control="xyzrpy", relative="last_step", layers=("KeepTilt",)) as (session, guide):
        goal = compose(guide.tcp_in_scene, (0.0, 0.0, 0.0, 0.0, 0.0, np.sin(0.2), np.cos(0.2)))  # the tool points down
        goal[:3] += 0.06, 0.05, -0.08
        guide.lead_to(goal)
        run(session, 3.0)
        assert (distance(guide.tcp_in_scene, goal) < (2e-3, 2e-2)).all()


@pytest.mark.parametrize(
    ("robot", "end_effector"), [("ur5e", None), ("xarm7", None), ("so101", None), ("dual_fr3", None), ("fr3", "none")]
)
def test_every_robot_follows_the_target_in_the_scene(robot: str, end_effector: str | None) -> None:
    with quick(robot=robot, end_effector=end_effector) as (session, guide):
        goals = {name: own.tcp_in_scene for name, own in session.guides.items()}
        for name, goal in goals.items():
            goal[2] -= 0.03
            session.guides[name].lead_to(goal)
        run(session, 3.0)
        for name, goal in goals.items():
            assert distance(session.guides[name].tcp_in_scene, goal)[0] < 3e-3, name
        assert guide.has_opening is (end_effector != "none")


def test_the_target_moves_no_faster_than_a_person_may_be_beside_it() -> None:
    with quick(control="tquat", relative="absolute") as (session, guide):
        goal = guide.tcp_in_scene
        goal[:3] += 0.0, 0.25, -0.1
        guide.lead_to(goal)
        targets = places = [guide.tcp_in_scene[:3]]
        for _ in range(30):
            session.step()
            targets = [*targets, session.info["target"]["tquat"][:3]]
            places = [*places, guide.tcp_in_scene[:3]]
        steps = np.linalg.norm(np.diff(targets, axis=0), axis=1)
        assert steps[1:].max() <= SPEED / 30 + 1e-6
        assert steps[1:].max() == pytest.approx(SPEED / 30, rel=1e-3)
        assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.25 / 30


def test_sliders_of_joints_lead_the_joints_in_a_straight_line_below_their_limits() -> None:
    with quick() as (session, guide):
        start = guide.joints
        goal = start + np.array([0.5, -0.2, 0.1, 0.3, 0.0, 0.2, -0.4])
        guide.lead_joints_to(goal)
        way = []
        for _ in range(60):
            session.step()
            way.append(session.info["target"]["joints"])
        np.testing.assert_allclose(session.observation["joints"], goal, atol=2e-3)
        part = (np.array(way) - start) @ (goal - start) / ((goal - start) @ (goal - start))
        np.testing.assert_allclose(np.array(way), start + np.outer(part, goal - start), atol=1e-6)
        fastest = np.abs(np.diff(way, axis=0)).max(axis=0) * 30
        assert (fastest <= JOINT_SPEED * np.array(guide.robot.arm.velocity_limit) + 1e-6).all()


def test_the_target_goes_along_with_the_joints_and_the_arm_does_not_jump_when_it_is_dragged_again() -> None:
    with quick() as (session, guide):
        joints = guide.joints
        joints[0] += 0.4
        guide.lead_joints_to(joints)
        assert guide.is_by_joints
        run(session, 3.0)
        assert (distance(guide.tcp_in_scene, guide.goal_in_scene) < (2e-3, 1e-2)).all()
        before = session.observation["joints"]
        guide.lead_to(guide.goal_in_scene)
        assert not guide.is_by_joints
        run(session, 1.0)
        np.testing.assert_allclose(session.observation["joints"], before, atol=5e-3)


def test_joints_beyond_their_limits_are_cut() -> None:
    with quick() as (_, guide):
        guide.lead_joints_to(np.full(7, 100.0))
        np.testing.assert_array_equal(guide.joints, guide.upper)


def test_a_target_out_of_reach_is_told_and_one_within_reach_goes_on() -> None:
    with quick() as (session, guide):
        home = guide.tcp_in_scene
        far = home + np.array([2.0, 0, 0, 0, 0, 0, 0])
        guide.lead_to(far)
        run(session, 6.0)
        assert guide.is_out_of_reach
        far_out = distance(guide.tcp_in_scene, home)[0]
        guide.lead_to(home)
        run(session, 1.5 + far_out / SPEED)  # the target has not run away from the arm
        assert not guide.is_out_of_reach
        assert distance(guide.tcp_in_scene, home)[0] < 3e-3


def test_an_arm_that_is_held_up_is_told_as_well() -> None:
    with quick("PickCuboid", control="tquat", collision_reaction=False) as (session, guide):
        goal = guide.tcp_in_scene
        goal[2] = -0.03  # below the table top
        guide.lead_to(goal)
        run(session, 5.0)
        assert guide.is_out_of_reach
        assert guide.tcp_in_scene[2] > -0.03


def test_to_stay_is_to_want_what_is() -> None:
    with quick() as (session, guide):
        goal = guide.tcp_in_scene
        goal[2] -= 0.3
        guide.lead_to(goal)
        run(session, 0.5)
        guide.stay()
        place = guide.tcp_in_scene
        run(session, 2.0)
        assert distance(guide.tcp_in_scene, place)[0] < 0.03


@pytest.mark.parametrize("is_by_joints", [False, True])
def test_an_arm_that_is_led_again_before_it_has_braked_begins_where_it_is(is_by_joints: bool) -> None:
    with quick(control="tquat", relative="absolute") as (session, guide):
        goal = guide.tcp_in_scene
        goal[:3] += 0.0, 0.25, -0.1
        guide.lead_to(goal)
        run(session, 3.0)
        guide.brake()
        place = guide.tcp_in_scene
        if is_by_joints:
            guide.lead_joints_to(guide.joints)
        else:
            guide.lead_to(place)
        for _ in range(10):
            session.step()
            assert distance(guide.tcp_in_scene, place)[0] < 2e-3


def test_the_gripper_opens_as_far_as_it_is_told_and_a_hand_as_a_whole() -> None:
    with quick() as (session, guide):
        guide.opening = 0.4
        run(session, 2.0)
        assert session.observation["gripper"][0] == pytest.approx(0.4, abs=0.02)
    with quick(robot="xarm7") as (session, guide):
        guide.opening = 0.0
        run(session, 2.0)
        assert session.observation["gripper"][0] < 0.3


class Renamed(Layer):
    """Gives an action another name, as only a policy would."""

    def action_spaces(self, inner: Any) -> Any:
        return {f"policy_{key}": box for key, box in inner.items()}

    def map_action(self, action: Any) -> Any:
        return {key.removeprefix("policy_"): value for key, value in action.items()}

    def map_executed(self, executed: Any) -> Any:
        return {f"policy_{key}": value for key, value in executed.items()}


def test_actions_that_only_a_policy_makes_are_refused_with_what_a_person_can_lead() -> None:
    setup = Setup(task="Free", layers=(f"{__name__}:Renamed",))
    with pytest.raises(InvalidSetup, match=r"policy_gripper.*a person can lead it with the keys.*'gripper', 'joints'"):
        Session(setup)


class RefuseOnce(Gate):
    """Refuses the twentieth action."""

    def __init__(self) -> None:
        self.count = 0

    def admit(self, targets: Any, measured: Any) -> Any:
        self.count += 1
        if self.count == 20:
            raise Refused("not now")
        return targets


@pytest.mark.parametrize("relative", ["origin", "last_step", "absolute"])
def test_after_a_refusal_the_target_goes_on_from_where_the_arm_is(relative: Any) -> None:
    with quick(relative=relative, gates=(f"{__name__}:RefuseOnce",)) as (session, guide):
        goal = guide.tcp_in_scene
        goal[:3] += 0.0, 0.2, 0.0
        guide.lead_to(goal)
        steps = []
        for i in range(60):
            before = session.observation["joints"]
            session.step()
            assert ("refused" in session.info) is (i == 19)
            steps.append(np.abs(session.info["target"]["joints"] - before).max())
        assert max(steps[20:24]) < max(steps[:19]) + 0.02
        run(session, 2.0)
        assert distance(guide.tcp_in_scene, goal)[0] < 3e-3


def test_a_real_gripper_that_a_reset_has_opened_stays_open() -> None:
    with rcs.make("Free", hardware="fake", binary_gripper=False, max_episode_steps=None) as env:
        guide = Guide(env, next(iter(env.robots.values())))
        observation, info = env.reset(seed=0)
        guide.reset(observation)
        guide.opening = 0.0
        for _ in range(3):
            observation, *_, info = env.step(guide.act(observation, info))
        start = {"joints": observation["joints"], "gripper": np.ones(1)}
        observation, _ = env.reset(options={"robot": start, "may_move": True})
        guide.reset(observation)
        assert guide.opening == 1.0
