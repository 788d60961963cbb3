"""Simulated arms that follow a clock, with targets at any time.

Time: nothing runs by itself. `advance_to` makes as many physics steps as have become due, so an arm is always where it
would be now, on a clock of the wall or one that is moved by hand. The steps between targets are smoothed, as drivers of
real arms do, within the arm's limits of velocity and acceleration. The smoothing depends on time alone, so a target
that comes a little late changes the motion a little. (`Motion` plans for targets at a known rate, which these have
not.)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.description import ArmDescription
from rcs.sim.robot import SimRobot
from rcs.sim.scene import RobotPlacement, Scene
from rcs.sim.world import World

SMOOTHING = 0.05
"""Time constant of each of the two low-passes that smooth targets [s]. Steps of a stream at 30 Hz then stay within the
accelerations of arms; at 0.03 s they do not, and what the limits cut depends on every millisecond of the stream."""

REACH = 0.8
"""Share of an arm's velocity and acceleration limits that targets use, so that the arm can follow them."""

LONGEST_GAP = 1.0
"""A gap in time that is longer than this is not simulated [s]: the arms stand at their targets after it."""


class Course:
    """Motion of one arm's target: its goals through two equal low-passes in a row, within the arm's limits."""

    def __init__(self, arm: ArmDescription, joints: NDArray[np.float64], smoothing: float) -> None:
        """Stand still at joints [rad], (dof,)."""
        self.target = self.goal = joints
        self.due: deque[tuple[float, NDArray[np.float64]]] = deque()
        """Goals that take effect at a later moment, in order."""
        self.velocity = np.zeros_like(joints)
        """Velocity of the target [rad/s], (dof,)."""
        self._fastest = REACH * np.array(arm.velocity_limit)
        self._hardest = REACH * np.array(arm.acceleration_limit)
        self._smoothing = smoothing

    def advance(self, time: float, step: float) -> NDArray[np.float64]:
        """Return the target at a moment [rad], (dof,), one step after the last one, with the goals that are due."""
        passed = step
        while self.due and self.due[0][0] <= time:
            moment, goal = self.due.popleft()
            before = min(max(moment - (time - passed), 0.0), passed)
            self._lead(before)
            passed -= before
            self.goal = goal
        self._lead(passed)
        return self.target

    def _lead(self, passed: float) -> None:
        """Advance towards the present goal for some time [s].

        Two low-passes in a row are the velocity that covers the way in two time constants, through a low-pass of half a
        time constant. At most it is one from which half of the acceleration stops the arm in time.
        """
        way = self.goal - self.target
        fastest = np.minimum(self._fastest, np.sqrt(self._hardest * np.abs(way)))
        wanted = np.clip(way / (2.0 * self._smoothing), -fastest, fastest)
        change = (wanted - self.velocity) * min(2.0 * passed / self._smoothing, 1.0)
        self.velocity = self.velocity + np.clip(change, -self._hardest * passed, self._hardest * passed)
        self.target = self.target + self.velocity * passed


class TimedArm:
    """One arm of a `TimedWorld`, whose servos get the position and the velocity of its target."""

    def __init__(self, world: World, robot: RobotPlacement, smoothing: float) -> None:
        """Look the arm up in a world, and put it at home with an open gripper."""
        self.robot = SimRobot(world, robot, is_led=False)
        self._world, self._smoothing = world, smoothing
        layout, model = self.robot.layout, world.model
        self._actuators = np.array(layout.actuator_ids)
        damping = model.dof_damping[model.jnt_dofadr[layout.joint_ids]]
        bias = model.actuator_biasprm[self._actuators]
        self._servo_lag = (bias[:, 2] - damping) / bias[:, 1]
        """Lag of a servo that gets positions alone [s], (dof,)."""
        self.robot.go_home()
        self.stop()

    @property
    def joints(self) -> NDArray[np.float64]:
        """Joints [rad], (dof,), a fresh array."""
        return self.robot.joints

    def put(self, joints: NDArray[np.float64]) -> None:
        """Put the arm somewhere [rad], (dof,), at rest and with its target there."""
        self.robot.put(joints)
        self.stop()

    def stop(self) -> None:
        """Hold the arm where it is, and drop later targets."""
        here = self.joints
        self._world.ctrl[self._actuators] = here
        self.course = Course(self.robot.placement.arm, here, self._smoothing)

    def advance(self, time: float, step: float) -> None:
        """Set the controls of the physics step that ends at a moment [s]."""
        target = self.course.advance(time, step)
        self._world.ctrl[self._actuators] = target + self._servo_lag * self.course.velocity


class TimedWorld:
    """Arms in a scene of their own, simulated up to given moments."""

    def __init__(
        self, robots: Sequence[RobotPlacement], *, physics_step: float = 0.002, smoothing: float = SMOOTHING
    ) -> None:
        """Put the arms at home.

        Args:
            robots: The arms with what they carry.
            physics_step: Time step of the physics [s], which is also how exactly moments are met.
            smoothing: Time constant of each of the two low-passes that smooth targets [s].

        Raises:
            InvalidSetup: The time constant is not positive.
        """
        if not smoothing > 0:
            raise InvalidSetup(f"smoothing is {smoothing!r} s; valid is a time above 0.")
        scene = Scene.empty(physics_step=physics_step)
        for robot in robots:
            scene.add_robot(replace(robot, compliance=None))
        self.world = World(scene.compile(), frequency=1.0 / physics_step)
        self.arms: dict[str, TimedArm] = {robot.name: TimedArm(self.world, robot, smoothing) for robot in robots}
        self.time = 0.0
        """The moment that is simulated [s]."""
        self._step = physics_step
        self.world.refresh()

    def start(self, time: float, joints: Mapping[str, NDArray[np.float64]] | None = None) -> None:
        """Hold the arms still at a moment.

        Args:
            time: The moment [s].
            joints: Joints of some arms by name [rad], (dof,); the others stay where they are.
        """
        self.time = time
        for name, arm in self.arms.items():
            arm.put((joints or {}).get(name, arm.joints))
        self.world.refresh()

    def command(self, name: str, joints: NDArray[np.float64], at: float) -> None:
        """Set a target of an arm that takes effect at a moment.

        Args:
            name: The arm.
            joints: The target [rad], (dof,).
            at: The moment [s], not before that of the former command; a past one means now.
        """
        self._arm(name).course.due.append((max(at, self.time), np.array(joints, np.float64)))

    def stop(self, name: str) -> None:
        """Hold an arm where it is at the present moment, and drop later targets."""
        self._arm(name).stop()

    def goal(self, name: str) -> NDArray[np.float64]:
        """Return the last target of an arm [rad], (dof,), including a later one."""
        course = self._arm(name).course
        return (course.due[-1][1] if course.due else course.goal).copy()

    def advance_to(self, time: float, on_step: Callable[[], None] | None = None) -> None:
        """Simulate until a moment, to within half a physics step; an earlier one changes nothing.

        Args:
            time: The moment [s].
            on_step: Called after every physics step.
        """
        if time - self.time > LONGEST_GAP:
            self.start(time, {name: self.goal(name) for name in self.arms})
            return
        while self.time + 0.5 * self._step <= time:
            self.time += self._step
            for arm in self.arms.values():
                arm.advance(self.time, self._step)
            self.world.advance()
            if on_step is not None:
                on_step()

    def close(self) -> None:
        """Free the world. Closing twice is harmless."""
        self.world.close()

    def _arm(self, name: str) -> TimedArm:
        if name not in self.arms:
            raise UnknownName("robot in this world", name, self.arms)
        return self.arms[name]
