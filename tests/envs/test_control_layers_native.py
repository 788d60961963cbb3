"""Poses and twists that go to the controllers of real arms, by the setup's `native`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import Dataset

import rcs
from rcs.cli.setup_options import Flags, SetupOptions
from rcs.devices import Arm, CommandKind
from rcs.devices.fakes import Body, FakeArm, FakeGripper
from rcs.envs.env import Env
from rcs.envs.gates.gate import Gate
from rcs.envs.observers.record import record_all
from rcs.errors import InvalidSetup, Refused
from rcs.hardware import Site
from rcs.hardware.site import DeviceAddress
from rcs.kinematics import kinematics_of
from rcs.robots import FR3, FRANKA_HAND
from rcs.spatial import Pose

HOME = np.array(FR3.home)
KINEMATICS = kinematics_of(FR3, FRANKA_HAND)
UP = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
SHUT = np.zeros(1, np.float32)


class NativeArm(FakeArm):
    """An arm whose controller leads the TCP: to a pose as fast as the joints may, at a twist along a straight line."""

    def __init__(self, *more: CommandKind) -> None:
        kinds = set(more or (CommandKind.pose, CommandKind.twist))
        Arm.__init__(self, "native arm", FR3.arm_limits, kinds)
        self.body = Body(time.monotonic, HOME, FR3.velocity_limit)
        self.sent: list[tuple[str, Any]] = []

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        self.sent.append(("joints", np.array(joints)))
        self._go(np.array(joints), np.array(FR3.velocity_limit))

    def _command_pose(self, pose: Pose) -> None:
        self.sent.append(("pose", pose.tquat))
        self._go(KINEMATICS.inverse(pose, self.body.values).joints, np.array(FR3.velocity_limit))

    def _command_twist(self, twist: NDArray[np.float64]) -> None:
        self.sent.append(("twist", np.array(twist)))
        speeds = np.linalg.pinv(KINEMATICS.jacobian(self.body.values)) @ twist
        self._go(self.body.values + 10.0 * speeds, np.abs(speeds))

    def _go(self, target: NDArray[np.float64], speed: NDArray[np.float64]) -> None:
        self.body.move()
        self.body.target, self.body._speed, self.body.has_power = target, speed, True


class Watches(Gate):
    """Looks at no joints, and may refuse."""

    needs_joints = False

    def __init__(self) -> None:
        self.seen: list[Any] = []
        self.refuses = False

    def admit(self, targets: Any, measured: Any) -> Any:
        self.seen.append(targets[""])
        if self.refuses:
            raise Refused("not now")
        return targets


class Passes(Gate):
    """Does not say that it needs no joints."""

    def admit(self, targets: Any, measured: Any) -> Any:
        return targets


def make(arm: Arm, control: Any = "tquat", **options: Any) -> Env:
    site = Site(arms={"fr3": arm}, grippers={"fr3": FakeGripper(speed=5.0)}, arm_stale_after=60.0, stale_after=60.0)
    return rcs.make("Free", hardware=site, control=control, native=True, **{"frequency": 50.0, **options})


def kinds(arm: NativeArm) -> set[str]:
    return {kind for kind, _ in arm.sent}


@pytest.mark.parametrize("control", ["tquat", "xyzrpy"])
def test_the_controller_gets_the_pose_and_reaches_it(control: Any) -> None:
    arm = NativeArm()
    goal = KINEMATICS.forward(HOME) * Pose.from_rpy([0.02, 0.03, -0.04], [0.0, 0.1, 0.2])
    with make(arm, control, relative="absolute") as env:
        env.reset()
        assert not arm.sent
        for _ in range(20):
            observation, *_, info = env.step({control: getattr(goal, control), "gripper": SHUT})
            np.testing.assert_array_equal(arm.sent[-1][1], env.stack.executed["tquat"])
        assert Pose.from_tquat(observation["tquat"]).is_close(goal, 1e-4, 1e-4)
        assert not info["is_limited"]
    assert kinds(arm) == {"pose"}


def test_a_far_pose_is_approached_at_the_speeds_of_the_description() -> None:
    arm = NativeArm()
    start = KINEMATICS.forward(HOME)
    with make(arm, relative="absolute") as env:
        env.reset()
        far = start.tquat + [0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]
        for _ in range(4):
            *_, info = env.step({"tquat": far, "gripper": SHUT})
            assert info["is_limited"]
    places = np.array([start.translation, *(pose[:3] for _, pose in arm.sent)])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps == pytest.approx(np.sqrt(3.0) * FR3.tcp_speed / 50.0, rel=1e-6)


def test_a_relative_pose_counts_from_the_last_target() -> None:
    arm = NativeArm()
    start = KINEMATICS.forward(HOME)
    with make(arm, "xyzrpy") as env:
        env.reset()
        for i in range(1, 6):
            env.step({"xyzrpy": 0.05 * UP, "gripper": SHUT})
            assert arm.sent[-1][1][:3] == pytest.approx(start.translation + [0.0, 0.0, 0.005 * i])


def test_a_twist_moves_the_tcp_at_the_velocity_until_its_time_is_over() -> None:
    arm = NativeArm()
    with make(arm, "twist") as env:
        first, _ = env.reset()
        begin = None
        for _ in range(25):
            observation, *_, info = env.step({"twist": UP, "gripper": SHUT})
            begin = begin or (info["time"], observation["tquat"][2])
            np.testing.assert_array_equal(arm.sent[-1][1], UP)
        speed = (observation["tquat"][2] - begin[1]) / (info["time"] - begin[0])
        assert speed == pytest.approx(0.1, rel=0.1)
        assert observation["tquat"][:2] == pytest.approx(first["tquat"][:2], abs=1e-3)
        assert info["target"]["tquat"][2] == pytest.approx(observation["tquat"][2], abs=5e-3)
        time.sleep(0.3)  # more than three periods
        stands = arm.state().joints
        time.sleep(0.1)
        np.testing.assert_array_equal(arm.state().joints, stands)
    assert kinds(arm) == {"twist"}


def test_what_was_sent_is_recorded(tmp_path: Path) -> None:
    for control in ("tquat", "twist"):
        arm = NativeArm()
        with make(arm, control) as env, record_all(env, tmp_path / control):
            env.reset()
            for _ in range(5):
                env.step(
                    {
                        control: np.array([0.0, 0.0, 0.001, 0.0, 0.0, 0.0, 1.0]) if control == "tquat" else UP,
                        "gripper": SHUT,
                    }
                )
        (episode,) = Dataset.open(tmp_path / control)
        sent = np.array([values for _, values in arm.sent])
        np.testing.assert_array_equal(episode.column(f"executed/{control}")[1:], sent[:5])
        assert "executed/joints" not in {feature.key for feature in episode.info.features}


@pytest.mark.parametrize("control", ["tquat", "twist"])
def test_a_refusal_holds_the_arm_and_the_next_action_counts_from_there(control: Any) -> None:
    arm, gate = NativeArm(), Watches()
    still = np.eye(7)[6] if control == "tquat" else np.zeros(6)
    moving = still + np.append(UP, np.zeros(len(still) - 6)) * (0.1 if control == "tquat" else 1.0)
    with make(arm, control, gates=[gate]) as env:
        env.reset()
        env.step({control: moving, "gripper": SHUT})
        gate.refuses = True
        *_, info = env.step({control: moving, "gripper": SHUT})
        assert "not now" in info["refused"]
        count, stands = len(arm.sent), arm.state().joints
        gate.refuses = False
        observation, *_ = env.step({control: still, "gripper": SHUT})
        assert len(arm.sent) == count + 1
        np.testing.assert_allclose(observation["joints"], stands, atol=1e-4)
    assert {key for targets in gate.seen for key in targets} == {control, "gripper"}


def test_an_arm_goes_to_its_start_and_home_by_joints() -> None:
    arm, gate = NativeArm(), Watches()
    with make(arm, "twist", gates=[gate], at_end="park") as env:
        options = {"robot": {"joints": HOME + 0.1}, "may_move": True, "speed": 1.0}
        observation, _ = env.reset(options=options)
        np.testing.assert_allclose(observation["joints"], HOME + 0.1, atol=1e-6)
        assert kinds(arm) == {"joints"}
        for _ in range(3):
            env.step({"twist": UP, "gripper": SHUT})
        assert kinds(arm) == {"joints", "twist"}
        assert env.limits().robots["fr3"].joint_upper == pytest.approx(FR3.joint_upper)
    np.testing.assert_allclose(arm.body.values, HOME, atol=1e-6)
    assert all("gripper" in targets for targets in gate.seen)


@pytest.mark.parametrize(
    ("more", "control", "match"),
    [
        ((CommandKind.velocities,), "xyzrpy", r"need an arm that takes pose; native arm takes joints, velocities\."),
        ((CommandKind.pose,), "twist", r"need an arm that takes twist; native arm takes joints, pose\."),
    ],
)
def test_an_arm_that_does_not_name_the_command_is_refused(more: Any, control: Any, match: str) -> None:
    with pytest.raises(InvalidSetup, match=match + r".*'tcp', give it: \[0, 0, 0\.1034, 0, 0, -0\.38"):
        make(NativeArm(*more), control)


@pytest.mark.parametrize("gate", ["Guard", Passes])
@pytest.mark.parametrize("hardware", [None, "fake"])
def test_gates_that_look_at_joints_are_refused_in_simulation_too(gate: Any, hardware: Any) -> None:
    with pytest.raises(InvalidSetup, match="looks at joints"):
        rcs.make("Free", control="twist", native=True, gates=[gate], hardware=hardware)


def test_another_tcp_than_that_of_the_setup_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from rcs.hardware.fake import FakeDriver

    monkeypatch.setattr(FakeDriver, "arm", lambda *_: NativeArm())
    own = (KINEMATICS.forward(HOME).inverse() * kinematics_of(FR3).forward(HOME)).inverse().tquat
    for tcp, is_right in (((0.0, 0.0, 0.1034, 0.0, 0.0, 0.0, 1.0), False), (own, True)):
        arm = DeviceAddress(driver="fake", options={"tcp": list(tcp)})
        if is_right:
            rcs.make("Free", control="tquat", native=True, hardware={"fr3": arm, "fr3/gripper": "fake"}).close()
            continue
        with pytest.raises(InvalidSetup, match="would lead another point"):
            rcs.make("Free", control="tquat", native=True, hardware={"fr3": arm, "fr3/gripper": "fake"})


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"control": "joints"}, "valid with it: 'tquat', 'xyzrpy', 'twist'"),
        ({"control": "twist", "stepping": "sync"}, "does not report it"),
        ({"control": "twist", "native": "yes"}, "native is 'yes'; valid: True, False"),
    ],
)
def test_what_makes_no_sense_is_refused(options: dict[str, Any], match: str) -> None:
    with pytest.raises(InvalidSetup, match=match):
        rcs.Setup.from_json({"native": True, **options})


@pytest.mark.parametrize("control", ["tquat", "xyzrpy", "twist"])
def test_in_simulation_the_same_setup_takes_the_usual_way(control: Any) -> None:
    seen: list[Any] = []
    for native in (False, True):
        with rcs.make("Free", control=control, native=native) as env:
            observation, _ = env.reset(seed=3)
            env.action_space.seed(5)
            for _ in range(5):
                observation, *_ = env.step(env.action_space.sample())
            assert "joints" in env.stack.executed_spaces
            seen.append(observation["joints"])
    np.testing.assert_array_equal(*seen)


def test_a_twin_needs_joint_targets() -> None:
    with make(NativeArm()) as env, pytest.raises(InvalidSetup, match="joint targets"), rcs.attach_twin(env):
        pass


def test_the_command_line_has_it() -> None:
    assert SetupOptions(task="Free", environment=Flags(control="twist", native=True)).setup().native
