"""A tiny π0 with random weights, of LeRobot's class, served over openpi's wire: our client asks, and openpi's own."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import Observation, connect

pytestmark = pytest.mark.interop

PROGRAM = Path(__file__).with_name("small_pi0.py")
PARTS = [{"name": "joints", "size": 7, "unit": "rad"}, {"name": "gripper", "size": 1, "unit": "0 closed, 1 open"}]
ASK = """
import json, sys, numpy
from openpi_client.websocket_client_policy import WebsocketClientPolicy
policy = WebsocketClientPolicy(sys.argv[1])
seen = {"joints": numpy.full(7, 0.5), "gripper": numpy.ones(1), "wrist": numpy.zeros((48, 64, 3), numpy.uint8)}
actions = policy.infer({**seen, "prompt": "pick up"})["actions"]
print(json.dumps([policy.get_server_metadata()["policy"], actions.tolist()]))
"""


@pytest.fixture(scope="module")
def address(made_by_make: Callable[[str], Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    lerobot, folder = made_by_make("lerobot-0.5.1"), tmp_path_factory.mktemp("pi0") / "model"
    lerobot.install_vlagents()
    assert "weights" in lerobot.run("python", PROGRAM, "make", folder)
    (folder / "vlagents.json").write_text(json.dumps({"state": PARTS, "action": PARTS, "rate": 10, "device": "cpu"}))
    with lerobot.serve("lerobot", folder, "--wire", "ws", program=PROGRAM) as where:
        yield where


def is_chunk(actions: Any) -> bool:
    """Say whether actions have the horizon, the size and the units of the checkpoint: near the mean of its data."""
    return np.shape(actions) == (6, 8) and 0 < np.abs(np.asarray(actions) - 0.5).max() < 0.1


def test_our_client_asks_pi0_over_openpis_wire(address: str) -> None:
    assert address.startswith("ws://")
    with connect(address, timeout=120.0) as policy:
        assert (policy.metadata().horizon, policy.metadata().rate) == (6, 10)
        state = {"joints": np.full(7, 0.5), "gripper": np.ones(1)}
        image = np.zeros((48, 64, 3), np.uint8)
        chunk = policy.infer(Observation(images={"wrist": image}, state=state, instruction="pick up", time=0.0))
        assert is_chunk(chunk.actions)


def test_openpis_own_client_asks_pi0(address: str, made_by_make: Callable[[str], Any]) -> None:
    name, actions = json.loads(made_by_make("openpi").run("python", "-c", ASK, address).splitlines()[-1])
    assert name == "pi0"
    assert is_chunk(actions)
