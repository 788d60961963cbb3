"""Many copies of one environment, stepped together: the same stack on arrays with a leading axis."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.envs.clock import Clock
from rcs.envs.draws import Draws, check_seed
from rcs.envs.group import StackGroup
from rcs.envs.scenario import Scenario
from rcs.envs.spaces import FRAMES, Observation
from rcs.envs.stack import Stack, copied, for_all
from rcs.envs.turn import Turn
from rcs.errors import InvalidSetup, WrongOrder


class VecEnv(VectorEnv[Observation, dict[str, Any], NDArray[np.float64]]):
    """Copies of a simulated environment as a Gymnasium vector environment.

    Copy i behaves, bit for bit, as a single environment with the same seed. Physics runs on native threads; every layer
    is one pass over all copies. A copy whose simulation diverges is truncated, with `info["diverged"]`.
    """

    def __init__(
        self,
        stack: Stack | StackGroup,
        clock: Clock,
        scenario: Scenario,
        *,
        max_episode_steps: int | None = None,
        autoreset: AutoresetMode = AutoresetMode.NEXT_STEP,
        title: str = "rcs.VecEnv",
    ) -> None:
        """Put the environment together.

        Args:
            stack: Ports and layers on (copies, ...) arrays.
            clock: Lets time pass.
            scenario: The world with its task.
            max_episode_steps: An episode is truncated after this many steps; None for no limit.
            autoreset: When a copy starts its next episode: in the step after its end, in the same step, or never by
                itself.
            title: First line of the printed environment.
        """
        self._stack = stack
        self._clock = clock
        self._scenario = scenario
        self._max_episode_steps = max_episode_steps
        self._autoreset = autoreset
        self._title = title
        self._is_open = True
        self._is_reset = False
        self._broken_off_by = ""
        self._turn = Turn()
        copies = scenario.world.copies
        self.num_envs = copies
        self.metadata = {"render_modes": [], "autoreset_mode": autoreset}
        self.render_mode = None
        self.single_action_space = stack.action_space
        self.single_observation_space = stack.observation_space
        self.action_space: spaces.Space[Any] = batch_space(stack.action_space, copies)
        self.observation_space: spaces.Space[Any] = batch_space(stack.observation_space, copies)
        self._steps = np.zeros(copies, np.int64)
        self._is_done = np.zeros(copies, np.bool_)
        self._episodes = np.zeros(copies, np.int64)
        self._seeds = np.zeros(copies, np.int64)
        self._has_seeds = False

    @property
    def stack(self) -> Stack | StackGroup:
        """Ports and layers."""
        return self._stack

    @property
    def scenario(self) -> Scenario:
        """The simulated world and its task."""
        return self._scenario

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every copy.

        Args:
            seed: A number s gives copy i the seed s + i; a sequence gives each copy its own; None goes on with the next
                episodes.
            options: `reset_mask`, (copies,) bool, resets only some copies.

        Raises:
            WrongOrder: The environment is closed.
            InvalidSetup: Wrong seeds, an unknown option, or a mask of the wrong shape.
        """
        with self._turn.take("reset"):
            if not self._is_open:
                raise WrongOrder("reset was called on a closed environment; make a new one.")
            mask = self._check_options(options)
            self._take_seeds(seed)
            copies = None if mask is None or not self._is_reset else np.flatnonzero(mask).astype(np.int32)
            with self._all_or_none():
                self._begin(copies)
                measured = self._stack.measure()
                self._stack.reset(measured, ... if copies is None else copies)
                self._clock.reset()
                told = self._scenario.describe()
                return self._stack.lift(measured), self._with_masks(told)

    @contextmanager
    def _all_or_none(self) -> Generator[None]:
        """After an error, or Ctrl-C, copies have gone different ways: all start anew."""
        was_reset, self._is_reset = self._is_reset, False
        try:
            yield
        except BaseException as err:
            self._broken_off_by = type(err).__name__ if was_reset else ""
            raise
        self._is_reset = True

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]  gymnasium types the done flags as floats
        self, actions: Mapping[str, NDArray[Any]]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step every copy.

        Args:
            actions: One array (copies, ...) per key of the action space. Those of copies that start anew in this step
                are not used.

        Raises:
            InvalidAction: An action of any copy is not valid; nothing moved in any copy.
            WrongOrder: The environment was not reset, an error broke the episodes off, it is closed, or another thread
                uses it.
        """
        with self._turn.take("step"):
            if not self._is_reset or not self._is_open:
                raise WrongOrder(self._explain_order())
            if self._autoreset is AutoresetMode.DISABLED and self._is_done.any():
                raise WrongOrder(
                    "Some episodes are over; call reset with options={'reset_mask': mask of those copies}."
                )
            mapped = self._stack.map(actions)
            with self._all_or_none():
                return self._advance(mapped)

    def _advance(
        self, mapped: dict[str, Any]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make a step with actions that were checked and mapped."""
        self._stack.send(mapped)
        starting = self._is_done.copy() if self._autoreset is AutoresetMode.NEXT_STEP else np.zeros_like(self._is_done)
        some_start = bool(starting.any())
        ids = np.flatnonzero(starting).astype(np.int32) if some_start else None
        if ids is None:
            self._clock.advance()
        else:
            running = np.flatnonzero(~starting).astype(np.int32)
            self._clock.advance(running)
            self._begin(ids)
        measured = self._stack.measure()
        if ids is not None:
            self._stack.reset(measured, ids)
        observation = self._stack.lift(measured)
        self._steps += ~starting
        outcome = self._scenario.evaluate()
        diverged = (self._clock.ends == StepEnd.failed.value) & ~starting
        reward = np.where(starting | diverged, 0.0, outcome.reward)
        terminated = outcome.terminated & ~starting & ~diverged
        truncated = diverged.copy()
        if self._max_episode_steps is not None:
            truncated |= (self._steps >= self._max_episode_steps) & ~terminated & ~starting
        self._is_done = terminated | truncated
        info = self._with_masks(
            {
                **outcome.info,
                **self._stack.info(),
                "target": copied(self._stack.target),
                "end": self._clock.ends.copy(),
                "diverged": diverged,
            }
        )
        if some_start:
            self._tell_drawn(info, starting)
        if self._autoreset is AutoresetMode.SAME_STEP and self._is_done.any():
            observation = self._restart_finished(observation, info)
        return observation, reward, terminated, truncated, info

    def _restart_finished(self, observation: Observation, info: dict[str, Any]) -> Observation:
        ids = np.flatnonzero(self._is_done).astype(np.int32)
        final_info = {key: value for key, value in info.items() if not key.startswith("_")}
        info["final_obs"] = observation
        info["final_info"] = final_info
        info["_final_obs"] = info["_final_info"] = finished = self._is_done.copy()
        self._begin(ids)
        self._tell_drawn(info, finished)
        measured = self._stack.measure()
        self._stack.reset(measured, ids)
        return self._stack.lift(measured)

    def _begin(self, copies: NDArray[np.int32] | None) -> None:
        """Start the next episode of some copies."""
        where = slice(None) if copies is None else copies
        self._episodes[where] += 1
        self._steps[where] = 0
        self._is_done[where] = False
        self._scenario.begin(Draws(self._seeds[where], self._episodes[where]), copies)

    def _take_seeds(self, seed: int | Sequence[int | None] | None) -> None:
        if seed is None and self._has_seeds:
            return
        own = self._seeds if self._has_seeds else np.random.SeedSequence().generate_state(self.num_envs)
        given: list[int | None]
        if seed is None:
            given = [None] * self.num_envs
        elif isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            if len(seed) != self.num_envs:
                raise InvalidSetup(f"{len(seed)} seeds were given for {self.num_envs} copies.")
            given = [None if value is None else check_seed(value) for value in seed]
        else:
            first = check_seed(seed)
            given = [check_seed(first + i) for i in range(self.num_envs)]
        # None goes on with the next episode of the copy's own seed, as in gymnasium.
        is_new = np.array([value is not None or not self._has_seeds for value in given])
        seeds = [int(mine) if value is None else value for value, mine in zip(given, own, strict=True)]
        self._seeds = np.array(seeds, np.int64)
        self._episodes[is_new] = -1
        self._has_seeds = True

    def _check_options(self, options: Mapping[str, Any] | None) -> NDArray[np.bool_] | None:
        if options is not None and not isinstance(options, Mapping):
            raise InvalidSetup(f"The reset options are {options!r}; valid is a dictionary, or None.")
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        if given:
            raise InvalidSetup(f"Unknown reset options {sorted(given)}; valid: 'reset_mask'.")
        if mask is None:
            return None
        array = np.asarray(mask)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            raise InvalidSetup(f"reset_mask must be {self.num_envs} booleans with at least one True.")
        return array

    def _tell_drawn(self, info: dict[str, Any], started: NDArray[np.bool_]) -> None:
        """Add what was drawn for the episodes that start, where anything is."""
        if drawn := self._scenario.randomisation:
            info.update(self._with_masks({"randomisation": drawn}, started))

    def _with_masks(self, told: Mapping[str, Any], present: NDArray[np.bool_] | None = None) -> dict[str, Any]:
        """Return info as gymnasium's vector environments have it: an array and the mask `_key` per key."""
        if present is None:
            present = np.ones(self.num_envs, np.bool_)
        info: dict[str, Any] = {
            key: self._with_masks(value, present) if isinstance(value, Mapping) else value
            for key, value in told.items()
        }
        info.update({f"_{key}": present for key in told})
        return info

    def close(self, **kwargs: Any) -> None:
        """Let go of everything. Closing twice is harmless."""
        if not self._is_open:
            return
        self._is_open = False
        if self._turn.is_of_another_thread:
            self._turn.wait()
        for_all([self._stack.close, self._scenario.world.close])

    def _explain_order(self) -> str:
        if not self._is_open:
            return "step was called on a closed environment; make a new one."
        if self._broken_off_by:
            return f"step was called after {self._broken_off_by} broke the episodes off; call reset."
        return "step was called before the first reset; call reset."

    def close_extras(self, **kwargs: Any) -> None:
        """Do nothing more than `close` did; gymnasium calls this."""

    def __str__(self) -> str:
        """Return the environment, its task and its stack, part by part."""
        return "\n".join([self._title, f"  {self._scenario}", str(self._stack)])

    def __repr__(self) -> str:
        """Return the first line."""
        cameras = FRAMES in self._stack.observation_space.spaces
        return f"{self._title} ({self.num_envs} copies{', with cameras' if cameras else ''})"
