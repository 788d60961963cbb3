"""Compare the frames per second of our camera in the lab scene with MuJoCo's own renderer at its defaults.

The scene is the one that data is collected in: FR3 with hand and wrist camera, table, cuboid, room and side camera. The
arm moves between frames. The pictures are checked: arm, table and cuboid must be in them, at the place where the
camera's own matrices say.

Prints one JSON object: `fps` (by edge length in pixels, side camera, fast quality, one thread), `depth_fps` and
`segmentation_fps` (with depth or segmentation besides), `bare_arm_fps` (the arm alone), `default_fps` (the reference).
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for
from rcs.devices import lookup
from rcs.envs.assemble import assemble
from rcs.envs.env import Env
from rcs.robots.description import ArmDescription
from rcs.setups.lab import lab_of, looking
from rcs.setups.make import resolve
from rcs.sim.camera import SimCameras
from rcs.sim.scene import CameraPlacement, RobotPlacement, Scene
from rcs.sim.world import World


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robot: str = "fr3"
    """The lab."""
    task: str = "PickCuboid"
    """The task."""
    sizes: tuple[int, ...] = (84, 224)
    """Edge lengths of the square frames [px]."""
    frames: int = 400
    """Frames per round."""
    rounds: int = 7
    """Rounds; the median counts."""
    save: Path | None = None
    """Folder for one picture of each kind (PPM)."""


def main(options: Options) -> None:
    """Measure and print."""
    lab = lab_of(options.robot)
    # The first camera that stands still and sees the whole.
    name = next(name for name, mount in lab.cameras.items() if mount.on_gripper_of is None)
    setup = rcs.Setup(task=options.task, robot=options.robot, cameras=tuple(lab.cameras))
    parts = resolve(setup)
    env = assemble(parts, drawn=())
    world = env.simulation.world
    assert world.data is not None
    states = positions_of_an_episode(env)
    camera = next(placement for placement in parts.cameras if placement.name == name)
    result: dict[str, Any] = {"benchmark": "render", "robot": options.robot, "camera": name, "fps": {}}
    result |= {"depth_fps": {}, "segmentation_fps": {}, "bare_arm_fps": {}, "default_fps": {}}
    for size in options.sizes:
        cameras = SimCameras(world, [camera], size=(size, size))
        check_pictures(cameras, world, states, is_pick_cuboid=setup.task == "PickCuboid")
        save(options.save, f"{options.robot}-{size}", cameras.read()[name]["rgb"])
        result["fps"] |= {size: rate(cameras, world, states, options)}
        cameras.close()
        more = {
            "depth_fps": SimCameras(world, [camera], size=(size, size), has_depth=True),
            "segmentation_fps": SimCameras(world, [camera], size=(size, size), has_segmentation=True),
        }
        for key, others in more.items():
            result[key] |= {size: rate(others, world, states, options)}
            others.close()
        bare, bare_cameras = bare_arm(parts.robots[0].arm, size)
        show(bare, np.array(parts.robots[0].arm.home))
        save(options.save, f"bare-{options.robot}-{size}", bare_cameras.read()["side"]["rgb"])
        arm_states = states[:, : parts.robots[0].arm.dof] if setup.task == "PickCuboid" else bare.qpos[None].copy()
        result["bare_arm_fps"] |= {size: rate(bare_cameras, bare, arm_states, options)}
        bare_cameras.close()
        result["default_fps"] |= {size: default_rate(world, camera, size, states)}
    env.close()
    print(json.dumps(result))


def positions_of_an_episode(env: Env) -> NDArray[np.float64]:
    """Return the joint positions of every step of a scripted episode, (steps, nq)."""
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    expert.reset(observation, info)
    positions, is_over = [], False
    while not is_over:
        observation, _, terminated, truncated, info = env.step(expert.act(observation, info))
        positions.append(env.simulation.world.qpos.copy())
        is_over = terminated or truncated
    return np.array(positions)


def bare_arm(arm: ArmDescription, size: int) -> tuple[World, SimCameras]:
    """Return an arm without hand, table or room, and a camera that sees all of it."""
    scene = Scene(mujoco.MjSpec())
    robot = RobotPlacement(name="arm", arm=arm)
    scene.add_robot(robot)
    mount = CameraPlacement(
        name="side",
        camera=lookup.find("camera", "realsense_d435"),
        parent_body="world",
        optical_in_parent=looking((0.9, 1.0, 0.7), (0.15, 0.0, 0.42)),
    )
    scene.add_camera(mount)
    world = World(scene.compile())
    return world, SimCameras(world, [mount], size=(size, size))


def show(world: World, positions: NDArray[np.float64]) -> None:
    """Put the scene into a state."""
    world.qpos[: len(positions)] = positions
    world.refresh()


def rate(cameras: SimCameras, world: World, states: NDArray[np.float64], options: Options) -> float:
    """Return the frames per second while the arm moves."""
    rates = []
    for _ in range(options.rounds):
        begin = time.perf_counter()
        for i in range(options.frames):
            show(world, states[i % len(states)])
            cameras.read()
        rates.append(options.frames / (time.perf_counter() - begin))
    return round(median(rates), 1)


def default_rate(world: World, camera: CameraPlacement, size: int, states: NDArray[np.float64]) -> float | str:
    """Return the frames per second of MuJoCo's Python renderer as the model has it, in a process of its own."""
    import subprocess
    import sys
    import tempfile

    program = (
        "import sys, time, mujoco, numpy as np\n"
        "model = mujoco.MjModel.from_binary_path(sys.argv[1]); data = mujoco.MjData(model)\n"
        "renderer = mujoco.Renderer(model, int(sys.argv[3]), int(sys.argv[3]))\n"
        "states = np.load(sys.argv[4]); frames = 20\n"
        "for i in range(frames + 2):\n"
        "    if i == 2: begin = time.perf_counter()\n"
        "    data.qpos[:] = states[i]; mujoco.mj_kinematics(model, data); mujoco.mj_camlight(model, data)\n"
        "    renderer.update_scene(data, int(sys.argv[2])); renderer.render()\n"
        "print(frames / (time.perf_counter() - begin)); renderer.close()\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        model, positions = f"{folder}/model.mjb", f"{folder}/states.npy"
        mujoco.mj_saveModel(world.model, model, None)
        np.save(positions, states)
        number = str(world.model.camera(camera.camera_name).id)
        for backend in ("egl", "osmesa"):
            done = subprocess.run(
                [sys.executable, "-c", program, model, number, str(size), positions],
                env={"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend, "PATH": ""},
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode == 0:
                return round(float(done.stdout.split()[-1]), 1)
    return "MuJoCo's renderer does not run here"


def check_pictures(cameras: SimCameras, world: World, states: NDArray[np.float64], *, is_pick_cuboid: bool) -> None:
    """Check that what is measured is seen: the arm moves in the picture; and table and cuboid are plainly there."""
    pictures = []
    for state in (states[0], states[len(states) // 2]):
        show(world, state)
        (frame,) = cameras.read().values()
        pictures.append(frame["rgb"].astype(int))
    moved = (np.abs(pictures[1] - pictures[0]).max(axis=-1) > 20).mean()
    assert moved > 0.01, f"only {100 * moved:.2f} % of the picture change when the arm moves; it is not there"
    red, green, blue = (pictures[1][..., i] for i in range(3))
    parts = {"table": ((red > blue + 40) & (red > green), 0.02)}
    if is_pick_cuboid:
        parts["cuboid"] = ((green > red + 30) & (green > blue + 20), 0.0005)
    for name, (mask, least) in parts.items():
        assert mask.mean() > least, f"the {name} takes {100 * mask.mean():.3f} % of the picture; it is not there"


def save(folder: Path | None, name: str, picture: NDArray[np.uint8]) -> None:
    """Save a picture to look at."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        height, width, _ = picture.shape
        (folder / f"{name}.ppm").write_bytes(b"P6 %d %d 255\n" % (width, height) + picture.tobytes())


if __name__ == "__main__":
    main(tyro.cli(Options))
