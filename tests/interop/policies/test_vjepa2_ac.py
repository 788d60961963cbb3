"""A tiny V-JEPA 2-AC with random weights: Transformers' encoder, upstream's predictor, asked from another Python."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import InvalidInput, Observation, connect

pytestmark = pytest.mark.interop

SIZES = {"num_frames": 8, "depth": 2, "num_heads": 2, "predictor_embed_dim": 48}
SETTINGS: dict[str, Any] = {
    "images": {"image": "side"},
    "options": {**SIZES, "samples": 32, "best": 4, "rounds": 3, "reach": 0.05},
}


@pytest.fixture(scope="module")
def vjepa2(environment: Callable[..., Any]) -> Any:
    return environment("vjepa2_ac", "VJEPA2_REPO")


@pytest.fixture(scope="module")
def checkpoint(vjepa2: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("vjepa2") / "model"
    assert "weights" in vjepa2.run("python", Path(__file__).parent / "make_vjepa2_ac.py", folder)
    (folder / "vlagents.json").write_text(json.dumps(SETTINGS))
    return folder


@pytest.fixture(scope="module")
def address(vjepa2: Any, checkpoint: Path) -> Iterator[str]:
    with vjepa2.serve("vjepa2_ac", checkpoint) as where:
        yield where


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (90, 160, 3), np.uint8)


def seen(session: str, goal: int | None = None, opening: float = 1.0) -> Observation:
    state = {"xyzrpy": np.array([0.4, 0.0, 0.3, 3.1, 0.0, 0.0]), "gripper": np.array([opening])}
    goals = {} if goal is None else {"side": picture(goal)}
    return Observation(images={"side": picture(0)}, goals=goals, state=state, session=session, time=4.0)


def test_vjepa2_ac_says_what_it_needs_and_answers_within_its_reach(address: str) -> None:
    with connect(address, timeout=120.0) as policy:
        metadata = policy.metadata()
        assert [(part.name, part.size) for part in metadata.state] == [("xyzrpy", 6), ("gripper", 1)]
        assert (metadata.horizon, metadata.rate) == (2, 4.0)
        assert (metadata.needs_instruction, metadata.needs_goal) == (False, True)
        policy.reset("robot", seed=1)
        chunk = policy.infer(seen("robot", goal=1))
        assert (chunk.actions.shape, chunk.time, chunk.period) == ((2, 7), 4.0, 0.25)
        assert np.all(np.abs(chunk.actions[:, :3]) <= 0.05)
        assert np.any(chunk.actions[:, :3] != 0.0)
        assert np.all(chunk.actions[:, 3:6] == 0.0)
        assert np.all((chunk.actions[:, 6] >= 0.0) & (chunk.actions[:, 6] <= 1.0))


def test_the_goals_picture_decides_and_is_kept_for_the_session(address: str) -> None:
    with connect(address, timeout=120.0) as policy:

        def answer(goal: int, session: str = "robot") -> list[list[float]]:
            policy.reset(session, seed=3)
            first = policy.infer(seen(session, goal)).actions
            policy.reset("other", seed=5)
            policy.infer(seen("other", 9))  # another robot's goal in between
            return [*first.tolist(), *policy.infer(seen(session)).actions.tolist()]

        assert answer(1) == answer(1) != answer(2)
        policy.reset("robot")
        with pytest.raises(InvalidInput, match=r"goals\['side'\]"):
            policy.infer(seen("robot"))


def test_a_predictor_of_another_size_is_refused(vjepa2: Any, checkpoint: Path, tmp_path: Path) -> None:
    settings = {"options": {**SIZES, "depth": 3}}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    words = ["vlagents", "serve", "vjepa2_ac", "--checkpoint", checkpoint, "--settings", tmp_path / "settings.json"]
    assert "predictor of these sizes" in vjepa2.run(*words, status=1)
