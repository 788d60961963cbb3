"""Meta-World: fifty tasks of a Sawyer arm, in MuJoCo 3.3.0.

`metaworld:pick-place-v3`. An action is the way of the hand, 1 is 1 cm, and the effort of the gripper: -1 opens, 1
closes. The state `observation` has the 39 numbers that its own policies take. Starts are drawn. The cameras `corner` to
`corner4` are mounted upside down, and their images are turned by the mapping.
"""

from __future__ import annotations

import importlib
import os
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.lookup import unknown
from vlagents.metadata import ImageSpec, PartSpec
from vlagents.observation import Observation
from vlagents.simulators.interface import Facts, Flip, ImageMap, Moment, PartMap, Simulator, SimulatorMapping

STEPS = 500
"""`SawyerXYZEnv.max_path_length`: a step more raises an error."""


class MetaworldSimulator(Simulator):
    """One task, whose goal is observed and whose starts are drawn."""

    def __init__(self, task: str, *, camera: str = "", size: int = 128) -> None:
        """Make the task.

        Args:
            task: Its name, such as `pick-place-v3`.
            camera: `corner` to `corner4`, `topview`, `behindGripper` or `gripperPOV`; none by default, because drawing
                needs OpenGL.
            size: Height and width of images [pixels].

        Raises:
            InvalidInput: There is no such task.
        """
        os.environ.setdefault("MUJOCO_GL", "egl")  # no window
        tasks: dict[str, Any] = importlib.import_module("metaworld.env_dict").ALL_V3_ENVIRONMENTS
        if task not in tasks:
            raise unknown("task of Meta-World", task, sorted(tasks))
        drawing = {"render_mode": "rgb_array", "camera_name": camera, "width": size, "height": size} if camera else {}
        env: Any = tasks[task](**drawing)
        env._partially_observable, env._set_task_called = False, True
        vars(env).pop("sawyer_observation_space", None)  # that of the goal's zeros
        env._freeze_rand_vec, env.seeded_rand_vec = False, True  # every reset draws, and by the seed
        self._env, self._camera = env, camera
        images = (ImageSpec(camera, size, size),) if camera else ()
        flip: Flip = "both" if camera.startswith("corner") else "none"
        self.facts = Facts(
            name=f"metaworld:{task}",
            versions={name: version(name) for name in ("metaworld", "mujoco", "gymnasium", "numpy")},
            images=images,
            state=(PartSpec("observation", 39),),
            action=(PartSpec("hand", 3, "cm", "delta"), PartSpec("grip", 1, "-1 open, 1 closed")),
            low=(-1.0,) * 4,
            high=(1.0,) * 4,
            rate=1.0 / float(self._env.dt),
            steps=STEPS,
            mapping=SimulatorMapping(
                images=tuple(ImageMap(name=image.name, camera=image.name, flip=flip) for image in images),
                state=(PartMap(name="observation", of=("observation",)),),
                action=(PartMap(name="raw", of=("hand", "grip")),),
                steps=STEPS,
                instruction=task.rpartition("-")[0].replace("-", " "),
            ),
        )

    def reset(self, seed: int, start: int | None) -> Moment:
        """Draw object and goal from the seed."""
        self._env.seed(seed)
        state, _ = self._env.reset()
        return self._moment(state, 0.0, False, is_over=False)

    def step(self, action: NDArray[np.float64]) -> Moment:
        """Make a step."""
        state, reward, terminated, truncated, info = self._env.step(action)
        return self._moment(state, reward, bool(info["success"]), is_over=bool(terminated or truncated))

    def close(self) -> None:
        """Close the task."""
        self._env.close()

    def _moment(self, state: Any, reward: float, success: bool, *, is_over: bool) -> Moment:
        images = {self._camera: np.array(self._env.render(), np.uint8)} if self._camera else {}
        seen = Observation(images, {"observation": np.asarray(state, np.float64)})
        return Moment(seen, float(reward), success, is_over or success)
