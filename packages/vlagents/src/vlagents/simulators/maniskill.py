"""ManiSkill 3: tasks of a Panda arm in SAPIEN, one copy on the CPU.

`maniskill:PickCube-v1`. An action is the way and the turn of the TCP in the base frame, and the gripper, each from -1
to 1; in 3.0.1, turns have the opposite sign. Starts are drawn. Even without cameras it needs a Vulkan driver, such as
Mesa's for CPUs from version 25 on.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.lookup import unknown
from vlagents.metadata import ImageSpec, PartSpec
from vlagents.observation import Observation
from vlagents.simulators.interface import Facts, ImageMap, Moment, PartMap, Simulator, SimulatorMapping

DRIVER = "vulkan/lvp_icd.json"
"""Where `make sims` describes a Vulkan driver for CPUs, in the environment's folder."""
DRIVERS = frozenset({"VK_ICD_FILENAMES", "VK_DRIVER_FILES"})
"""Environment variables that name another one."""
POSES = "_pose"
"""Ending of poses in an observation: translation [m] and quaternion wxyz, which is xyzw here."""
STEP = 0.1
"""Largest way [m] and largest turn [rad] of the Panda's controller `pd_ee_delta_pose` in a step."""
OPEN = 0.04
"""Way of a finger of the Panda's hand from closed to open [m]."""


class ManiskillSimulator(Simulator):
    """One task, with the Panda's controller `pd_ee_delta_pose`."""

    def __init__(self, task: str, *, images: bool = False, size: int = 128, steps: int = 200) -> None:
        """Make the task.

        Args:
            task: Its id, such as `PickCube-v1`.
            images: Whether its cameras are drawn, which is slow without a GPU.
            size: Height and width of images [pixels].
            steps: Most steps of an episode. The ids' own limits are those of a learner, 50 for most.

        Raises:
            InvalidInput: There is no such task, or it has another robot.
        """
        importlib.import_module("mani_skill.envs")
        known: dict[str, Any] = importlib.import_module("mani_skill.utils.registration").REGISTERED_ENVS
        if task not in known:
            raise unknown("task of ManiSkill", task, sorted(known))
        driver = Path(sys.prefix) / DRIVER
        if driver.is_file() and not DRIVERS & os.environ.keys():
            os.environ["VK_ICD_FILENAMES"] = str(driver)
        make = importlib.import_module("gymnasium").make
        options: dict[str, Any] = {"obs_mode": "state_dict", "render_backend": "cpu", "sim_backend": "physx_cpu"}
        options |= {"control_mode": "pd_ee_delta_pose", "robot_uids": "panda", "max_episode_steps": steps}
        if images:
            options |= {"obs_mode": "rgb+state_dict", "sensor_configs": {"width": size, "height": size}}
        try:
            self._env: Any = make(task, num_envs=1, **options)
            first = self._seen(self._env.reset(seed=0)[0])
        except RuntimeError as error:
            if "vk::" not in str(error) and "rendering device" not in str(error):
                raise
            raise InvalidInput(
                f"SAPIEN found no Vulkan driver, which it needs even without cameras: {error}. Mesa's for CPUs is in "
                "the package mesa-vulkan-drivers, from version 25 on; `make sims` unpacks it."
            ) from error
        size_of = {name: len(part) for name, part in first.state.items()}
        if size_of.get("qpos") != 9:
            raise InvalidInput(f"The task {task!r} has another robot than one Panda; its state is {size_of}.")
        cameras = tuple(ImageSpec(name, *first.image(name).shape[:2]) for name in first.images)
        poses = [name for name in size_of if name.endswith(POSES) and name != f"tcp{POSES}"]
        shown = [name for name in size_of if name not in ("joints", "gripper", "qpos", f"tcp{POSES}", *poses)]
        self.facts = Facts(
            name=f"maniskill:{task}",
            versions={name: version(name) for name in ("mani_skill", "sapien", "torch", "numpy")},
            images=cameras,
            state=tuple(PartSpec(name, count) for name, count in size_of.items()),
            action=(PartSpec("way", 3, meaning="delta"), PartSpec("turn", 3, meaning="delta"), PartSpec("hand", 1)),
            low=(-1.0,) * 7,
            high=(1.0,) * 7,
            rate=float(self._env.unwrapped.control_freq),
            steps=steps,
            mapping=SimulatorMapping(
                images=tuple(ImageMap(name=camera.name, camera=camera.name) for camera in cameras),
                state=(
                    PartMap(name="joints", of=("joints",), unit="rad"),
                    PartMap(name="gripper", of=("gripper",), unit="0 closed, 1 open", scale=(OPEN,)),
                    PartMap(name="tquat", of=(f"tcp{POSES}",), unit="m, xyzw"),
                    *(PartMap(name=f"privileged/{name[: -len(POSES)]}/tquat", of=(name,)) for name in poses),
                    *(PartMap(name=f"privileged/{name}", of=(name,)) for name in shown),
                ),
                action=(
                    PartMap(
                        name="xyzrpy",
                        of=("way", "turn"),
                        unit="m, rad",
                        meaning="delta",
                        scale=(1 / STEP,) * 3 + (-1 / STEP,) * 3,  # it multiplies rotations by its lower bound
                        rotation="intrinsic_xyz",
                    ),
                    PartMap(name="gripper", of=("hand",), unit="0 closed, 1 open", scale=(2.0,), offset=(-1.0,)),
                ),
                steps=steps,
                instruction=_instruction(task),
            ),
        )

    def reset(self, seed: int, start: int | None) -> Moment:
        """Draw everything from the seed."""
        return Moment(self._seen(self._env.reset(seed=seed)[0]), success=False)

    def step(self, action: NDArray[np.float64]) -> Moment:
        """Make a step."""
        seen, reward, terminated, truncated, info = self._env.step(action.astype(np.float32))
        success = bool(np.asarray(info["success"]).item())
        is_over = bool(np.asarray(terminated).item()) or bool(np.asarray(truncated).item())
        return Moment(self._seen(seen), float(np.asarray(reward).item()), success, is_over or success)

    def close(self) -> None:
        """Close the task."""
        self._env.close()

    def _seen(self, seen: Mapping[str, Any]) -> Observation:
        """Return an observation without the leading axis of copies."""
        state: dict[str, NDArray[np.float64]] = {}
        for part in (seen["agent"], seen["extra"]):
            for name, value in part.items():
                if not isinstance(value, Mapping):
                    state[name] = np.asarray(value, np.float64).reshape(-1)
        for name in state:
            if name.endswith(POSES):
                state[name] = state[name][[0, 1, 2, 4, 5, 6, 3]]
        if "qpos" in state:
            state |= {"joints": state["qpos"][:7], "gripper": state["qpos"][7:8]}
        data: Mapping[str, Any] = seen.get("sensor_data", {})
        images = {name: np.asarray(own["rgb"], np.uint8)[0] for name, own in data.items() if "rgb" in own}
        return Observation(images, state)


def _instruction(task: str) -> str:
    """Return the words of an id: `pick cube` for `PickCube-v1`."""
    words = "".join(f" {one.lower()}" if one.isupper() else one for one in task.partition("-")[0])
    return words.strip()
