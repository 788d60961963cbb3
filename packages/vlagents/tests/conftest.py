from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import settings
from vlagents import Observation, Server
from vlagents.policies.random import RandomPolicy

settings.register_profile("vlagents", deadline=None)  # a machine may have other work
settings.load_profile("vlagents")


@pytest.fixture
def server() -> Iterator[Server]:
    with Server(RandomPolicy(size=8, horizon=4), port=0) as running:
        yield running


@pytest.fixture
def observation() -> Observation:
    random = np.random.default_rng(0)
    return Observation(
        images={"side": random.integers(0, 255, (224, 224, 3), np.uint8), "wrist": np.zeros((0, 4, 3), np.uint8)},
        state={"joints": np.arange(7.0), "gripper": np.ones(1, np.float32)},
        instruction="pick up the green cuboid",
        time=12.5,
        session="left",
    )
