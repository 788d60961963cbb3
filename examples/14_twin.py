"""A digital twin of a robot measures lag and tracking error, and raises an alarm when the robot stops.

A simulated arm with a delay of 30 ms and noise replaces the real one; with a vendor's driver, the program is the same.
"""

from __future__ import annotations

import time

import numpy as np

import rcs
from rcs.robots import FR3, FRANKA_HAND
from rcs.virtual import StandInArm

arm = StandInArm(FR3, gripper=FRANKA_HAND, delay=0.03, noise=0.0005)
hardware = {"fr3": arm, "fr3/gripper": "fake"}

with (
    rcs.make("Free", relative=False, hardware=hardware, max_episode_steps=None) as env,
    rcs.attach_twin(env, on_alarm="hold") as twin,
):
    observation, info = env.reset()
    home = observation["joints"]

    def swayed(step: int) -> dict[str, np.ndarray]:
        """Return the action that moves every joint by up to 0.4 rad and back, in three seconds."""
        sway = 0.2 * (1.0 - np.cos(2 * np.pi * step / (3 * env.frequency)))
        return {"joints": home + sway, "gripper": np.ones(1, np.float32)}

    for step in range(75):
        observation, *_, info = env.step(swayed(step))

    compared = twin.comparisons["fr3"]
    print(f"lag: {1e3 * (compared.lag or np.nan):.1f} ms")
    print("RMS error of every joint [mrad]:", (1e3 * compared.rms).round(2))
    print("the same with the lag in it:    ", (1e3 * compared.raw_rms).round(2))

    arm.freeze()  # accepts commands but does not move, without a fault
    frozen = time.monotonic()
    for step in range(75, 135):
        observation, _, _, truncated, info = env.step(swayed(step))
        if truncated:
            break
    print(f"after {1e3 * (time.monotonic() - frozen):.0f} ms: {info['end']}, {info.get('faults', {})}")
    alarm = twin.comparisons["fr3"].alarm
    if alarm is not None:
        print(f"measured {1e3 * (alarm.time - frozen):.0f} ms after it had stopped: {alarm}")
