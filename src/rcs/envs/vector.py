"""Many copies of one environment, stepped together: the same engine on arrays with a leading axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from rcs.envs.episode_random import check_seed
from rcs.envs.observer import Observer
from rcs.envs.setup import Setup
from rcs.envs.spaces import FRAMES, Observation
from rcs.envs.step.clock import Clock
from rcs.envs.step.engine import Engine
from rcs.envs.step.simulation import Simulation
from rcs.envs.step.stack import Stack
from rcs.envs.step.state import EnvState, read_state, write_state
from rcs.errors import InvalidSetup, WrongOrder, require_fields
from rcs.sim.scene import RobotPlacement


class VecEnv(VectorEnv[Observation, dict[str, Any], NDArray[np.float64]]):
    """Copies of a simulated environment as a Gymnasium vector environment.

    Copy i behaves, bit for bit, as a single environment with the same seed. Physics runs on native threads; every layer
    is one pass over all copies. A copy whose simulation diverges is truncated; its `info["end"]` is `diverged`.
    """

    def __init__(
        self,
        stack: Stack,
        clock: Clock,
        simulation: Simulation,
        *,
        setup: Setup,
        autoreset: AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Put the environment together.

        Args:
            stack: Ports and layers on (copies, ...) arrays.
            clock: Lets time pass.
            simulation: The world with its task.
            setup: Setup of the environment.
            autoreset: When a copy starts its next episode: in the step after its end, in the same step, or never by
                itself.
        """
        self._engine = Engine(stack, clock, simulation, max_episode_steps=setup.max_episode_steps)
        self._autoreset = autoreset
        self._has_seeds = False
        self.setup = setup
        """The setup that the environment was made from."""
        self.simulation = simulation
        """The simulated world and its task."""
        self.stack = stack
        """Ports, layers and gates."""
        self.frequency = clock.frequency
        """Control steps per second [Hz]."""
        self.instruction = simulation.task.instruction
        """The instruction for the robot."""
        self.robots: dict[str, RobotPlacement] = {one.placement.name: one.placement for one in simulation.robots}
        """Descriptions of the robots and where they stand, by name."""
        self.platform = dict.fromkeys(self.robots, "simulation")
        """Origin of every robot: `simulation`."""
        copies = simulation.world.copies
        self.num_envs = copies
        self.metadata = {"render_modes": [], "autoreset_mode": autoreset, "render_fps": max(1, round(clock.frequency))}
        self.render_mode = None
        self.single_action_space = stack.action_space
        self.single_observation_space = stack.observation_space
        self.action_space: spaces.Space[Any] = batch_space(stack.action_space, copies)
        self.observation_space: spaces.Space[Any] = batch_space(stack.observation_space, copies)

    def add_observer(self, observer: Observer, *, copy: int) -> None:
        """Have an observer see every step of one copy from its next episode on, as it sees a single environment.

        Raises:
            InvalidSetup: There is no such copy.
        """
        if not 0 <= copy < self.num_envs:
            raise InvalidSetup(f"copy is {copy}; valid is 0 to {self.num_envs - 1}.")
        self._engine.observers.add(observer, copy)

    def remove_observer(self, observer: Observer) -> None:
        """Have an observer see no more steps."""
        self._engine.observers.remove(observer)

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]  # takes the seed by position, too
        self, seed: int | Sequence[int | None] | None = None, *, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every copy.

        Args:
            seed: A number s gives copy i the seed s + i; a sequence gives each copy its own; None goes on with the next
                episodes. Copies that are not reset keep theirs.
            options: `reset_mask`, (copies,) bool, resets only some copies, and the masks of the info are those of these
                alone, as in gymnasium; the other copies have the values of their last step. The first episodes, and
                those after an error, start in all copies.

        Raises:
            WrongOrder: The environment is closed.
            InvalidSetup: Wrong seeds, an unknown option, or a mask of the wrong shape.
        """
        with self._engine.calls.enter("reset"):
            if not self._engine.is_open:
                raise WrongOrder("reset was called on a closed environment; make a new one.")
            mask = self._check_options(options)
            self._take_seeds(seed, mask)
            started = mask if self._engine.is_started else None
            observation, info = self._engine.start(None if mask is None else np.flatnonzero(mask).astype(np.int32))
            return observation, self._with_masks(info, started)

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]  gymnasium types the done flags as floats
        self, actions: Mapping[str, NDArray[Any]]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step every copy. The info is that of `Env.step`, an array per key.

        With `SameStep`, copies whose episode ends have observation and info of their next one's start; `final_obs` and
        `final_info` have those of the end.

        Args:
            actions: One array (copies, ...) per key of the action space. Those of copies that start anew in this step
                are not used.

        Raises:
            InvalidAction: An action of any copy is not valid; nothing moved in any copy.
            WrongOrder: The environment was not reset, an error broke the episodes off, it is closed, or another thread
                uses it.
        """
        engine = self._engine
        with engine.calls.enter("step"):
            engine.require_running()
            starting = None
            if engine.is_over.any():
                if self._autoreset is AutoresetMode.DISABLED:
                    raise WrongOrder(
                        "Some episodes are over; call reset with options={'reset_mask': mask of those copies}."
                    )
                starting = engine.is_over.copy()
            step = engine.step(actions, starting)
            observation, info = step.observation, self._with_masks(step.info)
            if starting is not None:
                self._tell_started(info, starting)
            if self._autoreset is AutoresetMode.SAME_STEP and engine.is_over.any():
                finished = engine.is_over.copy()
                final = {"final_obs": observation, "final_info": step.info}
                observation, begun = engine.start(np.flatnonzero(finished).astype(np.int32))
                info = _with_begun(info, self._with_masks(begun, finished), finished)
                info.update(final, _final_obs=finished, _final_info=finished.copy())
            return observation, step.reward, step.terminated, step.truncated, info

    def get_state(self, copies: Sequence[int] | NDArray[np.integer] | None = None) -> EnvState:
        """Return everything that decides what follows in some copies; see `Env.get_state`.

        Args:
            copies: Their numbers, each once; None for all. `state[i]` is that of the i-th of them.

        Raises:
            InvalidSetup: There is no such copy.
            WrongOrder: The environment was not reset, an error broke the episodes off, it is closed, or another thread
                uses it.
        """
        with self._engine.calls.enter("get_state"):
            return read_state(self._engine, self._check_copies(copies))

    def set_state(self, state: EnvState, copies: Sequence[int] | NDArray[np.integer] | None = None) -> Observation:
        """Have some copies go on from states, also from those of other copies or of a single environment.

        Args:
            state: States of as many copies, or of one, which all of them go on from.
            copies: The numbers of the copies that are set, each once; None for all.

        Returns:
            The present observation of all copies.

        Raises:
            InvalidSetup: There is no such copy, or the state is that of another environment or number of copies.
            WrongOrder: The environment was not reset, an error broke the episodes off, it is closed, or another thread
                uses it.
        """
        with self._engine.calls.enter("set_state"):
            return write_state(self._engine, state, self._check_copies(copies))

    def _check_copies(self, copies: Sequence[int] | NDArray[np.integer] | None) -> NDArray[np.int32]:
        if copies is None:
            return np.arange(self.num_envs, dtype=np.int32)
        given = np.asarray(copies)
        is_valid = given.ndim == 1 and given.dtype.kind in "iu" and len(set(given.tolist())) == len(given) > 0
        if not is_valid or given.min() < 0 or given.max() >= self.num_envs:
            raise InvalidSetup(
                f"copies is {copies!r}; valid are some of the numbers 0 to {self.num_envs - 1}, each once."
            )
        return given.astype(np.int32)

    def _take_seeds(self, seed: int | Sequence[int | None] | None, mask: NDArray[np.bool_] | None) -> None:
        """Set the seeds of the copies in a mask; those of all for None, or where there were none before."""
        if seed is None and self._has_seeds:
            return
        engine = self._engine
        own = engine.seeds if self._has_seeds else np.random.SeedSequence().generate_state(self.num_envs)
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
        if mask is not None and self._has_seeds:
            given = [value if is_reset else None for value, is_reset in zip(given, mask, strict=True)]
        # None goes on with the next episode of the copy's own seed, as in gymnasium.
        is_new = np.array([value is not None or not self._has_seeds for value in given])
        engine.seeds[:] = [int(mine) if value is None else value for value, mine in zip(given, own, strict=True)]
        engine.episodes[is_new] = -1
        self._has_seeds = True

    def _check_options(self, options: Mapping[str, Any] | None) -> NDArray[np.bool_] | None:
        if options is not None and not isinstance(options, Mapping):
            raise InvalidSetup(f"The reset options are {options!r}; valid is a dictionary, or None.")
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        require_fields("reset option", given, ("reset_mask",))
        if mask is None:
            return None
        array = np.array(mask)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            raise InvalidSetup(f"reset_mask must be {self.num_envs} booleans with at least one True.")
        return array

    def _tell_started(self, info: dict[str, Any], started: NDArray[np.bool_]) -> None:
        """Add the entries that the reset of a single environment has and its steps do not."""
        added: dict[str, Any] = {"instruction": np.full(self.num_envs, self.instruction, object)}
        if drawn := self.simulation.randomisation:
            added["randomisation"] = drawn
        info.update(self._with_masks(added, started))

    def _with_masks(self, values: Mapping[str, Any], present: NDArray[np.bool_] | None = None) -> dict[str, Any]:
        """Return info as gymnasium's vector environments have it: an array and the mask `_key` per key."""
        if present is None:
            present = np.ones(self.num_envs, np.bool_)
        info: dict[str, Any] = {
            key: self._with_masks(value, present) if isinstance(value, Mapping) else value
            for key, value in values.items()
        }
        info.update({f"_{key}": present for key in values})
        return info

    def close(self, **kwargs: Any) -> None:
        """Let go of everything. Closing twice is harmless."""
        self._engine.close()

    def __str__(self) -> str:
        """Return the environment, its task and its stack, part by part."""
        return "\n".join([self.setup.title, f"  {self.simulation}", str(self.stack)])

    def __repr__(self) -> str:
        """Return the first line."""
        cameras = FRAMES in self.stack.observation_space.spaces
        return f"{self.setup.title} ({self.num_envs} copies{', with cameras' if cameras else ''})"


def _with_begun(info: Mapping[str, Any], begun: Mapping[str, Any], where: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the info of a step, in new arrays, in which some copies have that of the start of their next episode.

    Args:
        info: Info of the step, with masks.
        begun: Info of the start, with masks.
        where: The copies that have started, (copies,); they keep nothing of the episode before.
    """
    merged: dict[str, Any] = {}
    for key in {**info, **begun}:
        old, new = info.get(key), begun.get(key)
        if isinstance(new if old is None else old, Mapping):
            merged[key] = _with_begun(old or {}, new or {}, where)
            continue
        merged[key] = np.array(new if old is None else old)
        if new is not None:
            merged[key][where] = new[where]
        elif key.startswith("_"):
            merged[key][where] = False
    return merged
