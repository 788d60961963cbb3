"""Behaviour cloning: record scripted episodes, train a small network on them, and measure its success rate.

The network observes the cuboid's pose. It clones `PickTeacher`, whose actions depend only on the network's
observations, unlike those of `PickExpert`, which has phases with waits. With `EPISODES=20` in the environment it is
quick and rarely succeeds. Needs torch: pip install 'robot-control-stack[torch]'.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from rcs_data import Dataset, Windows

import rcs
from rcs.agents import Agent
from rcs.rollout import Collection, Evaluation, Progress, Summary, collect, evaluate

EPISODES = int(os.environ.get("EPISODES", "200"))
STATE = ("target/joints", "gripper", "tquat", "privileged/cuboid/tquat")
EPOCHS = 60

setup = rcs.Setup(task="PickCuboid", frequency=10, max_episode_steps=100, collision_reaction=False)
# Where the arm is sent, which it is behind; where the cuboid is; whether it is grasped, which the teacher asks.
setup = replace(setup, layers=("ObserveTarget",), observe=("privileged", "contacts"))
folder = tempfile.TemporaryDirectory()
plan = Collection(setup=setup, agent="PickTeacher", out=Path(folder.name), episodes=EPISODES, only_success=True)
for _ in collect(plan, Progress()):
    pass
windows = Windows(Dataset.open(folder.name), horizon=1, state=[f"observation/{key}" for key in STATE])
whole = windows.batch(range(len(windows)))  # large datasets, and those with images, need TorchDataset
states, actions = windows.statistics()["state"], windows.statistics()["actions"]
# Floors avoid the amplification of numbers that hardly vary in the recordings.
given = torch.from_numpy(states.normalise(whole["state"][:, 0], floor=0.05)).float()
wanted = torch.from_numpy(actions.normalise(whole["actions"][:, 0], floor=0.002)).float()
print(f"{len(windows)} steps of {EPISODES} episodes to train on")

torch.manual_seed(0)
torch.set_num_threads(1)  # small networks are slower on several threads
layers: list[torch.nn.Module] = []
for size_in, size_out in ((given.shape[1], 256), (256, 256), (256, wanted.shape[1])):
    layers += [torch.nn.Linear(size_in, size_out), torch.nn.ReLU()]
network = torch.nn.Sequential(*layers[:-1])
optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS)
for epoch in range(EPOCHS):
    losses: list[float] = []
    for rows in torch.randperm(len(given)).split(128):
        loss = torch.nn.functional.l1_loss(network(given[rows]), wanted[rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    schedule.step()
    if epoch % 20 == 19:
        print(f"epoch {epoch + 1}: loss {np.mean(losses):.4f}")


class Clone(Agent):
    """Acts by the network."""

    def __init__(self, env: Any) -> None:
        self.box = env.action_space["joints"]

    def reset(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        """Do nothing: the agent has no memory."""

    def act(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the network's prediction of the teacher's action."""
        values: list[Any] = [reduce(getitem, key.split("/"), observation) for key in STATE]
        state = states.normalise(np.concatenate(values), floor=0.05)
        with torch.no_grad():
            made = network(torch.from_numpy(state).float()).numpy()
        action = actions.denormalise(made, floor=0.002)
        return {"joints": np.clip(action[:-1], self.box.low, self.box.high), "gripper": np.clip(action[-1:], 0, 1)}


summary = Summary()
list(evaluate(Evaluation(setup=setup, agent=Clone, episodes=max(EPISODES // 2, 5)), summary))
low, high = summary.interval
print(f"{summary.successes} of {summary.judged} episodes succeed (95 % interval {low:.0%} to {high:.0%})")
folder.cleanup()
