"""A stack puts ports, layers and gates together, and gives no action to a device that a gate refuses."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.envs.gates.gate import Gate
from rcs.envs.layers import Layer
from rcs.envs.ports.port import Port
from rcs.envs.step.chain import Chain
from rcs.envs.step.stack import Stack, for_all
from rcs.errors import InvalidSetup, Refused, UnknownName


class Eye(Port):
    """Gives one frame under a name."""

    def __init__(self, name: str, key: str = "rgb") -> None:
        self.action_spaces = {}
        box = spaces.Box(0, 255, (2, 2, 3), np.uint8)
        self.observation_spaces = {"frames": spaces.Dict({name: spaces.Dict({key: box})})}
        self._frame = {"frames": {name: {key: np.zeros((2, 2, 3), np.uint8)}}}

    def command(self, action: Any) -> None:
        """Do nothing."""

    def observe(self) -> dict[str, Any]:
        return self._frame


class Closed(Gate):
    """Lets nothing through while it is closed, and remembers what it was asked."""

    def __init__(self) -> None:
        self.is_closed = True
        self.targets: Any = None

    def admit(self, targets: Any, measured: Any) -> Any:
        self.targets = targets
        if self.is_closed:
            raise Refused("closed for lunch")
        return targets


class Slow(Gate):
    """Takes longer than it may."""

    deadline = 1e-3

    def admit(self, targets: Any, measured: Any) -> Any:
        time.sleep(0.01)
        return targets


class Forgetful(Gate):
    """Forgets the robot."""

    def admit(self, targets: Any, measured: Any) -> Any:
        return {}


class Halves(Gate):
    """Lets joints move half as far as they were told to."""

    def admit(self, targets: Any, measured: Any) -> Any:
        half = {name: (one["joints"] + measured[name]["joints"]) / 2 for name, one in targets.items() if one}
        return {name: {**one, "joints": half[name]} if one else one for name, one in targets.items()}


class Loud(Layer):
    """Tells how loud it is."""

    def info(self) -> dict[str, Any]:
        return {"loudness": np.array(11.0)}


def test_ports_that_give_parts_of_one_key_are_merged() -> None:
    chain = Chain([Eye("left"), Eye("right")])
    assert set(chain.observation_spaces["frames"].spaces) == {"left", "right"}  # pyright: ignore[reportAttributeAccessIssue]
    measured = chain.measure()
    assert set(measured["frames"]) == {"left", "right"}
    assert spaces.Dict(chain.observation_spaces).contains(measured)


def test_two_ports_that_give_the_same_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="frames/left/rgb"):
        Chain([Eye("left"), Eye("left")])
    assert Chain([Eye("left"), Eye("left", "infrared")])


def test_a_robot_must_not_have_the_name_of_a_key() -> None:
    with pytest.raises(InvalidSetup, match="'frames'"):
        Stack({"frames": Chain([]), "": Chain([Eye("left")])})


@pytest.mark.parametrize("robot", ["fr3", "dual_fr3"])
def test_what_a_gate_refuses_reaches_no_device_and_the_episode_goes_on(robot: str) -> None:
    gate = Closed()
    env = rcs.make("Free", robot=robot, gates=[gate])
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        action = env.action_space.sample()
        observation, _, terminated, truncated, info = env.step(action)
        assert info["refused"] == "closed for lunch"
        assert not terminated
        assert not truncated
    joints = [
        part["joints"]
        for part in ([observation["left"], observation["right"]] if robot == "dual_fr3" else [observation])
    ]
    assert all(np.abs(own - [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]).max() < 0.02 for own in joints)
    gate.is_closed = False
    *_, info = env.step(env.action_space.sample())
    assert "refused" not in info
    assert "gate: Closed" in str(env)
    assert "Closed" in str(env.limits())


@pytest.mark.parametrize("gate", [Slow, Forgetful])
def test_a_gate_that_is_late_or_wrong_fails_closed(gate: type[Gate]) -> None:
    env = rcs.make("Free", gates=[gate])
    start, _ = env.reset(seed=0)
    observation, *_, info = env.step(env.action_space.sample())
    assert gate.__name__ in info["refused"]
    assert np.abs(observation["joints"] - start["joints"]).max() < 0.01


class Answers(Gate):
    """Answers with what it is told to make of the targets."""

    def __init__(self, make: Callable[[dict[str, Any]], Any]) -> None:
        self.make = make

    def admit(self, targets: Any, measured: Any) -> Any:
        return self.make({name: dict(own) for name, own in targets.items()})


WRONG: dict[str, Callable[[dict[str, Any]], Any]] = {
    "nothing": lambda targets: None,
    "no robot": lambda targets: {},
    "another robot": lambda targets: {**targets, "third": targets[""]},
    "no action": lambda targets: {"": None},
    "a key less": lambda targets: {"": {"joints": targets[""]["joints"]}},
    "a key more": lambda targets: {"": {**targets[""], "knees": np.zeros(7)}},
    "too few": lambda targets: {"": {**targets[""], "joints": targets[""]["joints"][..., :3]}},
    "too many": lambda targets: {"": {**targets[""], "joints": targets[""]["joints"][None]}},
    "a text": lambda targets: {"": {**targets[""], "joints": "home"}},
    "ragged": lambda targets: {"": {**targets[""], "joints": [[0.0], 0.0]}},
    "not a number": lambda targets: {"": {**targets[""], "joints": np.full_like(targets[""]["joints"], np.nan)}},
    "far away": lambda targets: {"": {**targets[""], "joints": targets[""]["joints"] + 50.0}},
    "in place": lambda targets: targets[""]["joints"].__iadd__(50.0) is None or targets,
}


@pytest.mark.parametrize("copies", [None, 2])
@pytest.mark.parametrize("wrong", WRONG)
def test_what_a_gate_must_not_return_is_refused_by_its_name(wrong: str, copies: int | None) -> None:
    gate = Answers(WRONG[wrong])
    env: Any = rcs.make("Free", gates=[gate]) if copies is None else rcs.make_vec("Free", copies=copies, gates=[gate])
    start, _ = env.reset(seed=0)
    step = np.full(start["joints"].shape, 0.02)
    action = {"joints": step, "gripper": np.ones((*step.shape[:-1], 1), np.float32)}
    for _ in range(3):
        observation, _, terminated, truncated, info = env.step(action)
        assert "Answers returned" in info["refused"]
        assert not np.any(terminated | truncated)
        np.testing.assert_allclose(info["target"]["joints"], start["joints"], atol=0.01)
    assert np.abs(observation["joints"] - start["joints"]).max() < 0.01
    gate.make = lambda targets: targets
    *_, info = env.step(action)
    assert "refused" not in info


def test_layers_learn_what_a_gate_has_cut() -> None:
    env = rcs.make("Free", gates=[Halves()])
    start, _ = env.reset(seed=0)
    step = np.full(7, 0.02)
    *_, info = env.step({"joints": step, "gripper": np.ones(1)})
    np.testing.assert_allclose(info["target"]["joints"], start["joints"] + step / 2, atol=1e-12)


@pytest.mark.parametrize("hardware", [None, "fake"])
def test_a_gripper_keeps_its_last_target_when_a_gate_refuses_another(hardware: str | None) -> None:
    gate = Closed()
    gate.is_closed = False
    closing = {"joints": np.zeros(7), "gripper": np.zeros(1)}
    with rcs.make("Free", gates=[gate], hardware=hardware) as env:
        env.reset(seed=0)
        env.step(closing)
        gate.is_closed = True
        observation, *_, info = env.step({**closing, "gripper": np.ones(1)})
        assert observation["gripper"] > 0.0, "it is on its way"
        assert info["target"]["gripper"] == env.stack.executed["gripper"] == 0.0
        if hardware is None:  # an episode begins with open fingers
            env.reset()
            *_, info = env.step(closing)
            assert info["target"]["gripper"] == 1.0


@pytest.mark.parametrize("layer", [Loud, Loud(), f"{__name__}:Loud"])
def test_own_layers_are_given_as_objects_classes_or_names(layer: Any) -> None:
    env = rcs.make("Free", layers=[layer])
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[-1]["loudness"] == 11.0
    assert "Loud" in str(env)
    assert "# Tells how loud it is" in str(env)
    both = rcs.make_vec("Free", copies=2, layers=[Loud])
    both.reset(seed=0)


@pytest.mark.parametrize("hardware", [None, "fake:192.0.2.1"])
def test_arms_are_commanded_right_after_one_another(hardware: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    given = hardware and {"left": hardware, "right": "fake:192.0.2.2"}
    with rcs.make("Free", robot="dual_fr3", control="joints", relative=True, hardware=given) as env:
        env.reset(seed=0)
        commanded: list[str] = []
        for name, chain in env.stack.chains.items():
            for port in chain.ports:
                key = next(iter(port.action_spaces), "")
                monkeypatch.setattr(port, "command", lambda action, one=f"{name}/{key}": commanded.append(one))
        action = {"joints": np.zeros(7), "gripper": np.ones(1)}
        env.step({"left": action, "right": action})
    taken = [one for one in commanded if not one.endswith("/")]
    assert taken == ["left/joints", "right/joints", "left/gripper", "right/gripper"]


def test_two_robots_do_not_share_a_layer() -> None:
    with pytest.raises(InvalidSetup, match="each robot its own"):
        rcs.make("Free", robot="dual_fr3", layers=[Loud()])
    env = rcs.make("Free", robot="dual_fr3", layers={"left": [Loud()]})
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[-1]["left/loudness"] == 11.0
    assert rcs.make("Free", robot="dual_fr3", layers=[Loud])
    with pytest.raises(UnknownName, match="left"):
        rcs.make("Free", robot="dual_fr3", layers={"lift": [Loud()]})


@pytest.mark.parametrize("given", [3, "no_such_layer", "no.such.module:Layer", "rcs.envs.step.stack:Stack2", Gate])
def test_what_is_no_layer_is_refused(given: Any) -> None:
    with pytest.raises((InvalidSetup, UnknownName, TypeError)):
        rcs.make("Free", layers=[given])


def test_time_is_that_of_the_simulation_or_of_the_host(make_bench: Callable[..., Any]) -> None:
    env = rcs.make("Free")
    assert env.reset(seed=0)[1]["time"] == 0.0
    assert env.step(env.action_space.sample())[-1]["time"] == pytest.approx(0.032)
    bench = make_bench()
    assert bench.env.reset(seed=0)[1]["time"] == 100.0
    *_, info = bench.env.step({"joints": np.zeros(7), "gripper": np.ones(1)})
    assert info["time"] == pytest.approx(100.0 + 1 / 30)
    assert info["late"] == 0.0
    assert set(info["ages"]) == {"joints", "gripper"}


def test_in_real_time_a_step_says_how_late_it_is_and_how_old_its_readings_are() -> None:
    env = rcs.make("Free", hardware="fake", frequency=50.0)
    env.reset(seed=0)
    for _ in range(3):
        *_, info = env.step(env.action_space.sample())
        assert all(0.0 <= age < 1.0 for age in info["ages"].values())
        assert info["late"] >= 0.0
    time.sleep(0.1)
    assert env.step(env.action_space.sample())[-1]["late"] > 0.05
    env.close()


def test_a_call_that_ctrl_c_interrupts_is_made_again_before_the_others() -> None:
    made: list[str] = []

    def interrupted() -> None:
        made.append("first")
        if len(made) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        for_all([interrupted, lambda: made.append("second")])
    assert made == ["first", "first", "second"]
