"""Tiny ACT, Diffusion Policy and SmolVLA with random weights, saved and served in LeRobot's environment."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature
from vlagents import InvalidInput, Observation, connect

from rcs.cli.train import TrainCommand

pytestmark = pytest.mark.interop

PARTS = [{"name": "joints", "size": 7, "unit": "rad"}, {"name": "gripper", "size": 1, "unit": "0 closed, 1 open"}]
SETTINGS: dict[str, Any] = {"state": PARTS, "action": PARTS, "rate": 10, "device": "cpu"}
IMPORT_TORCHCODEC = """
try:
    import torchcodec
except (ImportError, OSError, RuntimeError):
    print("no")
else:
    print("yes")
"""
HORIZON = {"act": 6, "diffusion": 4, "smolvla": 6}


@pytest.fixture(scope="module")
def lerobot(environment: Callable[..., Any]) -> Any:
    return environment("lerobot")


@pytest.fixture(scope="module", params=list(HORIZON))
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def checkpoint(lerobot: Any, kind: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(kind) / "model"
    assert "weights" in lerobot.run("python", Path(__file__).parent / "make_lerobot.py", kind, folder)
    (folder / "vlagents.json").write_text(json.dumps(SETTINGS))
    return folder


def test_training_takes_videos_that_ffmpeg_reads(lerobot: Any, tmp_path: Path, capfd: Any) -> None:
    features = [
        Feature(key=key, shape=(7,), dtype="float64", unit="rad") for key in ("observation/joints", "action/joints")
    ]
    features.append(Feature(key="observation/frames/side/rgb", shape=(48, 64, 3), dtype="uint8", encoding="jpeg"))
    info = DatasetInfo(frequency=10.0, features=tuple(features), setup={"relative": "last_step"}, instruction="nod")
    chance = np.random.default_rng(0)
    with DatasetWriter.open(tmp_path / "nods", info) as writer, writer.episode("000000", seed=0) as episode:
        for row in range(12):
            values: dict[str, Any] = {"observation/joints": chance.normal(size=7)}
            values |= {"action/joints": chance.normal(size=7)} if row else {}
            episode.add(values | {"observation/frames/side/rgb": np.full((48, 64, 3), 20 * row, np.uint8)})
        episode.finish(True)
    loads = "yes" in lerobot.run("python", "-c", IMPORT_TORCHCODEC)
    command = TrainCommand(
        policy="act", dataset=tmp_path / "nods", lerobot_environment=lerobot.folder, out=tmp_path / "run",
        steps=2, lerobot=("batch_size=2", "policy.dim_model=32", "policy.n_heads=2", "policy.dim_feedforward=64"),
    )  # fmt: skip
    assert command.run() == (0 if loads else 1)
    assert ("finds no FFmpeg" in capfd.readouterr().err) is not loads
    assert not loads or list((tmp_path / "run" / "run").glob("checkpoints/*/pretrained_model/model.safetensors"))


@pytest.fixture(scope="module")
def address(lerobot: Any, kind: str, checkpoint: Path) -> Iterator[str]:
    with lerobot.serve(kind, checkpoint) as where:
        yield where


def seen(step: int, session: str = "", *, shape: tuple[int, ...] = (48, 64, 3)) -> Observation:
    chance = np.random.default_rng(step)
    state = {"joints": chance.normal(0.5, 0.01, 7), "gripper": np.ones(1)}
    image = chance.integers(0, 255, shape, np.uint8)
    return Observation(images={"wrist": image}, state=state, instruction="pick up", session=session, time=step / 10)


def test_it_says_what_it_needs_and_answers_in_physical_units(address: str, kind: str) -> None:
    with connect(address, timeout=60.0) as policy:
        metadata = policy.metadata()
        assert (metadata.name, metadata.horizon, metadata.rate) == (kind, HORIZON[kind], 10)
        assert [(image.name, image.height, image.width) for image in metadata.images] == [("wrist", 48, 64)]
        assert [part.name for part in metadata.action] == ["joints", "gripper"]
        assert len(metadata.checkpoint_hash) == 64
        policy.reset("robot", seed=0)
        chunk = policy.infer(seen(3, "robot"))
        assert (chunk.actions.shape, chunk.period, chunk.time) == ((HORIZON[kind], 8), 0.1, 0.3)
        # The statistics: a mean of 0.5, and a hundredth around it.
        assert 0 < np.abs(chunk.actions - 0.5).max() < 0.1


def test_sessions_do_not_mix_and_a_seed_repeats(address: str) -> None:
    with connect(address, timeout=60.0) as policy:

        def episode(name: str, other: str = "") -> list[Any]:
            policy.reset(name, seed=5)
            found = []
            for step in range(3):
                if other:
                    policy.infer(seen(step + 50, other))
                found.append(policy.infer(seen(step, name)).actions)
            return found

        alone = episode("left")
        policy.reset("right", seed=9)
        assert np.array_equal(alone, episode("left", other="right"))


def test_diffusion_remembers_the_observation_before_and_only_if_it_is_one_step_old(address: str, kind: str) -> None:
    def second(policy: Any, first: int) -> Any:
        policy.reset("robot", seed=1)
        policy.infer(seen(first, "robot"))
        return policy.infer(seen(9, "robot")).actions

    with connect(address, timeout=60.0) as policy:
        recent, old, older = (second(policy, first) for first in (8, 4, 2))
        assert np.array_equal(old, older)
        assert np.array_equal(recent, old) == (kind != "diffusion")


def test_what_is_missing_or_has_another_size_is_named(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        with pytest.raises(InvalidInput, match="48 x 64"):
            policy.infer(seen(0, shape=(64, 64, 3)))
        with pytest.raises(InvalidInput, match="no image 'wrist'"):
            policy.infer(Observation(state=dict(seen(0).state), instruction="pick up"))
        with pytest.raises(InvalidInput, match="gripper"):
            policy.infer(replace(seen(0), state={"joints": np.zeros(7)}))


def test_settings_and_types_that_do_not_fit_are_refused(lerobot: Any, checkpoint: Path, kind: str) -> None:
    other = "act" if kind == "diffusion" else "diffusion"
    assert repr(kind) in lerobot.run("vlagents", "serve", other, "--checkpoint", checkpoint, status=1)
    wrong = checkpoint.parent / "settings.json"
    wrong.write_text(json.dumps(SETTINGS | {"action": PARTS[:1]}))
    words = ["vlagents", "serve", "lerobot", "--checkpoint", checkpoint, "--settings", wrong]
    assert "8 numbers" in lerobot.run(*words, status=1)
