"""Objects that the robot itself puts where the next episode of a collection begins, after a success.

The object is still in the gripper then. Its next pose follows from the seed; if that is out of reach, the next pose of
the same seed counts. Where it was set down follows from the TCP when the gripper opened, unless somebody or something
sees it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from rcs_data.files.closing import Closing

from rcs.agents import agent_for
from rcs.agents.script import Script
from rcs.devices import lookup
from rcs.envs.assemble import compose as scene_of_parts
from rcs.envs.env import Env
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.setup import Setup
from rcs.envs.spaces import TQUAT
from rcs.envs.start import check_start
from rcs.envs.step.judge import FAULT
from rcs.envs.step.simulation import Simulation
from rcs.errors import DeviceFault, InvalidSetup
from rcs.setups.make import make, resolve
from rcs.sim.randomisation import Randomisation
from rcs.sim.robot import SimRobot
from rcs.sim.world import World
from rcs.spatial import Pose, distance

Poses = Mapping[str, NDArray[np.float64]]

TRIES = 16
"""Poses of a seed of which the first within reach counts."""
ASTRAY = 0.02, np.deg2rad(10.0)
"""Deviation from its pose beyond which an object counts as not set down [m, rad]."""
PLACED = "placed"
"""Key of an outcome: who put the objects where the episode began; if it was the robot, `off_mm` and `off_deg` from the
pose of the seed, and poses of the seed that were out of reach; else, why it was not."""
AT_HOME = 0.1
"""How long the target is at home before the placing is over [s]."""
NEVER = 1e6
"""Hold time that no motion reaches [s]."""


def is_placed_by_robot(setup: Setup) -> bool:
    """Return whether the robot places the objects of a setup's task.

    Raises:
        InvalidSetup: It cannot: its arm cannot turn them to every yaw, or their sizes vary.
    """
    if setup.task_options.get("placed_by") != "robot":
        return False
    parts = resolve(setup)
    if (dof := min(robot.arm.dof for robot in parts.robots)) < 6:
        raise InvalidSetup(
            f"placed_by is 'robot', and an arm with {dof} joints cannot set a cuboid down at every yaw. Use a robot "
            "with six or more, or placed_by='reset'."
        )
    sizes = (1.0, 1.0) if setup.randomisation is None else setup.randomisation.object_size
    if tuple(sizes) != (1.0, 1.0):
        raise InvalidSetup(
            f"placed_by is 'robot' and object_size of the randomisation is {sizes}; the robot cannot change an object. "
            "Use object_size=(1, 1), or placed_by='reset'."
        )
    return True


@dataclass(frozen=True, kw_only=True)
class SetDown:
    """How an object was set down."""

    pose: NDArray[np.float64] | None
    """Where the robot believes it, in its base frame, (7,) [m], xyzw; None if it was not set down."""
    number: int = 0
    """Number of the pose of the seed that was aimed at."""
    out_of_reach: list[list[float]] = field(default_factory=list[list[float]])
    """Poses of the seed before that."""
    why: str | None = None
    """Why it was not set down: `out_of_reach`, `slip`, `fault` or the end of the last step; None if it was."""


class SeededScene(Closing):
    """The simulated scene of a setup, as the robots' lab has it, without cameras: where a seed puts the objects."""

    def __init__(self, setup: Setup) -> None:
        """Make the scene."""
        bare = Setup(
            task=setup.task, task_options=setup.task_options, robot=setup.robot, end_effector=setup.end_effector
        )
        parts = resolve(replace(bare, frequency=setup.frequency))
        self._world = World(scene_of_parts(parts).compile(), frequency=setup.frequency)
        self._simulation = Simulation(self._world, [SimRobot(self._world, one) for one in parts.robots], parts.task)
        self._robots = parts.robots
        self.task = parts.task
        """The task."""

    def poses(self, seed: int, number: int = 0) -> Poses:
        """Return the poses of the objects at a seed, as in `Simulation.object_poses`.

        Args:
            seed: Seed of the episode.
            number: 0 for those of a reset; others are further ones of the same seed.
        """
        self._simulation.begin(EpisodeRandom(np.asarray(seed), np.asarray(number)))
        return self._simulation.object_poses()

    @property
    def model(self) -> mujoco.MjModel:
        """The model, which has the shapes of the objects."""
        return self._world.model

    def describe(self, poses: Poses) -> dict[str, Any]:
        """Return what the task reports at the start of an episode in which the objects are at these poses."""
        self._simulation.start_at(check_start(self._robots, poses, None, poses))
        return self._simulation.describe()

    def close(self) -> None:
        """Close the world; closing twice is harmless."""
        self._world.close()


