"""A simulator for tests: a hand that reaches a goal, and fails on purpose where it is told to."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vlagents import ImageSpec, Observation, PartSpec
from vlagents.lookup import unknown
from vlagents.simulators.interface import Facts, ImageMap, Moment, PartMap, Simulator, SimulatorMapping

TASKS = ("near", "far")
STARTS = 4
LOST = float("nan")


class Reach(Simulator):
    """A hand moves by up to 1 cm per step; the task is done within 1 cm of the goal."""

    def __init__(self, task: str, *, fault: str = "", bad_seed: int = 1, at: int = 2) -> None:
        """Fail in the episode of one seed, at one step, by `die`, `hang`, `nan`, `reward` or `raise`."""
        if task not in TASKS:
            raise unknown("task", task, TASKS)
        self._reach = 0.05 if task == "near" else 0.4
        self._fault, self._bad_seed, self._at = fault, bad_seed, at
        self._seed, self._count = 0, 0
        self.facts = Facts(
            name=f"tiny:{task}",
            versions={"tiny": "1.0"},
            images=(ImageSpec("front", 12, 16),),
            state=(PartSpec("pose", 7, "m, xyzw"), PartSpec("width", 1, "m"), PartSpec("goal", 3, "m")),
            action=(PartSpec("way", 3, "cm"), PartSpec("turn", 3, "rad"), PartSpec("grip", 1, "-1 open, 1 closed")),
            low=(-1.0,) * 7,
            high=(1.0,) * 7,
            rate=20.0,
            steps=100,
            starts=STARTS,
            mapping=SimulatorMapping(
                images=(ImageMap(name="front", camera="front", flip="rows"),),
                state=(
                    PartMap(name="tquat", of=("pose",), unit="m, xyzw"),
                    PartMap(name="gripper", of=("width",), unit="0 closed, 1 open", scale=(0.08,)),
                    PartMap(name="goal", of=("goal",), unit="m"),
                ),
                action=(
                    PartMap(
                        name="xyzrpy", of=("way", "turn"), unit="m, rad", meaning="delta",
                        scale=(100.0,) * 3 + (1.0,) * 3, rotation="rotation_vector",
                    ),
                    PartMap(name="gripper", of=("grip",), unit="0 closed, 1 open", scale=(-2.0,), offset=(1.0,)),
                ),
                wait=2,
                wait_action=(0.0,) * 6 + (-1.0,),
                start="stored",
                steps=60,
                instruction="reach the goal",
            ),
        )  # fmt: skip

    def reset(self, seed: int, start: int | None) -> Moment:
        random = np.random.default_rng(seed if start is None else start)
        self._seed, self._count = seed, 0
        self._hand, self._width = np.zeros(3), 0.0
        self._goal = self._reach * random.uniform(0.5, 1.0, 3)
        return self._moment()

    def step(self, action: NDArray[np.float64]) -> Moment:
        self._count += 1
        self._hand = self._hand + 0.01 * action[:3]
        self._width = 0.08 * (1.0 - action[6]) / 2
        is_now = self._seed == self._bad_seed and self._count == self._at
        if is_now and self._fault == "die":
            os._exit(7)
        if is_now and self._fault == "hang":
            time.sleep(600)
        if is_now and self._fault == "raise":
            raise ZeroDivisionError("on purpose")
        return self._moment(self._fault if is_now else "")

    def _moment(self, fault: str = "") -> Moment:
        is_done = bool(np.linalg.norm(self._hand - self._goal) < 0.01)
        image = np.zeros((12, 16, 3), np.uint8)
        image[0] = 255
        state: dict[str, Any] = {
            "pose": np.concatenate([self._hand, [0.0, 0.0, 0.0, 1.0]]),
            "width": np.array([self._width]),
            "goal": np.array([LOST, 0.0, 0.0]) if fault == "nan" else self._goal,
        }
        return Moment(
            Observation({"front": image}, state), LOST if fault == "reward" else float(is_done), is_done, is_done
        )
