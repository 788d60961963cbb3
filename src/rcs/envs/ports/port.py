"""Ports: what an environment needs of a device.

A port takes the device's part of an action and gives its part of an observation. Commands set targets and return; time
passes only in the environment's clock. Ports of simulated devices serve one copy and many.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, TypeGuard

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs._core import HostedArm
from rcs.devices import Arm, Gripper, GripperState, Hand, StreamedArm
from rcs.envs import spaces as keys
from rcs.envs.layers.limits import LimitStep
from rcs.envs.ports.device_calls import DeviceCalls, Freshness
from rcs.envs.spaces import Arrays, Observation
from rcs.errors import InvalidSetup
from rcs.kinematics import Kinematics
from rcs.sim.robot import SimRobot
from rcs.spatial import Pose

OVERSHOOT = 0.1
"""How far a joint may be measured outside its command limits [rad]: servos overshoot and collisions push."""

JUMP = 0.2
"""A joint that is farther from its body in the world than this is put there at once [rad]: an episode has begun."""


def is_streamed(device: object) -> TypeGuard[StreamedArm | HostedArm]:
    """Return whether a device is an arm that is streamed to, in this process or in its host."""
    return isinstance(device, StreamedArm) or (isinstance(device, HostedArm) and device.is_streamed)


class Port(ABC):
    """One device, or several that are read together, as keys of actions and observations."""

    action_spaces: Mapping[str, spaces.Box] = MappingProxyType({})
    """Space of every key that the port takes; none for a sensor."""
    observation_spaces: Mapping[str, spaces.Space[Any]]
    """Space of every key that the port gives."""
    joint_space: spaces.Box | None = None
    """Space of the joint targets of an arm."""
    timed: tuple[str, ...] = ()
    """Keys of `capture_times`, such as `joints` or `frames/wrist`."""
    memory: tuple[str, ...] = ()
    """Attributes that decide what follows, of a simulated device; see `Layer.memory`."""
    stale_after: float | None = None
    """Age from which what the port reads counts as stale [s]; None for never."""
    device: Arm | Gripper | Hand | None = None
    """The device that the port opens, holds and closes, where it is one behind a device interface."""

    freshness: Freshness | None = None
    """Knows when the device last measured something new, where the port looks after that."""
    follower: SimRobot | None = None
    """The body in the simulated world that is driven to where the device is measured."""

    @property
    def about(self) -> Mapping[str, Any]:
        """Facts about the port's sensors for datasets, as JSON values: dictionaries by name under each key.

        They are known before the port is open, and a dataset is only continued where they are the same.
        """
        return {}

    @property
    def device_facts(self) -> Mapping[str, Any]:
        """Facts that the port's open devices report, in the same form; each recorded episode has them."""
        return {}

    def command(self, action: Arrays) -> None:  # noqa: B027  a sensor takes no commands
        """Set the device's targets from the port's keys in a checked action; in a synchronous step, again and again."""

    @abstractmethod
    def observe(self) -> Observation:
        """Return the present observation, in arrays of its own."""

    def capture_times(self) -> dict[str, float]:
        """Return when each sensor was last read [s, monotonic clock of the host], by its key."""
        return {} if self.freshness is None else {self.timed[0]: self.freshness.time}

    def device_times(self) -> dict[str, float]:
        """Return the same moments on the devices' own clocks [s], by key; NaN for a device without one."""
        return {} if self.freshness is None else {self.timed[0]: self.freshness.device_time}

    def reconnections(self) -> dict[str, int]:
        """Return how often devices were connected again since `open`, by key, where they were."""
        return {}

    def ages(self) -> dict[str, Any]:
        """Return how old what is observed is in simulated time [s], by key, where it is late on purpose."""
        return {}

    def check(self) -> None:  # noqa: B027  most find out when they connect
        """Check, before any port is opened, what can be known of the device without connecting.

        Raises:
            InvalidSetup: It cannot be opened in this way.
        """

    def open(self) -> None:
        """Connect the device; it does not move."""
        if self.device is not None:
            self.device.open()

    def has_arrived(self) -> bool:
        """Return whether the device has reached its last target."""
        return self.device is None or self.device.has_arrived()

    def hold(self) -> None:
        """Make the device stay where it is."""
        if self.device is None or not self.device.is_open:
            return
        try:
            self.device.hold()
        except Exception:
            # A device was held when it entered its fault state, and may refuse it now; the fault's reason says more.
            if not self.device.fault:
                raise

    def kept(self) -> Arrays:
        """Return the targets that the device keeps while it holds, by key: what is between fingers must not fall."""
        return {}

    def rebase(self) -> None:  # noqa: B027  most have nothing to do
        """Make the device go on from where it is measured, if it still has a target elsewhere; a real one has none."""

    @property
    def can_fail(self) -> bool:
        """Whether `faults` can ever have an entry."""
        return self.device is not None or type(self).faults is not Port.faults

    def faults(self) -> Mapping[str, str]:
        """Return the reason of every device that is in its fault state, by the device's name.

        The environment asks for it while it waits, so it must answer at once.
        """
        return {} if self.device is None or not self.device.fault else {self.device.name: self.device.fault}

    def recover(self) -> None:
        """Clear the fault, if there is one; the device does not move."""
        if self.device is not None and self.device.is_open and self.device.fault:
            self.device.recover()

    def close(self) -> None:
        """Let go of the device; closing twice is harmless."""
        if self.device is not None:
            self.device.close()

    def _followed(self, measured: Observation) -> Observation:
        """Have the follower go where the device is measured; return the measurement."""
        if (body := self.follower) is not None:
            if keys.JOINTS in measured:
                if np.abs(measured[keys.JOINTS] - body.joints).max() > JUMP:
                    body.put(measured[keys.JOINTS])
                    body.world.refresh()
                body.command_joints(measured[keys.JOINTS])
            if keys.GRIPPER in measured:
                body.command_opening(measured[keys.GRIPPER])
            if keys.HAND in measured:
                body.command_hand(measured[keys.HAND])
        return measured


