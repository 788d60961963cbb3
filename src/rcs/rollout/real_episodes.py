"""Episodes with real robots: their starts, the agent's knowledge of the objects, and the verdict.

The objects lie where a simulated scene of the same setup has them at the episode's seed, or where the robot has set
them down near there (`placing`). Nothing is simulated after that: the agent gets their poses at the start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.agents import Agent
from rcs.agents.script import Script
from rcs.envs.env import Env
from rcs.envs.observer import Observer, Transition
from rcs.envs.observers.dataset_info import OBJECTS
from rcs.envs.spaces import GRIPPER, JOINTS, TQUAT
from rcs.envs.step.approach import SPEED
from rcs.envs.step.judge import FAULT
from rcs.errors import DeviceFault, Refused
from rcs.rollout.episode import EpisodeResult, is_open, run_episode
from rcs.rollout.placing import PLACED, Placer, Poses, SeededScene, SetDown, by_reset, is_placed_by_robot, judged
from rcs.rollout.supervisor import Supervisor
from rcs.spatial import Pose

HOLDING = 1.0
"""Time that a script holds its last goal if its task has no hold time [s]."""
MORE = 0.5
"""Additional time [s]: a verdict looks once per step, and objects settle."""


class RealEpisodes(Observer):
    """Makes episodes in an environment with real arms, which it observes."""

    def __init__(self, env: Env, agent: Agent, supervisor: Supervisor, *, speed: float = SPEED) -> None:
        """Prepare; nothing moves.

        Args:
            env: The environment.
            agent: The agent.
            supervisor: Agrees to motions, places the objects and judges.
            speed: Largest speed of a joint on its way home, as a share of its limit.
        """
        self._env, self._supervisor, self._speed = env, supervisor, speed
        self._scene = SeededScene(env.setup)
        self._placer = Placer(env, self._scene) if is_placed_by_robot(env.setup) else None
        self._is_held = False
        self._holding = float(getattr(self._scene.task.options, "hold_time", HOLDING)) + MORE
        self._agent = agent
        self._known: dict[str, Any] = {}
        self._objects: Poses = {}
        self._placed: dict[str, Any] = {}
        self._fault: DeviceFault | None = None
        """The fault that ended the last episode; a gate that stopped it leaves no device in its fault state."""
        self._grasp: NDArray[np.float64] | None = None
        """Pose of the TCP where the gripper was commanded to close last, (7,); None before, and with several robots."""
        self._was_open = True
        self._seen: NDArray[np.float64] | None = None
        env.add_observer(self)

    @property
    def outcome(self) -> dict[str, Any]:
        """Return what to store of the start: poses of the objects, and who put them there if that may be the robot."""
        poses = {name: pose.tolist() for name, pose in self._objects.items()}
        return {OBJECTS: poses, **({PLACED: self._placed} if self._placer is not None else {})}

    def prepare(self, seed: int) -> None:
        """Move the arms home, open their grippers, and let the robot or the supervisor place the objects.

        Raises:
            Refused: The supervisor does not agree that the arms move.
            DeviceFault: A device is in its fault state, or the last episode ended as a fault, and the supervisor does
                not agree to clear it.
        """
        found = self._set_down(seed)
        self._go_home(seed)
        self._objects, self._placed = self._look_for(found, seed)
        if self._placed["by"] != "robot":
            self._objects = self._scene.poses(seed)
            self._supervisor.place(seed, self._objects)
        self._known = self._scene.describe(self._objects)

    def run(self, seed: int) -> EpisodeResult:
        """Make the episode that was prepared."""
        result = run_episode(
            self._env, self._agent, seed=seed, judge=self._supervisor.judge, known=self._known, is_over=self._is_over
        )
        self._is_held = result.success is True
        is_fault = result.success is None and result.failure == FAULT  # not a judge's tag
        self._fault = DeviceFault(f"The episode ended as a fault: {result.message}.") if is_fault else None
        return result

    def _is_over(self) -> bool:
        """Return whether nothing more will happen, since a script has given up or been at its last goal long enough."""
        return isinstance(self._agent, Script) and self._agent.is_over(self._holding)

    def _set_down(self, seed: int) -> SetDown | None:
        """Have the robot set the object in its gripper down; None if it has none, or is not to."""
        is_held, self._is_held = self._is_held, False
        if self._placer is None or not is_held or (grasp := self._grasp) is None:
            return None
        question = f"The robot sets the {self._placer.name} down, where its next episode begins. Is the way free?"
        if not self._supervisor.may_move(question):
            raise Refused(f"Nothing has moved, because nobody agreed to this: {question}")
        lay = Pose.from_tquat(self._objects[self._placer.name])
        found = self._placer.set_down(seed, Pose.from_tquat(grasp).inverse() * lay)
        if found.why == FAULT and not any(self._env.stack.faults().values()):
            self._fault = DeviceFault("A gate has stopped the robot while it set the object down.")
        return found

    def _look_for(self, found: SetDown | None, seed: int) -> tuple[Poses, dict[str, Any]]:
        """Return where the objects lie after the robot has set one down, and the entry `placed`."""
        if self._placer is None or found is None:
            return {}, by_reset("no success before")
        if found.pose is None:
            return {}, by_reset(str(found.why), found)
        believed = {self._placer.name: found.pose}
        seen = self._supervisor.look(believed)
        if seen is None:
            return {}, by_reset("it does not lie there", found)
        return seen, judged(found, self._scene.poses(seed, found.number), seen, self._placer.name)

    def _go_home(self, seed: int) -> None:
        home: dict[str, dict[str, Any]] = {}
        for name, robot in self._env.robots.items():
            home[name] = {JOINTS: np.array(robot.arm.home)}
            if robot.gripper is not None:
                home[name][GRIPPER] = np.ones(1)
        robot = home if len(home) > 1 else next(iter(home.values()))
        options = {"robot": robot, "may_move": self._supervisor.may_move, "speed": self._speed}
        fault, self._fault = self._fault, None
        while True:
            if fault is not None:
                if not self._supervisor.may_recover(str(fault)):
                    raise fault
                self._env.recover()
            try:
                self._env.reset(seed=seed, options=options)
                return
            except DeviceFault as err:
                fault = err

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Forget the grasp."""
        self._grasp, self._was_open, self._seen = None, True, _tcp_in(first)

    def on_step(self, transition: Transition) -> None:
        """Remember where the gripper was commanded to close."""
        assert transition.action is not None, "it is a step"
        was_open, self._was_open = self._was_open, bool(is_open(transition.action))
        if was_open and not self._was_open:
            self._grasp = self._seen
        self._seen = _tcp_in(transition)

    def close(self) -> None:
        """Close the simulated scene. Closing twice is harmless."""
        self._scene.close()


def _tcp_in(transition: Transition) -> NDArray[np.float64] | None:
    """Return the observed pose of the TCP, (7,); None if there is none, or there are several robots."""
    pose = transition.observation.get(TQUAT)
    return None if pose is None else np.array(pose)


def has_real_arms(env: Env) -> bool:
    """Return whether any arm of an environment is real."""
    return any(env.platform.get(name) != "simulation" for name in env.robots)
