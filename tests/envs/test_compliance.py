"""Environments whose arms give way: the same laws as with stiff arms, and devices that cannot are refused."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices.fakes import FakeArm
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.hardware import FakeDriver
from rcs.kinematics.chain import damped
from rcs.robots import FR3, FRANKA_HAND, Compliance
from rcs.testing.env_contract import require_same_bits

SOFT = {"joints": Compliance(joints=150), "tcp": Compliance(tcp=(600, 30))}


def make(kind: str, **options: Any) -> Any:
    return rcs.make("PickCuboid", compliance=SOFT[kind], max_episode_steps=None, **options)


def actions(env: Any, count: int, seed: int = 0) -> list[Any]:
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(count)]


def bias_of(env: Any) -> float:
    """Return the change of the force of the first joint's servo per radian."""
    robot = env.simulation.robots[0]
    return robot.world.model.actuator_biasprm[robot.layout.actuator_ids[0], 1]


@pytest.mark.parametrize("kind", SOFT)
def test_a_state_goes_on_with_the_same_bits_in_another_environment(kind: str) -> None:
    one, other = make(kind), make(kind)
    one.reset(seed=3)
    other.reset(seed=4)
    drawn = actions(one, 12)
    for action in drawn[:5]:
        one.step(action)
        other.step(action)
    other.set_state(one.get_state())
    for action in drawn[5:]:
        require_same_bits(copy.deepcopy(one.step(action)[0]), copy.deepcopy(other.step(action)[0]))
    one.close()
    other.close()


@pytest.mark.parametrize("kind", SOFT)
def test_a_copy_of_a_batch_is_a_single_environment(kind: str) -> None:
    one = make(kind)
    many = rcs.make_vec("PickCuboid", copies=2, compliance=SOFT[kind], max_episode_steps=None)
    one.reset(seed=7)
    many.reset(seed=7)
    for action in actions(one, 8):
        observation = one.step(action)[0]
        every = many.step({key: np.stack([value] * 2) for key, value in action.items()})[0]
        np.testing.assert_array_equal(every["joints"][0], observation["joints"])
    one.close()
    many.close()


@pytest.mark.parametrize("kind", SOFT)
def test_an_arm_that_collides_goes_into_its_fault_state_when_it_presses_too_hard(kind: str) -> None:
    env = make(kind, control="tquat", relative="absolute")
    observation, _ = env.reset(seed=0)
    target, info = observation["tquat"].copy(), {}
    for _ in range(300):
        target[2] = max(target[2] - 0.003, -0.1)
        _, _, _, truncated, info = env.step({"tquat": target, "gripper": np.ones(1, np.float32)})
        if truncated:
            break
    assert info["end"] == "fault"
    assert "collision: " in info["faults"]["fr3"]
    env.close()


@pytest.mark.parametrize("randomisation", [True, "strong"])
def test_joints_that_give_way_are_randomised_as_servos_are(randomisation: Any) -> None:
    env = make("joints", randomisation=randomisation)
    env.reset(seed=0)
    stiffness = -bias_of(env)
    assert 100.0 < stiffness < 200.0
    assert stiffness != 150.0
    env.close()


@pytest.mark.parametrize("driver", ["fake", "sim", "ur", "xarm", "so101"])
def test_drivers_without_compliance_refuse_it_with_the_robot_and_what_is_valid(driver: str) -> None:
    robot = {"ur": "ur5e", "xarm": "xarm7"}.get(driver, driver if driver == "so101" else "fr3")
    hardware = {robot: f"{driver}:192.0.2.1"}
    with pytest.raises(InvalidSetup, match=rf"{robot}.*'{driver}'.*simulated arms and .*'franka'"):
        rcs.make("Free", robot=robot, end_effector="none", hardware=hardware, compliance=Compliance(joints=100))


def test_an_arm_that_is_given_as_a_device_refuses_it() -> None:
    arm = FakeArm(FR3.arm_limits, start=np.array(FR3.home))
    with pytest.raises(InvalidSetup, match="give its address"):
        rcs.make("Free", hardware={"fr3": arm}, compliance=Compliance(joints=100))


class SoftDriver(FakeDriver):
    """Remembers the options of its arms."""

    gives_way = True
    given: Any = None

    def arm(self, address: str, about: Any, options: Any) -> Any:
        type(self).given = dict(options)
        return super().arm(address, about, {})


def test_a_driver_that_has_it_gets_all_the_numbers_that_the_simulation_has() -> None:
    name = f"{__name__}:SoftDriver"
    rcs.make("Free", hardware={"fr3": f"{name}:a"}, compliance=SOFT["tcp"]).close()
    assert SoftDriver.given == {"compliance": damped(SOFT["tcp"], FR3, FRANKA_HAND)}
    rcs.make("Free", hardware={"fr3": f"{name}:a"}).close()
    assert SoftDriver.given == {}
    entry = {"driver": name, "address": "a", "options": {"compliance": "tcp"}}
    with pytest.raises(InvalidSetup, match="set it in the setup instead"):
        rcs.make("Free", hardware={"fr3": entry})


def test_the_body_of_a_real_arm_follows_it_stiffly() -> None:
    name = f"{__name__}:SoftDriver"
    env = rcs.make("PickCuboid", hardware={"fr3": f"{name}:a"}, cameras=("side",), compliance=SOFT["tcp"])
    assert bias_of(env) == -4500.0
    env.close()


def test_arms_are_stiff_unless_a_setup_says_otherwise() -> None:
    assert Setup().compliance is None
    assert Setup.from_json({}).compliance is None