def arm_observation_spaces(joints: spaces.Box) -> dict[str, spaces.Space[Any]]:
    """Return the observation spaces of an arm with a space of joint commands."""
    return {
        keys.JOINTS: keys.measured(joints, OVERSHOOT),
        keys.TQUAT: keys.tquat_space(),
        keys.XYZRPY: keys.xyzrpy_space(),
        keys.JOINT_VELOCITIES: keys.velocities_space(joints.shape[0]),
    }


class ArmPort(Port):
    """Any arm behind the device interface, written in C++ or Python, simulated or real."""

    timed = (keys.JOINTS,)

    def __init__(
        self,
        arm: Arm,
        kinematics: Kinematics,
        *,
        native: Mapping[str, spaces.Box] | None = None,
        observed: Collection[keys.Observed] = (),
        effort: ArrayLike = (),
        limit: LimitStep | None = None,
        valid_for: float = math.inf,
        stale_after: float = math.inf,
    ) -> None:
        """Use an arm; it is opened by `open`.

        Args:
            arm: The device.
            kinematics: Gives the TCP pose from the measured joints; its range bounds targets beside the device's.
            native: Space of what its controller does with the TCP, `tquat` or `twist`, in the place of `joints`, which
                it takes all the same; None for joints.
            observed: `torques` and `wrench` are observed too, as the device measures them.
            effort: Largest joint torques [Nm], (dof,), where torques are observed.
            limit: Bounds how far each `command` goes of the way to its target; None for all of it.
            valid_for: How long a command is valid without another; then the arm holds [s].
            stale_after: Age of what the arm measures from which it is in its fault state [s].
        """
        box = keys.joints_space(
            np.maximum(arm.limits.joint_lower, kinematics.joint_lower),
            np.minimum(arm.limits.joint_upper, kinematics.joint_upper),
        )
        self.limit = limit
        """Bounds how far each `command` goes of the way to its target."""
        self._is_on_its_way = self._must_rebase = False
        self.device = self._arm = arm
        self._kinematics = kinematics
        self._valid_for = valid_for
        self.freshness = self._freshness = Freshness(arm, stale_after)
        self._target: NDArray[np.float64] | None = None
        self.joint_space = box
        self.action_spaces = {keys.JOINTS: box} if native is None else dict(native)
        self._loads = [key for name, key in keys.LOADS.items() if name in observed]
        loads = keys.load_spaces(effort)
        self.observation_spaces = {**arm_observation_spaces(box), **{key: loads[key] for key in self._loads}}

    def command(self, action: Arrays) -> None:
        """Send the joint target, or the next part of the way to it; or what the controller is to do with the TCP."""
        self._target = action.get(keys.JOINTS)
        if self._target is None:
            if keys.TWIST in action:
                self._arm.command_twist(action[keys.TWIST], self._valid_for)
            else:
                self._arm.command_pose(Pose.from_tquat(action[keys.TQUAT]), self._valid_for)
            return
        if self.limit is None:
            self._arm.command_joints(action[keys.JOINTS], self._valid_for)
            return
        measured: Observation = {keys.JOINTS: np.array(self._arm.state().joints)}
        if self._must_rebase:
            self._must_rebase = False  # before, for another thread may set it meanwhile
            self.limit.rebase(measured)
        self.limit.map_observation(measured)
        part = self.limit.map_action({keys.JOINTS: action[keys.JOINTS]})
        self._arm.command_joints(part[keys.JOINTS], self._valid_for)
        self.limit.map_executed(part)
        self._is_on_its_way = bool(self.limit.info()["is_limited"])

    def open(self) -> None:
        """Connect the arm; it does not move."""
        self._must_rebase = True
        super().open()

    def has_arrived(self) -> bool:
        """Return whether all of the way to the target was sent, and gone."""
        return not self._is_on_its_way and super().has_arrived()

    def hold(self) -> None:
        """Make the arm stay where it is, and forget the rest of its way."""
        self._must_rebase, self._is_on_its_way = True, False
        super().hold()

    def rebase(self) -> None:
        """Make the next way begin where the arm is measured then."""
        self._must_rebase = True

    def observe(self) -> Observation:
        """Measure joints and loads, and compute the TCP pose.

        Raises:
            InvalidSetup: The arm does not measure a load.
        """
        state = self._arm.state()
        self._freshness.judge(state, self._target)
        pose = self._kinematics.forward(state.joints)
        loads: Observation = {}
        for key in self._loads:
            loads[key] = np.array(state.efforts if key == keys.JOINT_TORQUES else state.wrench, np.float64)
            if loads[key].shape != self.observation_spaces[key].shape:
                raise InvalidSetup(f"{self._arm.name} does not measure {key!r}; leave it out of `observe`.")
        return self._followed(
            {
                **loads,
                keys.JOINTS: np.array(state.joints),
                keys.TQUAT: pose.tquat,
                keys.XYZRPY: pose.xyzrpy,
                keys.JOINT_VELOCITIES: np.array(state.joint_velocities),
            }
        )


