"""PPO in one file, with torch alone: a robot learns to pick up a cuboid from nothing but its reward.

Needs torch: pip install 'robot-control-stack[torch]'. `rcs train` does the same with checkpoints, videos and a report.
"""

import argparse
import time

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from torch import nn  # pyright: ignore[reportMissingImports]

import rcs
from rcs.rl import Flat, Selection

COPIES, ROLLOUT, EPOCHS, BATCH, DISCOUNT, TRACE, CLIP, RATE = 64, 32, 8, 512, 0.96, 0.9, 0.2, 5e-4

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=1_500_000, help="steps of all copies together")
parser.add_argument("--unseen", type=int, default=100, help="episodes of an evaluation, on seeds never trained on")
options = parser.parse_args()
torch.set_num_threads(1)  # such small networks are slower on more
torch.manual_seed(0)

setup = rcs.Setup(
    task="PickCuboid", robot="fr3", control="xyzrpy", frequency=10, max_episode_steps=60, collision_reaction=False,
    observe=("privileged", "contacts"), reward="dense", discount=DISCOUNT,
)  # fmt: skip
envs = rcs.make_vec(setup, copies=COPIES, autoreset="SameStep")
exam = rcs.make_vec(setup, copies=options.unseen, autoreset="SameStep")
flat = Flat(envs, Selection(actions=("xyzrpy[0:3]", "xyzrpy[5]", "gripper")))  # the gripper points down


def network(outputs: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(flat.layout.state_size, 256), nn.Linear(256, 256), nn.Linear(256, outputs)]
    for layer, own in zip(layers, (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, own)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


actor, critic = network(flat.layout.action_size, 0.01), network(1, 1.0)
spread = nn.Parameter(torch.full((flat.layout.action_size,), -0.5))  # logarithm of the actions' standard deviations
weights = [*actor.parameters(), *critic.parameters(), spread]
optimiser = torch.optim.Adam(weights, lr=RATE, eps=1e-5)


@torch.no_grad()
def success_rate() -> float:
    state, running, succeeded = flat.state(exam.reset(seed=1_000_000)[0]), np.ones(options.unseen, bool), 0
    while running.any():
        observation, _, terminated, truncated, _ = exam.step(flat.action(actor(torch.from_numpy(state))))
        state, succeeded = flat.state(observation), succeeded + int((running & terminated).sum())
        running &= ~(terminated | truncated)
    return succeeded / options.unseen


start, state = time.monotonic(), torch.from_numpy(flat.state(envs.reset(seed=0)[0]))
for number in range(1, options.steps // (COPIES * ROLLOUT) + 1):
    rows = []  # of every step: state, action, its log likelihood, reward, whether the episode ended, value
    with torch.no_grad():
        for _ in range(ROLLOUT):
            policy, value = torch.distributions.Normal(actor(state), spread.exp()), critic(state)[:, 0]
            action = policy.sample()
            observation, reward, terminated, truncated, info = envs.step(flat.action(action))
            gain = torch.from_numpy((1 - DISCOUNT) * reward).float()  # returns are about 1 then
            if truncated.any():  # what follows an episode that was cut off is worth what the critic says
                ahead = critic(torch.from_numpy(flat.state(info["final_obs"])))[:, 0]
                gain += DISCOUNT * ahead * torch.from_numpy(truncated)
            goes_on = torch.from_numpy(~(terminated | truncated)).float()
            rows.append((state, action, policy.log_prob(action).sum(1), gain, goes_on, value))
            state = torch.from_numpy(flat.state(observation))
        states, actions, likely, gains, goes_on, values = (torch.stack(column) for column in zip(*rows, strict=True))
        better, ahead, following = torch.zeros_like(values), torch.zeros(COPIES), critic(state)[:, 0]
        for i in reversed(range(ROLLOUT)):  # generalised advantage estimation (Schulman et al. 2016)
            ahead = gains[i] - values[i] + DISCOUNT * goes_on[i] * (following + TRACE * ahead)
            better[i], following = ahead, values[i]
    data = [one.flatten(0, 1) for one in (states, actions, likely, better, better + values)]
    for batch in (batch for _ in range(EPOCHS) for batch in torch.randperm(COPIES * ROLLOUT).split(BATCH)):
        seen, done, before, gained, worth = (one[batch] for one in data)
        ratio = (torch.distributions.Normal(actor(seen), spread.exp()).log_prob(done).sum(1) - before).exp()
        gained = (gained - gained.mean()) / (gained.std() + 1e-8)
        surrogate = torch.minimum(ratio * gained, ratio.clamp(1 - CLIP, 1 + CLIP) * gained).mean()
        optimiser.zero_grad()
        (((critic(seen)[:, 0] - worth) ** 2).mean() - surrogate).backward()
        nn.utils.clip_grad_norm_(weights, 0.5)
        optimiser.step()
    if number % 50 == 0 or (number + 1) * COPIES * ROLLOUT > options.steps:
        minutes = (time.monotonic() - start) / 60
        print(f"{number * COPIES * ROLLOUT:8} steps, {minutes:4.1f} min: {success_rate():4.0%} of unseen episodes")