class Placer:
    """Sets the object in a robot's gripper down, lets go of it and goes home."""

    def __init__(self, env: Env, scene: SeededScene) -> None:
        """Prepare; nothing moves.

        Args:
            env: The environment of the robot.
            scene: Where seeds put the object.

        Raises:
            InvalidSetup: The task has no placer.
        """
        placer = lookup.find("task", env.setup.task).placer
        if placer is None:
            raise InvalidSetup(f"The task {env.setup.task} names no placer.")
        agent = agent_for(env, placer)
        if not isinstance(agent, Script):
            raise InvalidSetup(f"The placer {placer!r} of {env.setup.task} is no Script.")
        self._env, self._agent, self._scene = env, agent, scene
        (self.name,) = scene.task.objects()
        """Name of the object."""

    def set_down(
        self,
        seed: int,
        in_tcp: Pose | None,
        options: Mapping[str, Any] | None = None,
        *,
        last_seed: int | None = None,
    ) -> SetDown:
        """Set the object down at the first pose of a seed that is within reach.

        Args:
            seed: Seed of the next episode.
            in_tcp: Pose of the object in the TCP frame; None for that in the simulation.
            options: Options of a reset that moves nothing.
            last_seed: Seed of the last episode, for a simulation that is to be as it was then; None for devices.
        """
        env, agent = self._env, self._agent
        try:
            observation, info = env.reset(seed=last_seed, options=options)
        except DeviceFault:  # since the last step; the way home asks a person what to do
            return SetDown(pose=None, why=FAULT)
        if in_tcp is None:
            held = Pose.from_tquat(env.simulation.object_poses()[self.name])
            in_tcp = Pose.from_tquat(observation[TQUAT]).inverse() * held
        found = SetDown(pose=None, why="out_of_reach")
        goal = Pose()
        for number in range(TRIES):
            goal = Pose.from_tquat(self._scene.poses(seed, number)[self.name])
            held = Pose.from_tquat(observation[TQUAT]) * in_tcp
            agent.reset(observation, {**info, self.name: held.tquat, "goal": goal.tquat})
            if agent.failure is None:
                found = replace(found, number=number, why=None)
                break
            found.out_of_reach.append(goal.tquat.tolist())
        if found.why is not None:
            return found
        released: Pose | None = None
        try:
            while not agent.is_over(AT_HOME):
                action = agent.act(observation, info)
                if agent.phase == "release":
                    released = Pose.from_tquat(observation[TQUAT])
                observation, _, terminated, truncated, info = env.step(action)
                if terminated or truncated:
                    break
        finally:
            env.hold()
        # A step without a solution of the inverse kinematics is a failure, too; where it let go of the object counts.
        if released is None or "faults" in info:
            return replace(found, why=agent.failure or str(info["end"]))
        return replace(found, pose=_at_rest(released * in_tcp, goal).tquat)


class PlacesInSimulation:
    """Starts of simulated episodes at which the robot has placed the object, after a success."""

    def __init__(self, env: Env) -> None:
        """Make a second simulation, in which the placing takes place: nothing there ends an episode."""
        setup, ranges = env.setup, env.setup.randomisation
        self._env, self._scene = env, SeededScene(setup)
        if ranges is not None:  # late actions and distractors are parts of the state
            ranges = Randomisation.off(action_latency=ranges.action_latency, distractors=ranges.distractors)
        endless = {**setup.task_options, "hold_time": NEVER}
        stepping = "async" if setup.stepping == "realtime" else setup.stepping
        self._apart = make(
            replace(
                setup, cameras=(), randomisation=ranges, max_episode_steps=None, task_options=endless, stepping=stepping
            )
        )
        self._placer = Placer(self._apart, self._scene)
        self.is_held = False
        """Whether the last episode of the environment was a success, so that the object is in the gripper."""

    def next(self, seed: int) -> tuple[dict[str, Any] | None, dict[str, Any]]:
        """Place the object for the next episode, if it is held, and return options of its reset and its `placed`."""
        if not self.is_held:
            return None, by_reset("no success before")
        states = {"state": self._env.simulation.world.states()}
        found = self._placer.set_down(seed, None, states, last_seed=self._env.np_random_seed)
        if found.pose is None:
            return None, by_reset(str(found.why), found)
        poses = self._apart.simulation.object_poses()
        verdict = judged(found, self._scene.poses(seed, found.number), poses, self._placer.name)
        return ({"objects": poses} if verdict["by"] == "robot" else None), verdict

    def close(self) -> None:
        """Close what was made."""
        self._scene.close()
        self._apart.close()


def by_reset(why: str, found: SetDown | None = None) -> dict[str, Any]:
    """Return the entry `placed` of an episode whose objects the robot did not place."""
    more = {"out_of_reach": found.out_of_reach} if found is not None and found.out_of_reach else {}
    return {"by": "reset", "why": why, **more}


def judged(found: SetDown, wanted: Poses, seen: Poses, name: str) -> dict[str, Any]:
    """Return the entry `placed` of an episode before which the robot has set an object down.

    Args:
        found: How it was set down.
        wanted: Poses of the seed.
        seen: Where the objects lie.
        name: Name of the object.
    """
    off, angle = offset(wanted[name], seen[name])
    if off > ASTRAY[0] or angle > ASTRAY[1]:
        return by_reset(f"it lies {1e3 * off:.1f} mm and {np.rad2deg(angle):.1f} degrees off", found)
    reach = {"out_of_reach": found.out_of_reach} if found.out_of_reach else {}
    return {"by": "robot", "off_mm": 1e3 * off, "off_deg": float(np.rad2deg(angle)), **reach}


def offset(wanted: NDArray[np.float64], pose: NDArray[np.float64]) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between poses of a cuboid, which looks the same after half a turn."""
    turned = Pose.from_tquat(pose) * Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
    ways: Sequence[NDArray[np.float64]] = [distance(wanted, pose), distance(wanted, turned.tquat)]
    off, angle = min(ways, key=lambda way: float(way[1]))
    return float(off), float(angle)


def _at_rest(pose: Pose, goal: Pose) -> Pose:
    """Return where an object comes to rest that was let go of above the table: as high and as upright as its goal."""
    x, y, _ = pose.translation
    yaw = (pose * goal.inverse()).rpy[2]
    return Pose.from_rpy((x, y, goal.translation[2]), (0.0, 0.0, yaw)) * Pose((0.0, 0.0, 0.0), goal.quaternion)