class EffectorPort(Port):
    """Any gripper or hand behind the device interface."""

    def __init__(
        self,
        device: Gripper | Hand,
        *,
        valid_for: float = math.inf,
        stale_after: float = math.inf,
        slow_after: float = math.inf,
    ) -> None:
        """Use a device; it is opened (connected) by `open`.

        Args:
            device: The device.
            valid_for: How long a command is valid without another; then the device holds [s].
            stale_after: Age of what it measures from which it is in its fault state [s].
            slow_after: A device that takes longer than this to read is commanded and read on a thread [s].
        """
        self.device = self._device = device
        key, count = (keys.GRIPPER, 1) if isinstance(device, Gripper) else (keys.HAND, device.joint_count)
        self._key = key
        self.timed = (key,)
        self.action_spaces = {key: keys.normalised_space(count)}
        self.observation_spaces = {key: keys.normalised_space(count)}
        self._calls = DeviceCalls(device, valid_for=valid_for, slow_after=slow_after)
        self.freshness = self._freshness = Freshness(device, stale_after)
        self._kept: Arrays = {}
        self._measured = np.ones(count, np.float32)

    def command(self, action: Arrays) -> None:
        """Send the target, or have it sent as soon as a slow device is free."""
        self._calls.send(action[self._key])
        self._kept = {self._key: action[self._key]}

    def kept(self) -> Arrays:
        """Return the last target; nothing before the first, nor after a fault until the next."""
        return self._kept

    def observe(self) -> Observation:
        """Return what is measured, or of a slow device what was measured last."""
        state = self._calls.read()
        self._freshness.judge(state)
        measured = [state.opening] if isinstance(state, GripperState) else state.joints
        self._measured = np.clip(np.array(measured, np.float32), 0.0, 1.0)
        return self._followed({self._key: self._measured})

    def open(self) -> None:
        """Connect the device; it does not move."""
        self._calls.open()

    def hold(self) -> None:
        """Make the device stay where it is; a gripper that was opening does not go on later."""
        self._calls.forget()
        super().hold()
        if self._key == keys.GRIPPER and self._kept:
            self._kept = {self._key: np.minimum(self._kept[self._key], self._measured)}

    def recover(self) -> None:
        """Clear the fault, if there is one; the device does not move."""
        if self._device.is_open and self._device.fault:
            self._kept = {}
            self._calls.recover()

    def close(self) -> None:
        """Let go of the device; closing twice is harmless."""
        self._calls.close()
