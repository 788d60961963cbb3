"""LeRobot's own asynchronous server, asked by our client."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import ImageSpec, Metadata, Observation, PartSpec, PolicyFailed
from vlagents.connect import connect

pytestmark = pytest.mark.interop
HERE = Path(__file__).parent
PARTS = (PartSpec("joints", 7, "rad"), PartSpec("gripper", 1))
METADATA = Metadata(name="act", images=(ImageSpec("wrist", 48, 64),), state=PARTS, action=PARTS, horizon=6, rate=30.0)


@pytest.fixture(scope="module")
def lerobot(environment: Callable[..., Any]) -> Any:
    made = environment("lerobot")
    made.run("python", "-m", "pip", "-q", "install", "grpcio==1.73.1", "protobuf>=6.31.1,<6.32")
    return made


@pytest.fixture(scope="module")
def address(lerobot: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("served")  # it writes a folder of logs where it runs
    command = [lerobot.folder / "bin" / "python", HERE / "serve_lerobot_async.py"]
    with (folder / "served.log").open("w") as log:
        serving = subprocess.Popen(
            command,
            cwd=folder,
            env=os.environ | {"HF_HUB_OFFLINE": "1", "CUDA_VISIBLE_DEVICES": ""},
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
        try:
            assert serving.stdout is not None
            line = next((line for line in serving.stdout if line.startswith("Serving ")), "")
            assert line, (folder / "served.log").read_text()[-4000:]
            yield line.split(" at ")[1].split(". ")[0]
        finally:
            serving.terminate()
            serving.wait(30)


def test_a_chunk_of_lerobots_server_arrives_in_physical_units(lerobot: Any, address: str, tmp_path: Path) -> None:
    checkpoint = tmp_path / "model"
    lerobot.run("python", HERE / "make_lerobot.py", "act", checkpoint)
    given: dict[str, Any] = {"policy": "act", "metadata": METADATA, "accepts": "CVE-2026-25874", "timeout": 60.0}
    chance = np.random.default_rng(0)
    seen = Observation(
        {"wrist": chance.integers(0, 255, (48, 64, 3), np.uint8)},
        {"joints": chance.normal(0.5, 0.01, 7), "gripper": np.ones(1)},
        "pick up",
        time=2.0,
    )
    with connect(address, checkpoint=str(checkpoint), **given) as client:
        client.reset("robot")
        first, second = client.infer(seen), client.infer(seen)
        assert (first.actions.shape, first.period, first.time) == ((6, 8), 1 / 30, 2.0)
        assert 0 < np.abs(first.actions - 0.5).max() < 0.1  # the statistics: a mean of 0.5, and a hundredth around it
        np.testing.assert_array_equal(first.actions, second.actions)
    with connect(address, checkpoint=str(tmp_path / "none"), **given) as client, pytest.raises(PolicyFailed):
        client.reset()
