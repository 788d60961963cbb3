"""Any layer as an ordinary Gymnasium wrapper, for other environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from rcs.envs.layers.layer import Layer
from rcs.envs.spaces import ActionCheck
from rcs.errors import InvalidSetup


class LayerWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Put a layer on top of an environment with dictionary spaces.

    Example:
        >>> import gymnasium
        >>> from rcs.envs.layers import BinaryGripper, LayerWrapper
        >>> env = LayerWrapper(gymnasium.make("rcs/FR3-v0", binary_gripper=False), BinaryGripper())
    """

    def __init__(self, env: gymnasium.Env[Any, Any], layer: Layer) -> None:
        """Wrap an environment.

        Raises:
            InvalidSetup: Its action space is not a dictionary of boxes, or its observation space is not a dictionary.
        """
        super().__init__(env)
        if not isinstance(env.action_space, spaces.Dict) or not isinstance(env.observation_space, spaces.Dict):
            raise InvalidSetup("A layer needs an environment whose action and observation spaces are dictionaries.")
        boxes = {key: box for key, box in env.action_space.spaces.items() if isinstance(box, spaces.Box)}
        if len(boxes) != len(env.action_space.spaces):
            raise InvalidSetup("A layer needs an action space whose entries are boxes.")
        self._layer = layer
        outer = layer.action_spaces(boxes)
        self._check = ActionCheck(outer)
        self.action_space = spaces.Dict(dict(outer))
        self.observation_space = spaces.Dict(layer.observation_spaces(env.observation_space.spaces))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and the layer."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._layer.reset(observation)
        return self._layer.map_observation(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Check and map the action, step, map the observation."""
        # A step that raises does not change the layer.
        mapped = self._layer.map_action(self._check(action))
        observation, reward, terminated, truncated, info = self.env.step(mapped)
        # A foreign environment does not report executed actions; they count as given.
        self._layer.map_executed(mapped)
        info_of_layer = {key: np.asarray(value).item() for key, value in self._layer.info().items()}
        return self._layer.map_observation(observation), reward, terminated, truncated, {**info, **info_of_layer}
