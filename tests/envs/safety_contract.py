"""Rules that hold when something goes wrong in an environment, of any robots and devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.envs.env import Env
from rcs.envs.layers import Layer, Relative
from rcs.envs.observer import Observer, Transition
from rcs.envs.spaces import JOINTS, TQUAT
from rcs.errors import InvalidAction, WrongOrder
from rcs.testing.env_contract import require_same_bits
from tests.envs.acting import chains_of, go, joints_of, lift, stay

MOVES_NOTHING = 0.03
"""A joint that moves by less than this stands still [rad]: simulated servos settle, and a grasped thing gives way."""
EXACT = 1e-3
"""A target that says "stay" is this close to the measured joints [rad]: inverse kinematics rounds."""
BRAKING = 0.8
"""Longest time in which an arm that was in motion is back where it was told to stay [s]."""
PUSH = 0.3
"""By how much an arm is pushed [rad]."""
REFUSALS = 8
"""How often an action is refused in a row."""

Action = dict[str, Any]


class Broken(Exception):
    """The error that the tests raise."""


class _BreaksAt(Layer, Observer):
    """A layer and an observer that raises an error in one of its methods, once it is told to."""

    def __init__(self) -> None:
        self.where = ""
        self.error: BaseException = Broken("broken on purpose")
        self.ends: list[tuple[str, dict[str, str]]] = []
        self.is_closed = False

    def _pass(self, where: str) -> None:
        if where == self.where:
            self.where = ""
            raise self.error

    def map_action(self, action: Any) -> Any:
        self._pass("map_action of a layer")
        return action

    def map_executed(self, executed: Any) -> Any:
        self._pass("map_executed of a layer")
        return executed

    def map_observation(self, observation: Any) -> Any:
        self._pass("map_observation of a layer")
        return observation

    def info(self) -> dict[str, Any]:
        self._pass("info of a layer")
        return {}

    def on_reset(self, first: Transition, seed: int | None) -> None:
        self._pass("on_reset of an observer")

    def on_step(self, transition: Transition) -> None:
        self._pass("on_step of an observer")

    def on_end(self, end: str, reasons: Mapping[str, str]) -> None:
        self.ends.append((end, dict(reasons)))
        self._pass("on_end of an observer")

    def close(self) -> None:
        self.is_closed = True
        self._pass("close of an observer")


PLACES = (
    "map_action of a layer",
    "map_executed of a layer",
    "map_observation of a layer",
    "info of a layer",
    "on_step of an observer",
    "command of a port",
    "observe of a port",
    "the clock",
    "the task",
)
"""Where an error may come from in a step."""


class SafetyContract:
    """Checks an environment of one robot or of several, simulated or not."""

    def make_env(self) -> Env:
        """Return a new environment, not reset. To be overridden."""
        raise NotImplementedError("override make_env and return a new environment")

    def let_time_pass(self, env: Env) -> None:
        """Let `BRAKING` pass for the devices, without a step of the environment. To be overridden for devices."""
        for _ in range(max(1, round(BRAKING * env.simulation.world.frequency))):
            env.simulation.world.advance()

    def push(self, env: Env) -> None:
        """Move the first joint of every arm by `PUSH`, as a person would. To be overridden for devices."""
        for robot in env.simulation.robots:
            joints = robot.joints
            joints[0] += PUSH
            env.simulation.world.qpos[..., robot.layout.qpos] = joints
        env.simulation.world.refresh()

    def env(self) -> closing[Env]:
        """Return an environment that is closed in the end."""
        return closing(self.make_env())

    def test_an_action_refused_again_and_again_changes_nothing(self) -> None:
        """The fault in it is the last that is checked: all others have been looked at by then."""
        with self.env() as env, self.env() as untouched:
            seen: list[Any] = []
            for one in (env, untouched):
                observation, _ = one.reset(seed=7)
                for _ in range(6):
                    if one is env:
                        bad = _spoilt(env, go(env, observation))
                        for _ in range(REFUSALS):
                            with pytest.raises(InvalidAction):
                                env.step(bad)
                    observation, *rest = one.step(go(one, observation))
                    seen.append((observation, rest[0], rest[-1]))
            require_same_bits(seen[:6], seen[6:])

    def test_after_hold_an_action_that_says_stay_moves_nothing(self) -> None:
        """Also when a target was far away when the devices were told to hold."""
        with self.env() as env:
            self.set_in_motion(env)
            env.hold()
            held = joints_of(env)
            self.require_that_stay_moves_nothing(env, held)

    def test_after_a_push_and_a_rebase_an_action_that_says_stay_moves_nothing(self) -> None:
        """It does not go back to where the arm stood before."""
        with self.env() as env:
            env.reset(seed=1)
            self.push(env)
            env.rebase()
            self.require_that_stay_moves_nothing(env, joints_of(env))

    def test_after_hold_and_a_push_an_action_that_says_stay_moves_nothing(self) -> None:
        """Devices that hold may be moved by hand; what counts is where they are at the next action."""
        with self.env() as env:
            self.set_in_motion(env)
            env.hold()
            self.push(env)
            self.require_that_stay_moves_nothing(env, joints_of(env))

    @pytest.mark.parametrize("kind", [Broken, KeyboardInterrupt], ids=["error", "Ctrl-C"])
    @pytest.mark.parametrize("where", PLACES)
    def test_an_error_in_a_step_holds_all_devices(self, where: str, kind: type[BaseException]) -> None:
        """Wherever it comes from; the episode is over, its observers are told, and a reset starts anew."""
        with self.env() as env:
            breaks = self.set_in_motion(env)
            observation = lift(env)
            undo = _arm(env, breaks, where, kind("broken on purpose"))
            with pytest.raises(kind):
                env.step(go(env, observation))
            undo()
            self.require_that_all_stand_still(env)
            assert [end for end, _ in breaks.ends] == ["exception"]
            assert list(breaks.ends[0][1]) == [kind.__name__]
            with pytest.raises(WrongOrder, match=kind.__name__):
                env.step(go(env, observation))
            env.reset(seed=3)
            env.step(stay(env, lift(env)))

    def test_a_reset_that_an_observer_breaks_off_is_no_start(self) -> None:
        """All devices hold, observers are told, and no step can be made before another reset."""
        with self.env() as env:
            breaks = self.set_in_motion(env)
            breaks.where = "on_reset of an observer"
            with pytest.raises(Broken):
                env.reset(seed=2)
            self.require_that_all_stand_still(env)
            assert breaks.ends == [("exception", {"Broken": "broken on purpose"})]
            with pytest.raises(WrongOrder, match="Broken"):
                env.step(go(env, lift(env)))
            env.reset(seed=3)
            env.step(stay(env, lift(env)))

    def test_a_second_ctrl_c_does_not_keep_a_device_from_holding(self) -> None:
        """It comes while the devices are told to hold, in each of them."""
        with self.env() as env:
            breaks = self.set_in_motion(env)
            undo = [_interrupt_once(port, "hold") for port in env.stack.ports]
            _arm(env, breaks, "on_step of an observer", KeyboardInterrupt())
            with pytest.raises(KeyboardInterrupt):
                env.step(go(env, lift(env)))
            for restore in undo:
                restore()
            self.require_that_all_stand_still(env)

    def test_a_device_that_fails_to_hold_keeps_no_other_from_it(self) -> None:
        """And the error that came first is raised, with a note of that."""
        with self.env() as env:
            breaks = self.set_in_motion(env)
            self.held.clear()
            restore = _raise_in(env.stack.ports[0], "hold", OSError("no answer"))
            _arm(env, breaks, "on_step of an observer", Broken("broken on purpose"))
            with pytest.raises(Broken) as caught:
                env.step(go(env, lift(env)))
            assert "no answer" in "".join(caught.value.__notes__)
            assert set(self.held) == set(_ports(env)[1:])
            restore()

    @pytest.mark.parametrize("kind", [OSError, KeyboardInterrupt], ids=["error", "Ctrl-C"])
    def test_close_closes_everything_whatever_fails(self, kind: type[BaseException]) -> None:
        """Devices first: what goes wrong beside a robot must not leave it open."""
        env = self.make_env()
        breaks, other = self.set_in_motion(env), _BreaksAt()
        env.add_observer(other)
        order = _note(env, "close")
        breaks.where, breaks.error = "close of an observer", kind("broken on purpose")
        with pytest.raises(kind):
            env.close()
        expected = _ports(env)
        assert order[: len(expected)] == expected
        assert breaks.is_closed
        assert other.is_closed
        env.close()

    @pytest.mark.parametrize("kind", [OSError, KeyboardInterrupt], ids=["error", "Ctrl-C"])
    def test_a_device_that_fails_to_close_keeps_no_other_open(self, kind: type[BaseException]) -> None:
        """And observers are closed all the same."""
        env = self.make_env()
        breaks = self.set_in_motion(env)
        order = _note(env, "close")
        failing = env.stack.ports[0].close

        def fail() -> None:
            failing()
            raise kind("broken on purpose")

        env.stack.ports[0].close = fail
        with pytest.raises(kind):
            env.close()
        assert set(order) == set(_ports(env))
        assert breaks.is_closed

    def test_when_a_port_does_not_open_none_stays_open(self) -> None:
        """Whether the reset is the first one or not; the next one opens all again."""
        env = self.make_env()
        order = _note(env, "close")
        restore = _raise_in(env.stack.ports[-1], "open", OSError("no cable"))
        with pytest.raises(OSError, match="no cable"):
            env.reset(seed=1)
        assert set(order) == set(_ports(env))
        with pytest.raises(WrongOrder):
            env.step(env.action_space.sample())
        restore()
        env.close()

    def test_a_step_inside_of_a_step_is_refused(self) -> None:
        """By a callback or an observer of the same environment."""
        with self.env() as env:
            refused: list[WrongOrder] = []

            class Steps(_BreaksAt):
                def on_step(self, transition: Transition) -> None:
                    for call in (env.reset, env.rebase, lambda: env.step(env.action_space.sample())):
                        with pytest.raises(WrongOrder, match="inside") as caught:
                            call()
                        refused.append(caught.value)

            env.add_observer(Steps())
            env.reset(seed=1)
            env.step(stay(env, lift(env)))
            assert len(refused) == 3

    # What the tests share.

    def set_in_motion(self, env: Env) -> _BreaksAt:
        """Reset, and have every arm on its way to a target that it has not reached; `held` then notes who holds."""
        breaks = _BreaksAt()
        for stack in chains_of(env).values():
            stack.layers.append(breaks)
        env.add_observer(breaks)
        observation, _ = env.reset(seed=1)
        for _ in range(3):
            observation, *_ = env.step(go(env, observation))
        self.held = _note(env, "hold")
        return breaks

    def require_that_all_stand_still(self, env: Env) -> None:
        """Check that every device was told to hold, and that no joint moves while time passes, once it has braked."""
        assert set(self.held) == set(_ports(env))  # an arm that goes on to its target also stands there in the end
        self.let_time_pass(env)
        before = joints_of(env)
        self.let_time_pass(env)
        for name, joints in joints_of(env).items():
            np.testing.assert_allclose(joints, before[name], atol=MOVES_NOTHING, err_msg=name)

    def require_that_stay_moves_nothing(self, env: Env, where: dict[str, NDArray[np.float64]]) -> None:
        """Check that an action that says "stay" sends all joints where they are, and again."""
        action = stay(env, lift(env))
        env.step(action)
        for name in chains_of(env):
            executed = env.stack.executed[name] if name else env.stack.executed
            np.testing.assert_allclose(executed[JOINTS], where[name], atol=EXACT, err_msg=name)
        for _ in range(round(BRAKING * env.setup.frequency)):
            env.step(action)
        for name, joints in joints_of(env).items():
            np.testing.assert_allclose(joints, where[name], atol=MOVES_NOTHING, err_msg=name)


def _spoilt(env: Env, action: Action) -> Action:
    """Return an action whose last entry, of the last robot, is not a number, or a pose without a direction."""
    name, stack = list(chains_of(env).items())[-1]
    inner = dict(action[name] if name else action)
    if TQUAT in inner:
        # Layers find this one, when others have mapped it already.
        inner[TQUAT] = np.array([*inner[TQUAT][:3], 0.0, 0.0, 0.0, 0.0])
        if not any(isinstance(layer, Relative) for layer in stack.layers):
            return {**action, name: inner} if name else inner
    key = list(inner)[-1]
    inner[key] = np.full_like(inner[key], np.nan)
    return {**action, name: inner} if name else inner


def _arm(env: Env, breaks: _BreaksAt, where: str, error: BaseException) -> Callable[[], None]:
    """Have the next step raise an error somewhere; return what takes that back."""
    breaks.error = error
    if where == "the clock":
        return _raise_in(env.clock, "advance", error)
    if where == "the task":
        if not env.is_simulated:
            pytest.skip("there is no task")
        return _raise_in(env.simulation.task, "evaluate", error)
    if where.endswith("a port"):
        return _raise_in(env.stack.ports[0], where.split()[0], error)
    breaks.where = where
    return lambda: None


def _raise_in(thing: Any, method: str, error: BaseException) -> Callable[[], None]:
    def fail(*_: Any) -> None:
        raise error

    setattr(thing, method, fail)
    return lambda: delattr(thing, method)


def _interrupt_once(thing: Any, method: str) -> Callable[[], None]:
    real, calls = getattr(thing, method), 0

    def interrupted() -> None:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise KeyboardInterrupt
        real()

    setattr(thing, method, interrupted)
    return lambda: delattr(thing, method)


def _ports(env: Env) -> list[str]:
    return [f"port {i}" for i in range(len(env.stack.ports))]


def _note(env: Env, method: str) -> list[str]:
    """Return the ports whose method is called from now on, in order."""
    order: list[str] = []

    def noted(name: str, real: Callable[[], None]) -> None:
        order.append(name)
        real()

    for name, port in zip(_ports(env), env.stack.ports, strict=True):
        setattr(port, method, partial(noted, name, getattr(port, method)))
    return order
