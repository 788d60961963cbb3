"""A task, an expert and a layer of your own in one file or notebook; `...` leaves room for an axis of copies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcs
from rcs.agents import Agent
from rcs.envs import Action, CopyIndex, Env, EpisodeRandom, Judgement, Layer, Observation
from rcs.rollout import Evaluation, Summary
from rcs.sim import Scene
from rcs.spatial import limit_step
from rcs.tasks import TableTask, add_box, upright

EDGE, LINE = 0.06, 0.70  # of the block, and where the line is along x in the scene, here the base frame [m]


class Floor(Layer):
    """Keeps the target of the TCP above the table."""

    def map_action(self, action: Action) -> Action:
        """Lift targets that are lower than 3 cm."""
        return {**action, "tquat": np.maximum(action["tquat"], [-1.0, -1.0, 0.03, -1.0, -1.0, -1.0, -1.0])}


class Pusher(Agent):
    """Goes behind the block, down, and to the line; aims too low, which the layer corrects."""

    def __init__(self, env: Env) -> None:
        """Move at 0.15 m/s."""
        self._step = 0.15 / env.frequency  # m

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Plan three waypoints, with the present orientation of the gripper."""
        (x, y), self._target = info["block"][:2], observation["tquat"]
        self._places = [(x - 0.1, y, 0.15), (x - 0.1, y, 0.0), (LINE, y, 0.0)]

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next point of the path."""
        goal = np.array([*self._places[0], *self._target[3:]])
        self._target = limit_step(self._target, goal, self._step, 1.0)
        if len(self._places) > 1 and np.allclose(self._target, goal):
            self._places.pop(0)
        return {"tquat": self._target, "gripper": np.array([0.0])}


class PushToLine(TableTask):
    """Push a block away from the robot until its middle is over a line."""

    names = ("block",)
    instruction = "push the block over the line"
    expert = Pusher

    def furnish(self, scene: Scene) -> None:
        """Add a table and the block."""
        scene.add_table()
        add_box(scene, "block", self.area.center, edges=(EDGE, EDGE, EDGE), mass=0.05, rgb=(0.8, 0.3, 0.1))

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Place the block at random: x, y [m] and yaw [rad]."""
        place = random.uniform([0.45, -0.15, -0.2], [0.6, 0.15, 0.2])
        self.bodies["block"].place(upright(place, np.array(EDGE / 2)), where)

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the block's pose."""
        return self.object_poses()

    def evaluate(self) -> Judgement:
        """Judge the distance to the line."""
        info = self.describe()
        missing = np.maximum(LINE - info["block"][..., 0], 0.0)
        return Judgement(success=missing == 0, progress=1.0 - missing, info=info)


env = rcs.make(PushToLine, control="tquat", relative=False, layers=[Floor])
print(env, rcs.run_episode(env, Pusher(env), seed=0), sep="\n")
summary = Summary()
for attempt in rcs.evaluate(Evaluation(setup=env.setup, episodes=10), summary, env=env):
    print(f"episode {attempt.number}: {attempt.result.steps} steps, success {attempt.result.success}")
print(f"{summary.successes} of {summary.judged}, 95 % interval {np.round(summary.interval, 2)}")
