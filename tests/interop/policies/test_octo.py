"""A tiny Octo with random weights, saved by Octo, served in Octo's environment, asked from this one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import Observation, connect

pytestmark = pytest.mark.interop

REPO = "OCTO_REPO"
SETTINGS: dict[str, Any] = {
    "dataset": "small",
    "images": {"image_primary": "side", "image_wrist": "wrist"},
    "state": [{"name": "joints", "size": 7, "unit": "rad"}, {"name": "gripper", "size": 1}],
    "rate": 10,
}


@pytest.fixture(scope="module")
def octo(environment: Callable[..., Any]) -> Any:
    return environment("octo", REPO, "DLIMP_REPO")


@pytest.fixture(scope="module")
def checkpoint(octo: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("octo") / "model"
    assert "weights" in octo.run("python", Path(__file__).parent / "make_octo.py", folder)
    (folder / "vlagents.json").write_text(json.dumps(SETTINGS))
    return folder


@pytest.fixture(scope="module")
def address(octo: Any, checkpoint: Path) -> Iterator[str]:
    with octo.serve("octo", checkpoint) as where:
        yield where


def seen(seed: int, session: str = "", **more: Any) -> Observation:
    random = np.random.default_rng(seed)
    images = {
        "side": random.integers(0, 255, (64, 64, 3), np.uint8),
        "wrist": random.integers(0, 255, (32, 32, 3), np.uint8),
    }
    state = {"joints": random.normal(size=7), "gripper": np.ones(1)}
    return Observation(images=images, state=state, session=session, time=float(seed), **more)


def test_octo_says_what_it_needs_and_answers_in_physical_units(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        metadata = policy.metadata()
        assert [(image.name, image.height, image.width) for image in metadata.images] == [
            ("side", 64, 64),
            ("wrist", 32, 32),
        ]
        assert [(part.name, part.size, part.meaning) for part in metadata.action] == [
            ("xyzrpy", 6, "delta"),
            ("gripper", 1, "absolute"),
        ]
        assert (metadata.horizon, metadata.rate, len(metadata.checkpoint_hash)) == (4, 10, 64)
        policy.reset("robot", "pick up the green cuboid", seed=3)
        chunk = policy.infer(seen(5, "robot"))
        assert (chunk.actions.shape, chunk.time, chunk.period) == ((4, 7), 5.0, 0.1)
        # The head's samples are clipped at 5 before they are scaled, so each number is within 5 of its spread.
        assert np.all(np.abs(chunk.actions[:, :6] - np.arange(6)) <= 5 * np.repeat([0.01, 0.1], 3) + 1e-4)


def test_two_robots_on_one_octo_never_mix_their_moments_or_tasks(address: str) -> None:
    tasks = {"left": "pick up the green cuboid", "right": "push the red cuboid"}
    with connect(address, timeout=60.0) as policy:

        def asked(order: list[str]) -> dict[str, list[np.ndarray]]:
            for name in tasks:
                policy.reset(name, tasks[name], seed=7)
            found: dict[str, list[np.ndarray]] = {name: [] for name in tasks}
            for name in order:
                found[name].append(policy.infer(seen(len(found[name]), name)).actions)
            return found

        alone, together = asked(["left"] * 3 + ["right"] * 3), asked(["left", "right"] * 3)
        for name in tasks:
            assert np.array_equal(alone[name], together[name])
        # Same seed and pictures, other words.
        assert not np.array_equal(together["left"], together["right"])


def test_what_octo_saw_before_counts_until_the_reset(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        answers = []
        for before in (1, 2, 2):
            policy.reset("robot", "pick up the green cuboid", seed=0)
            policy.infer(seen(before, "robot"))
            answers.append(policy.infer(seen(9, "robot")).actions)
    assert not np.array_equal(answers[0], answers[1])
    assert np.array_equal(answers[1], answers[2])


def test_octo_takes_a_picture_of_the_goal_for_words(address: str) -> None:
    with connect(address, timeout=60.0) as policy:
        policy.reset("robot", seed=0)
        by_goal = policy.infer(seen(1, "robot", goals=seen(2).images)).actions
        policy.reset("robot", seed=0)
        by_another = policy.infer(seen(1, "robot", goals=seen(3).images)).actions
        assert not np.array_equal(by_goal, by_another)
        policy.reset("robot")
        with pytest.raises(Exception, match="told in words"):
            policy.infer(seen(1, "robot"))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"dataset": "bridge"}, "large, small"),
        ({"state": []}, "8 numbers"),
        ({"images": {"primary": "side"}}, "image_primary"),
        ({"rate": "fast"}, "hertz"),
    ],
)
def test_settings_that_do_not_fit_the_checkpoint_are_refused_with_what_is_valid(
    octo: Any, checkpoint: Path, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    (tmp_path / "settings.json").write_text(json.dumps(SETTINGS | changed))
    words = ["vlagents", "serve", "octo", "--checkpoint", checkpoint, "--settings", tmp_path / "settings.json"]
    assert said in octo.run(*words, status=1)
