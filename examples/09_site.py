"""A complete workflow on hardware: a site file, demonstrations judged by a person, a checked dataset, an export.

A setup defines the experiment; a site names the drivers and addresses of the devices. Here, a driver of fakes lets the
program run without a robot; a vendor's driver is another word in the file. Pass another site's file as an argument of
this program, as in example 17.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data import Dataset, check
from rcs_data.convert import export_lerobot

import rcs
from rcs.agents import Agent
from rcs.envs import Action, Observation

SITE = {
    "arms": {"fr3": {"driver": "fake", "address": "192.0.2.1"}},
    "grippers": {"fr3": {"driver": "fake", "address": "192.0.2.1"}},
    "cameras": {"wrist": {"driver": "fake", "address": "0123456789"}},
}


class Circle(Agent):
    """Stands in for a person at a device: moves the tool along a circle about where it was [m]."""

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Start at the present pose."""
        self._step = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the target of the tool relative to the start of the episode."""
        angle = 2 * np.pi * self._step / 45
        self._step += 1
        offset = 0.03 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])
        return {"tquat": np.array([*offset, 0.0, 0.0, 0.0, 1.0]), "gripper": np.array([1.0])}


def judge(observation: Observation, info: Mapping[str, Any]) -> bool:
    """Say whether the task was done; `rcs.rollout.PersonJudge()` asks the person at the terminal instead."""
    return bool(abs(observation["tquat"][1]) < 0.05)


with tempfile.TemporaryDirectory() as folder:
    file, out = Path(folder) / "lab.json", Path(folder) / "takes"
    file.write_text(json.dumps(SITE))
    site = rcs.Site.read(sys.argv[1] if len(sys.argv) > 1 else file)
    setup = rcs.Setup(task="Free", cameras=("wrist",), control="tquat", relative="origin", frequency=90)
    with rcs.make(setup, hardware=site) as env:
        print(env, "Nothing is connected yet, and these are the limits:", env.limits(), sep="\n\n")
        agent = Circle()
        with rcs.record(env, out) as recorder:
            for _ in range(2):
                take = recorder.start("draw a circle", at_reset=True)
                result = rcs.run_episode(env, agent, judge=judge, max_steps=90)
                recorder.finish(result.success)
                print(f"take {take}: {result.steps} steps, success {result.success}")

    damage = check(out).damage
    report = export_lerobot(Dataset.open(out), Path(folder) / "lerobot")
    print(f"{len(damage)} findings of damage; exported {report.episodes} episodes, {report.frames} images")

    # One arm real, the other simulated next to it in real time, with the same program.
    with rcs.make("Free", robot="dual_fr3", hardware={"left": "fake"}) as env:
        observation, info = env.reset()
        stay = {"joints": np.zeros(7), "gripper": np.array([1.0])}  # differences to where the arms are
        observation, *_ = env.step({"left": stay, "right": stay})
        print("platforms:", env.platform)
