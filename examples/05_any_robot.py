"""The same program runs on every robot, and on one of your own from an MJCF file.

A lab defines the surroundings of a robot, ids its tasks; the task's scripted expert does the rest.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import rcs
from rcs.agents import agent_for
from rcs.robots import arm_from_mjcf
from rcs.rollout import Collection, Evaluation, Progress, collect, replay
from rcs.setups import looking, tasks_of

ROBOT = "fr3"  # or any other that `rcs list` names

task = tasks_of(ROBOT)[0]
env = rcs.make(task, robot=ROBOT)
print(env)
result = rcs.run_episode(env, agent_for(env), seed=0)
seconds = result.steps / env.frequency
print(f"{task} on {ROBOT}: {'success' if result.success else result.failure} after {seconds:.1f} s")
env.close()

# --- A robot of your own, with cameras of your own: joints, ranges and torques are those of the file. -----------------

MY_ARM = arm_from_mjcf(
    Path(__file__).parent / "06_own_robot/src/my_robot/my_robot.xml",
    home=(0.0, 0.0, 1.571, 1.571, 0.0, 0.785),
    velocity_limit=2.5,
    acceleration_limit=15.0,
    jerk_limit=1000.0,
)
CAMERAS = rcs.Cameras(
    mounts={
        "top": rcs.CameraMount(camera="realsense_d435", optical=looking((0.5, 0, 1.2), (0.55, 0, 0), up=(1, 0, 0))),
        "left": rcs.CameraMount(camera="usb_webcam", optical=looking((0.9, 0.7, 0.5), (0.5, 0, 0))),
    },
    image_size={"top": 96, "left": (128, 96)},
)
setup = rcs.Setup("PickCuboid", robot=MY_ARM, end_effector="franka_hand", cameras=CAMERAS)
with tempfile.TemporaryDirectory() as folder:
    out = Path(folder) / "dataset"
    for attempt in collect(Collection(setup=setup, out=out, episodes=2), Progress()):
        print(f"episode {attempt.number}: {'success' if attempt.result.success else attempt.result.failure}")
    print("replayed bit for bit:", all(episode.is_equal for episode in replay(out)))
    attempts = list(rcs.evaluate(Evaluation(setup=setup, episodes=2)))
    print(f"{sum(bool(attempt.result.success) for attempt in attempts)} of {len(attempts)} succeed")
