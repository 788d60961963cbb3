"""PPO in one file, with torch alone: a robot learns to pick up a cuboid. `rcs train` has checkpoints and videos too."""

import argparse
import time

import torch  # pyright: ignore[reportMissingImports]
from torch import nn  # pyright: ignore[reportMissingImports]

import rcs
from rcs.rl import Flat

COPIES, ROLLOUT, EPOCHS, BATCH, DISCOUNT, TRACE, CLIP, RATE = 32, 60, 8, 480, 0.98, 0.9, 0.2, 5e-4

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=300_000, help="steps of all copies together")
parser.add_argument("--unseen", type=int, default=100, help="episodes of an evaluation, on unseen seeds")
options = parser.parse_args()
torch.set_num_threads(1)  # small networks are slower on several threads
torch.manual_seed(0)

setup = rcs.Setup(
    task="PickCuboid", robot="fr3", reward="dense", discount=DISCOUNT, observe=("privileged", "contacts"),
    control="xyzrpy", layers=("KeepTilt", "ObserveTarget"), collision_reaction=False,
    frequency=10, max_episode_steps=60, physics_step=0.004,
)  # fmt: skip
envs = rcs.make_vec(setup, copies=COPIES, autoreset="SameStep")
exam = rcs.make_vec(setup, copies=options.unseen, autoreset="SameStep")
flat = Flat(envs)


def vector(observation: dict[str, object]) -> torch.Tensor:
    state = torch.from_numpy(flat.state(observation))  # every number coarsely and finely: the way, and the millimetres
    return torch.cat([2 * torch.tanh(state / 2), torch.tanh(4 * state)], -1)


def network(outputs: int) -> nn.Sequential:
    layers = [nn.Linear(2 * flat.layout.state_size, 256), nn.Linear(256, 256), nn.Linear(256, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, 0.01), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


actor, critic = network(flat.layout.action_size), network(1)
spread = nn.Parameter(torch.full((flat.layout.action_size,), -0.5))  # logarithm of the actions' standard deviations
weights = [*actor.parameters(), *critic.parameters(), spread]
optimiser = torch.optim.Adam(weights, eps=1e-5)


@torch.no_grad()  # pyright: ignore[reportUntypedFunctionDecorator]
def success_rate() -> float:
    state, running, succeeded = vector(exam.reset(seed=1_000_000)[0]), torch.ones(options.unseen, dtype=torch.bool), 0
    while running.any():
        observation, _, terminated, truncated, _ = exam.step(flat.action(actor(state)))
        state, succeeded = vector(observation), succeeded + int((running & torch.from_numpy(terminated)).sum())
        running &= torch.from_numpy(~(terminated | truncated))
    return succeeded / options.unseen


start, state = time.monotonic(), vector(envs.reset(seed=0)[0])
for steps in range(COPIES * ROLLOUT, options.steps + 1, COPIES * ROLLOUT):
    rows = []  # of every step: state, action, its log likelihood, reward, whether the episode goes on, value
    with torch.no_grad():
        for _ in range(ROLLOUT):
            policy, value = torch.distributions.Normal(actor(state), spread.exp()), critic(state)[:, 0]
            action = policy.sample()
            observation, reward, terminated, truncated, info = envs.step(flat.action(action))
            gain = torch.from_numpy((1 - DISCOUNT) * reward).float()  # keeps returns at most 1
            if truncated.any():  # bootstrap truncated episodes
                gain += DISCOUNT * critic(vector(info["final_obs"]))[:, 0] * torch.from_numpy(truncated)
            goes_on = torch.from_numpy(~(terminated | truncated))
            rows.append((state, action, policy.log_prob(action).sum(1), gain, goes_on, value))
            state = vector(observation)
        states, actions, likely, gains, goes_on, values = (torch.stack(column) for column in zip(*rows, strict=True))
        better, ahead, following = torch.zeros_like(values), 0.0, torch.cat([values[1:], critic(state).T])
        for i in reversed(range(ROLLOUT)):  # generalised advantage estimation (Schulman et al. 2016)
            better[i] = ahead = gains[i] - values[i] + DISCOUNT * goes_on[i] * (following[i] + TRACE * ahead)
    data = [one.flatten(0, 1) for one in (states, actions, likely, better, better + values)]
    optimiser.param_groups[0]["lr"] = RATE * (1 - steps / (options.steps + 1))
    for batch in (batch for _ in range(EPOCHS) for batch in torch.randperm(COPIES * ROLLOUT).split(BATCH)):
        seen, done, before, gained, worth = (one[batch] for one in data)
        ratio = (torch.distributions.Normal(actor(seen), spread.exp()).log_prob(done).sum(1) - before).exp()
        gained = (gained - gained.mean()) / (gained.std() + 1e-8)
        surrogate = torch.minimum(ratio * gained, ratio.clamp(1 - CLIP, 1 + CLIP) * gained).mean()
        optimiser.zero_grad()
        (((critic(seen)[:, 0] - worth) ** 2).mean() - surrogate).backward()
        nn.utils.clip_grad_norm_(weights, 0.5)
        optimiser.step()
    if steps // 50_000 > (steps - COPIES * ROLLOUT) // 50_000 or steps + COPIES * ROLLOUT > options.steps:
        print(f"{steps:8} steps, {(time.monotonic() - start) / 60:4.1f} min: {success_rate():4.0%} of unseen episodes")
