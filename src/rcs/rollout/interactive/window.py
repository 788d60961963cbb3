"""A session in MuJoCo's own viewer, whose panels and keys lead the robots."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from types import TracebackType
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from rcs.errors import RcsError
from rcs.rollout.interactive.guide import Guide
from rcs.rollout.interactive.session import Session
from rcs.sim.robot import SimRobot
from rcs.sim.viewer import Viewer

REFRESH = 0.02
"""Time between two pictures while nothing moves [s]."""

SPACE, RIGHT, ENTER = 32, 262, 257
"""Codes of keys (GLFW)."""


class Window:
    """MuJoCo's viewer on a session; a context manager. The session is the caller's.

    A slider of the panel "Control" leads a joint or opens the gripper; the mouse, with Ctrl, pushes what is selected.
    """

    HELP: ClassVar[str] = (
        "Space plays and pauses, the right arrow makes one step, Backspace resets, Enter recovers from a fault.\n"
        "Panel Control: joints and grippers. Double click and drag with Ctrl: push. F1: more keys. Closing ends."
    )

    def __init__(self, session: Session) -> None:
        """Prepare a window; nothing is open yet.

        Args:
            session: The session to show and control.
        """
        self.session = session
        self._keys: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._viewer = Viewer(session.world, has_panels=True, on_key=self._keys.put)
        self._next_sync = 0.0

    def update(self) -> None:
        """Handle keys, make a step if the session is playing, and show the state."""
        while not self._keys.empty():
            self._press(self._keys.get())
        if not self.session.advance():
            time.sleep(REFRESH)
        start = time.monotonic()
        if start >= self._next_sync:
            self._sync()
            # It waits for the picture that is being drawn: without a GPU, time would hardly pass.
            end = time.monotonic()
            self._next_sync = end + (end - start)

    def run(self) -> None:
        """Go on until the window is closed."""
        while self._viewer.is_running:
            self.update()

    def _press(self, key: int) -> None:
        session = self.session
        if key == SPACE:
            session.is_playing = not session.is_playing
        elif key == RIGHT:
            session.is_playing = False
            session.step()
        elif key == ENTER and session.problem:
            self._try(session.recover)

    def _try(self, request: Callable[[], None]) -> None:
        try:
            request()
        except RcsError as err:
            self.session.problem = f"{type(err).__name__}: {err}"

    def _sync(self) -> None:
        """Show the state, and take over what was done in the panels."""
        session, world = self.session, self.session.world
        before, then, places = world.ctrl.copy(), float(world.time), world.qpos.copy()
        reward = f"{session.reward:.3f}"
        rows = {"seed": session.seed, "step": session.steps, "reward": reward, "episode": session.verdict}
        if session.problem:
            rows["problem"] = session.problem
        self._viewer.write("\n".join(rows), "\n".join(map(str, rows.values())))
        self._viewer.sync()
        is_at_zero = np.array_equal(world.qpos, world.model.qpos0) and not np.array_equal(world.qpos, places)
        if float(world.time) < then or is_at_zero:  # Backspace, or the panel's reset, which know nothing of episodes
            self._try(session.reset)
            return
        changed = np.flatnonzero(world.ctrl != before)
        if changed.size:
            wanted = world.ctrl.copy()
            world.ctrl[...] = before  # the environment's layers decide what is sent
            for robot in session.env.simulation.robots:
                lead_by_controls(robot, session.guides[robot.placement.name], changed, wanted)

    def __enter__(self) -> Self:
        """Open the window."""
        self._viewer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the window."""
        self._viewer.close()


def lead_by_controls(
    robot: SimRobot, guide: Guide, changed: NDArray[np.integer], controls: NDArray[np.float64]
) -> None:
    """Lead a robot to the controls that a person has set.

    Args:
        robot: The robot.
        guide: Its guide.
        changed: Ids of the actuators whose controls were set; those of other robots are left alone.
        controls: Controls of all actuators, (nu,).
    """
    layout, joints = robot.layout, guide.joints.copy()
    own = [i for i, actuator in enumerate(layout.actuator_ids) if actuator in changed]
    if own:
        joints[own] = controls[layout.actuator_ids][own]
        guide.lead_joints_to(joints)
    gripper = robot.placement.gripper
    if gripper is not None and layout.finger_actuator in changed:
        opening = (controls[layout.finger_actuator] - gripper.ctrl_closed) / (gripper.ctrl_open - gripper.ctrl_closed)
        guide.opening = float(np.clip(opening, 0.0, 1.0))
