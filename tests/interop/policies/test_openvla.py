"""A tiny OpenVLA with random weights, saved by Transformers, served in OpenVLA's environment, asked from this one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import InvalidInput, Observation, connect

pytestmark = pytest.mark.interop

SETTINGS: dict[str, Any] = {"dataset": "small", "images": {"image": "side"}, "rate": 10}


@pytest.fixture(scope="module")
def openvla(environment: Callable[..., Any]) -> Any:
    return environment("openvla", "OPENVLA_REPO")


@pytest.fixture(scope="module")
def checkpoint(openvla: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("openvla") / "model"
    assert "weights" in openvla.run("python", Path(__file__).parent / "make_openvla.py", folder)
    (folder / "vlagents.json").write_text(json.dumps(SETTINGS))
    return folder


@pytest.fixture(scope="module")
def address(openvla: Any, checkpoint: Path) -> Iterator[str]:
    with openvla.serve("openvla", checkpoint) as where:
        yield where


def seen(seed: int, session: str = "", **more: Any) -> Observation:
    image = np.random.default_rng(seed).integers(0, 255, (100, 120, 3), np.uint8)
    return Observation(images={"side": image}, session=session, time=float(seed), **more)


def test_openvla_says_what_it_needs_and_answers_in_physical_units(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        metadata = policy.metadata()
        assert [image.name for image in metadata.images] == ["side"]
        assert (metadata.needs_instruction, metadata.horizon, metadata.rate) == (True, 1, 10)
        assert len(metadata.checkpoint_hash) == 64
        policy.reset("robot", "pick up the green cuboid")
        chunk = policy.infer(seen(3, "robot"))
        assert (chunk.actions.shape, chunk.time) == ((1, 7), 3.0)
        # The statistics' range: +-1 cm, and a gripper that is not scaled.
        assert np.all(np.abs(chunk.actions[:, :6]) <= 0.01)
        assert np.any(chunk.actions[:, :6] != chunk.actions[0, 0])


def test_two_robots_on_one_openvla_keep_their_instructions(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        policy.reset("left", "pick up the green cuboid")
        alone = [policy.infer(seen(seed, "left")).actions for seed in range(3)]
        policy.reset("right", "push the red cuboid")
        other = [policy.infer(seen(seed, "right")).actions for seed in range(3)]
        assert np.array_equal(alone, [policy.infer(seen(seed, "left")).actions for seed in range(3)])
        assert not np.array_equal(alone, other)
        # An observation's own words come before those of the reset, in capitals or not.
        said = policy.infer(seen(0, "left", instruction="Push the red cuboid.")).actions
        assert np.array_equal(said, other[0])


def test_openvla_asks_for_what_is_missing(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        policy.reset("robot")
        with pytest.raises(InvalidInput, match="told in words"):
            policy.infer(seen(1, "robot"))
        with pytest.raises(InvalidInput, match="no image 'side'"):
            policy.infer(Observation(session="robot", instruction="push"))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"dataset": "bridge_orig"}, "large, small"),
        ({"dataset": ""}, "large, small"),
        ({"state": [{"name": "joints", "size": 7}]}, "OpenVLA takes none"),
        ({"options": {"crop": True}}, "center_crop"),
    ],
)
def test_settings_that_do_not_fit_the_checkpoint_are_refused_with_what_is_valid(
    openvla: Any, checkpoint: Path, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    (tmp_path / "settings.json").write_text(json.dumps(SETTINGS | changed))
    words = ["vlagents", "serve", "openvla", "--checkpoint", checkpoint, "--settings", tmp_path / "settings.json"]
    assert said in openvla.run(*words, status=1)
