"""Copies of an environment as Stable-Baselines3 takes them: vectors, terminal observations and statistics."""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from rcs.envs.step.judge import DIVERGED
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup, MissingDependency, WrongOrder
from rcs.rl.flat import Flat

_Base: Any = object  # of a class, hence here: this module is imported when `Sb3VecEnv` is used
with contextlib.suppress(ImportError):  # making one names the missing extra
    _Base = importlib.import_module("stable_baselines3.common.vec_env").VecEnv


class Sb3VecEnv(_Base):  # pyright: ignore[reportUntypedBaseClass]
    """A `rcs.VecEnv` behind the interface of Stable-Baselines3's `VecEnv`, with flat actions and observations.

        envs = Sb3VecEnv(rcs.make_vec("PickCuboid", copies=32, autoreset="SameStep", observe=("privileged",)))
        model = PPO("MlpPolicy", envs)

    The infos of a step are empty but for copies whose episode ended. Those have what SB3 and its monitors look for:
    `terminal_observation`, `TimeLimit.truncated`, `episode` (`r` return, `l` steps, `t` seconds since the start), and
    `is_success`, besides `end`, which says how the last step ended. A copy whose simulation diverged counts as
    terminated: its last observation is of no episode, and has no value.

    Arrays that a step returns are new, and stay as they are; frames are those of the environment if it gives them with
    channels first.
    """

    def __init__(self, envs: VecEnv, flat: Flat | None = None, *, reward_scale: float = 1.0) -> None:
        """Wrap copies.

        Args:
            envs: Made by `rcs.make_vec` with `autoreset="SameStep"`.
            flat: The maps; None for `Flat(envs)`.
            reward_scale: Factor on the rewards of a step; the returns in infos are without it.

        Raises:
            MissingDependency: Stable-Baselines3 is not installed.
            InvalidSetup: The copies start their next episode in another step than that of the end.
        """
        if _Base is object:
            raise MissingDependency(
                "Stable-Baselines3 is not installed; install the extra: pip install 'robot-control-stack[rl]'."
            )
        mode = envs.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise InvalidSetup(f"autoreset is {mode}; Stable-Baselines3 needs make_vec(..., autoreset='SameStep').")
        self.envs = envs
        """The copies."""
        self.flat = Flat(envs) if flat is None else flat
        """The maps between their dictionaries and vectors."""
        super().__init__(envs.num_envs, self.flat.observation_space, self.flat.action_space)
        self._reward_scale = reward_scale
        self.returns = np.zeros(envs.num_envs)
        """Sum of the rewards of each copy's running episode, (copies,)."""
        self.lengths = np.zeros(envs.num_envs, np.int64)
        """Steps of each copy's running episode, (copies,)."""
        self._start = time.monotonic()
        self._actions: dict[str, Any] | None = None

    def reset(self) -> Any:
        """Start an episode in every copy, with the seeds of `seed` if it was called before; return the observations.

        Raises:
            InvalidSetup: Options were set; an environment here takes none.
        """
        if any(self._options):
            raise InvalidSetup("set_options was called; copies take no options at a reset.")
        observation, _ = self.envs.reset(seed=self._seeds)
        self._reset_seeds()
        self.returns[:], self.lengths[:] = 0.0, 0
        return self.flat.observation(observation)

    def step_async(self, actions: NDArray[np.floating[Any]]) -> None:
        """Take the actions (copies, n) of the next step."""
        self._actions = self.flat.action(actions)

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Make the step.

        Returns:
            Observations, rewards (copies,), whether each copy's episode ended (copies,), and an info per copy. The
            observation of a copy whose episode ended is the first of the next one.

        Raises:
            WrongOrder: There were no actions before.
        """
        if self._actions is None:
            raise WrongOrder("step_wait was called without step_async; call step.")
        actions, self._actions = self._actions, None
        observation, reward, terminated, truncated, info = self.envs.step(actions)
        done = terminated | truncated
        self.returns += reward
        self.lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            self._describe_ends(infos, info, np.flatnonzero(done), truncated)
        return self.flat.observation(observation), (reward * self._reward_scale).astype(np.float32), done, infos

    def _describe_ends(
        self, infos: list[dict[str, Any]], info: Mapping[str, Any], ended: NDArray[np.intp], truncated: NDArray[Any]
    ) -> None:
        last = self.flat.observation(info["final_obs"])
        seconds = round(time.monotonic() - self._start, 6)
        ends: Any = info["final_info"]["end"]
        success = info["final_info"].get("success")
        for copy in ended.tolist():
            end = str(ends[copy])
            own = {key: rows[copy] for key, rows in last.items()} if isinstance(last, dict) else last[copy]
            infos[copy] = {
                "terminal_observation": own,
                "TimeLimit.truncated": bool(truncated[copy]) and end != DIVERGED,
                "episode": {"r": float(self.returns[copy]), "l": int(self.lengths[copy]), "t": seconds},
                "end": end,
            }
            if success is not None:
                infos[copy]["is_success"] = bool(success[copy])
        self.returns[ended], self.lengths[ended] = 0.0, 0

    def close(self) -> None:
        """Close the copies; twice is harmless."""
        self.envs.close()

    # --- Methods for single environments ------------------------------------------------------------------------------

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute of the copies' environment, once per copy."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Set an attribute of the copies' environment.

        Raises:
            InvalidSetup: Only some copies are named: they are one environment.
        """
        self._require_all(indices)
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the copies' environment, once; its result is given once per copy.

        Raises:
            InvalidSetup: Only some copies are named: they are one environment.
        """
        numbers = self._require_all(indices)
        return [getattr(self.envs, method_name)(*method_args, **method_kwargs)] * len(numbers)

    def env_is_wrapped(self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None) -> list[bool]:
        """Return whether copies are wrapped: by nothing, but their infos have what SB3's `Monitor` would add."""
        monitor = importlib.import_module("stable_baselines3.common.monitor").Monitor
        return [wrapper_class is monitor] * len(list(self._get_indices(indices)))

    def _require_all(self, indices: int | Iterable[int] | None) -> list[int]:
        numbers = list(self._get_indices(indices))
        if sorted(numbers) != list(range(self.num_envs)):
            raise InvalidSetup(f"indices is {indices!r}; the copies are one environment, so name all or none.")
        return numbers
