from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from rcs.envs.layers import BinaryGripper, Layer, LayerWrapper, LimitStep, Relative
from rcs.errors import InvalidAction, InvalidSetup


class Foreign(gymnasium.Env[Any, Any]):
    """An environment that is not from here: two joints that are at their targets at once."""

    metadata: ClassVar[dict[str, Any]] = {}

    def __init__(self) -> None:
        self.action_space = spaces.Dict(
            {"joints": spaces.Box(-1.0, 1.0, (2,), np.float64), "gripper": spaces.Box(0.0, 1.0, (1,), np.float32)}
        )
        self.observation_space = spaces.Dict({"joints": spaces.Box(-2.0, 2.0, (2,), np.float64)})
        self.actions: list[Any] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.joints = np.zeros(2)
        return {"joints": self.joints.copy()}, {"from": "reset"}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.actions.append(action)
        self.joints = action["joints"]
        return {"joints": self.joints.copy()}, 1.0, False, False, {"from": "step"}


def test_a_layer_works_on_a_foreign_environment() -> None:
    foreign = Foreign()
    env = LayerWrapper(foreign, BinaryGripper())
    env.reset(seed=0)
    for given, sent in ((0.2, 0.0), (0.5, 1.0), (0.9, 1.0)):
        _, reward, *_ = env.step({"joints": np.zeros(2), "gripper": np.full(1, given, np.float32)})
        assert foreign.actions[-1]["gripper"] == sent
        assert reward == 1.0


def test_relative_actions_add_up_on_a_foreign_environment() -> None:
    env = LayerWrapper(Foreign(), Relative("joints", frequency=30.0, joint_speed=3.0))
    assert env.action_space["joints"].high[0] == pytest.approx(0.1)
    env.reset(seed=0)
    for i in range(1, 5):
        observation, *_ = env.step({"joints": np.array([0.1, -0.05]), "gripper": np.ones(1, np.float32)})
        np.testing.assert_allclose(observation["joints"], [0.1 * i, -0.05 * i])
    observation, _ = env.reset()
    observation, *_ = env.step({"joints": np.array([0.1, 0.0]), "gripper": np.ones(1, np.float32)})
    np.testing.assert_allclose(observation["joints"], [0.1, 0.0])


def test_layers_stack_and_their_info_is_added() -> None:
    env = LayerWrapper(LayerWrapper(Foreign(), LimitStep(np.full(2, 0.2), 0.6)), BinaryGripper())
    _, info = env.reset(seed=0)
    assert info == {"from": "reset"}
    *_, info = env.step({"joints": np.ones(2), "gripper": np.ones(1, np.float32)})
    assert info == {"from": "step", "is_limited": True}


def test_actions_are_checked() -> None:
    foreign = Foreign()
    env = LayerWrapper(foreign, Layer())
    env.reset(seed=0)
    with pytest.raises(InvalidAction):
        env.step({"joints": np.array([np.nan, 0.0]), "gripper": np.ones(1, np.float32)})
    assert foreign.actions == []


def test_a_layer_that_overrides_nothing_changes_nothing() -> None:
    layer, value = Layer(), {"joints": np.zeros(2)}
    assert layer.map_action(value) is value
    assert layer.map_executed(value) is value
    assert layer.map_observation(value) is value
    assert layer.info() == {}
    assert str(layer) == "Layer"


def test_an_environment_without_dictionaries_of_boxes_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="dictionaries"):
        LayerWrapper(gymnasium.make("CartPole-v1"), Layer())
    foreign = Foreign()
    foreign.action_space["mode"] = spaces.Discrete(3)
    with pytest.raises(InvalidSetup, match="boxes"):
        LayerWrapper(foreign, Layer())
