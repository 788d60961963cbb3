"""Record scripted episodes, cut them into windows, and train a small network on them: behaviour cloning.

Needs torch: pip install 'robot-control-stack[torch]'. With `cameras=("wrist",)` in the setup, batches have images too.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import torch  # pyright: ignore[reportMissingImports]

import rcs
from rcs.data import Dataset, Windows
from rcs.data.torch import TorchDataset, collate
from rcs.rollout import Collection, Progress, collect

folder = tempfile.TemporaryDirectory()
setup = rcs.Setup(task="PickCuboid", robot="fr3")
for _ in collect(Collection(setup=setup, out=Path(folder.name), episodes=12, seed=0), Progress()):
    pass

dataset = Dataset.open(folder.name)
good = [episode for episode in dataset.episodes if episode.success]
windows = Windows(dataset, horizon=8, episodes=good[:-2])
unseen = Windows(dataset, horizon=8, episodes=good[-2:])
print(f"{len(windows)} windows of {len(good) - 2} episodes to train on, {len(unseen)} of 2 others to test on")

statistics = windows.statistics()  # of the training episodes alone
names = ("state", "actions")
means = {name: torch.tensor(statistics[name].mean, dtype=torch.float32) for name in names}
spreads = {name: torch.tensor(statistics[name].std, dtype=torch.float32).clamp(min=1e-4) for name in names}

torch.manual_seed(0)
numbers_in, numbers_out = windows.state_layout.size, 8 * windows.action_layout.size
network = torch.nn.Sequential(torch.nn.Linear(numbers_in, 128), torch.nn.ReLU(), torch.nn.Linear(128, numbers_out))
optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)


def loss_of(batch: dict[str, torch.Tensor]) -> torch.Tensor:
    """Return how far the actions are off, in standard deviations; those after the end do not count."""
    state, actions = ((batch[name] - means[name]) / spreads[name] for name in names)
    distance = (network(state[:, -1]).view_as(actions) - actions).abs().mean(dim=2)
    return distance[~batch["is_pad"]].mean()


test = torch.utils.data.default_collate([TorchDataset(unseen)[i] for i in range(len(unseen))])
loader = torch.utils.data.DataLoader(TorchDataset(windows), batch_size=64, shuffle=True, collate_fn=collate)
print(f"before training: {loss_of(test).item():.2f} standard deviations off")
for _ in range(20):
    for batch in loader:
        optimiser.zero_grad()
        loss_of(batch).backward()
        optimiser.step()
print(f"after 20 epochs: {loss_of(test).item():.2f}")
folder.cleanup()
