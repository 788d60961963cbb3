"""Octo's observations and tasks, with a stand-in for JAX and the model; `make test-interop` has the real ones."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vlagents import InvalidInput, Observation, PartSpec
from vlagents.errors import MissingStack
from vlagents.policies.octo import OctoPolicy
from vlagents.policies.settings import Settings

SETTINGS = Settings(images={"image_primary": "side"}, state=(PartSpec("joints", 2),), dataset="pick")
STATISTICS = {
    "pick": {"action": {"mean": [0.0] * 7, "std": [1.0] * 7}, "proprio": {"mean": [1.0, 1.0], "std": [2.0, 2.0]}}
}


class Model:
    """Keeps what it is shown, and answers with the sum of its task's words."""

    config = {"model": {"heads": {"action": {"kwargs": {"action_horizon": 4}}}}}
    dataset_statistics = STATISTICS
    text_processor: Any = "a tokenizer"

    def __init__(self, window: int = 2) -> None:
        observation = {
            "timestep_pad_mask": np.ones((1, window), bool),
            "image_primary": np.zeros((1, window, 8, 8, 3), np.uint8),
            "proprio": np.zeros((1, window, 2)),
        }
        self.example_batch = {"observation": observation, "task": {"image_primary": 0}}
        self.shown: list[dict[str, Any]] = []
        self.tasks: list[dict[str, Any]] = []

    def create_tasks(self, **task: Any) -> dict[str, Any]:
        self.tasks.append(task)
        return task

    def sample_actions(self, shown: dict[str, Any], task: Any, *, unnormalization_statistics: Any, rng: int) -> Any:
        self.shown.append(shown)
        assert set(unnormalization_statistics) == {"mean", "std"}
        return np.full((1, 4, 7), float(rng))


@pytest.fixture
def model(monkeypatch: pytest.MonkeyPatch) -> Model:
    made = Model()
    upstream: Any = ModuleType("octo.model.octo_model")
    upstream.OctoModel = SimpleNamespace(load_pretrained=lambda path: made)
    jax: Any = ModuleType("jax")
    jax.random = SimpleNamespace(PRNGKey=lambda seed: seed, split=lambda key: (key + 1, key))
    for name, module in (("jax", jax), ("octo.model.octo_model", upstream)):
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("octo", "octo.model"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    return made


@pytest.fixture
def policy(model: Model, tmp_path: Path) -> OctoPolicy:
    (tmp_path / "config.json").write_text("{}")
    return OctoPolicy(str(tmp_path), SETTINGS)


def seen(fill: int, **more: Any) -> Observation:
    image = np.full((8, 8, 3), fill, np.uint8)
    return Observation(images={"side": image}, state={"joints": np.array([3.0, 5.0])}, **more)


def test_the_last_moments_are_shown_and_missing_ones_are_padded(policy: OctoPolicy, model: Model) -> None:
    policy.reset("a", "pick", seed=7)
    for fill in (1, 2, 3):
        chunk = policy.infer(seen(fill, session="a", time=2.0))
        assert (chunk.actions.shape, chunk.period, chunk.time) == ((4, 7), 0.2, 2.0)
        assert chunk.actions[0, 0] == 6.0 + fill, "a key of its own for every answer"
    shown = model.shown[-3:]
    assert [each["image_primary"][0, :, 0, 0, 0].tolist() for each in shown] == [[1, 1], [1, 2], [2, 3]]
    assert [each["timestep_pad_mask"].tolist() for each in shown] == [[[False, True]], [[True, True]], [[True, True]]]
    assert [each["timestep"].tolist() for each in shown] == [[[0, 0]], [[0, 1]], [[0, 1]]]
    np.testing.assert_allclose(shown[0]["proprio"][0], [[1.0, 2.0]] * 2, rtol=1e-6)
    assert model.tasks[-1] == {"texts": ["pick"]}
    policy.reset("a", "place", seed=7)
    policy.infer(seen(9, session="a"))
    assert model.shown[-1]["image_primary"][0, :, 0, 0, 0].tolist() == [9, 9]


def test_a_task_is_a_goal_where_there_is_one_and_words_otherwise(policy: OctoPolicy, model: Model) -> None:
    goal = {"side": np.full((8, 8, 3), 4, np.uint8)}
    policy.infer(seen(1, goals=goal))
    assert model.tasks[-1]["goals"]["image_primary"].shape == (1, 8, 8, 3)
    assert model.tasks[-1]["texts"] is None
    policy.infer(seen(1, goals=goal, instruction="place"))
    assert model.tasks[-1]["texts"] == ["place"]
    with pytest.raises(InvalidInput, match="needs an instruction"):
        policy.infer(seen(1, session="new"))


def test_a_model_that_takes_no_words_needs_a_goal(model: Model, tmp_path: Path) -> None:
    model.text_processor = None
    (tmp_path / "config.json").write_text("{}")
    policy = OctoPolicy(str(tmp_path), SETTINGS)
    assert policy.metadata().needs_goal
    policy.infer(seen(1, goals={"side": np.full((8, 8, 3), 4, np.uint8)}, instruction="place"))
    assert [task.get("texts") for task in model.tasks] == [None, None]
    with pytest.raises(InvalidInput, match=r"takes no words; give images of the goal of \['side'\]"):
        policy.infer(seen(1, instruction="place"))


def test_metadata_are_those_of_the_model_and_the_settings(policy: OctoPolicy) -> None:
    metadata = policy.metadata()
    assert (metadata.horizon, metadata.rate, metadata.size) == (4, 5.0, 7)
    assert not metadata.needs_goal
    assert [(image.name, image.height, image.width) for image in metadata.images] == [("side", 8, 8)]
    assert metadata.state == SETTINGS.state
    assert len(metadata.checkpoint_hash) == 64


def test_other_settings_from_elsewhere_are_another_model_to_a_ledger(model: Model, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text("{}")
    model.dataset_statistics = {**STATISTICS, "place": STATISTICS["pick"]}
    hashes = {
        OctoPolicy(str(tmp_path), replace(SETTINGS, dataset=dataset)).metadata().checkpoint_hash
        for dataset in ("pick", "place")
    }
    assert len(hashes) == 2


def test_settings_that_do_not_fit_are_refused(model: Model, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="save_pretrained wrote"):
        OctoPolicy(str(tmp_path), SETTINGS)
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(InvalidInput, match="state has 2 numbers"):
        OctoPolicy(str(tmp_path), Settings(dataset="pick"))
    with pytest.raises(InvalidInput, match="camera for"):
        OctoPolicy(str(tmp_path), Settings(images={"image_wrist": "wrist"}, state=SETTINGS.state))
    del model.example_batch["observation"]["proprio"]  # type: ignore[attr-defined]
    with pytest.raises(InvalidInput, match="without proprioception"):
        OctoPolicy(str(tmp_path), SETTINGS)
    model.dataset_statistics = {}
    with pytest.raises(InvalidInput, match="no statistics"):
        OctoPolicy(str(tmp_path), Settings())


def test_without_octo_the_error_names_its_recipe(tmp_path: Path) -> None:
    with pytest.raises(MissingStack, match="vlagents recipe octo"):
        OctoPolicy(str(tmp_path), Settings())
