"""One environment: ports and layers, a clock and a task behind the interface of Gymnasium."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.envs.clock import Clock
from rcs.envs.draws import SEED_LIMIT, Draws
from rcs.envs.group import StackGroup
from rcs.envs.observers import Observer, Transition
from rcs.envs.scenario import Scenario
from rcs.envs.spaces import Observation
from rcs.envs.stack import Stack
from rcs.envs.start import Start, check_start
from rcs.errors import Diverged, InvalidAction, InvalidSetup, WrongOrder
from rcs.sim.picture import Picture

END_NAMES = {end.value: end.name for end in (getattr(StepEnd, name) for name in StepEnd.__members__)}
"""What `info["end"]` says."""


class Env(gymnasium.Env[Observation, dict[str, Any]]):
    """A robot, simulated or real, as a Gymnasium environment.

    Made by `rcs.make`, or from parts by hand. `print(env)` shows the parts.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012  gymnasium's name

    def __init__(
        self,
        stack: Stack | StackGroup,
        clock: Clock,
        scenario: Scenario | None = None,
        *,
        max_episode_steps: int | None = None,
        observers: Sequence[Observer] = (),
        picture: Picture | None = None,
        title: str = "rcs.Env",
    ) -> None:
        """Put an environment together; nothing moves and nothing is connected before `reset`.

        Args:
            stack: Ports and layers.
            clock: Lets time pass.
            scenario: A simulated world with its task; None for real devices without a task.
            max_episode_steps: An episode is truncated after this many steps; None for no limit.
            observers: See every step.
            picture: Draws what `render` returns; None for an environment that has none.
            title: First line of the printed environment.
        """
        self._stack = stack
        self._clock = clock
        self._scenario = scenario
        self._max_episode_steps = max_episode_steps
        self._observers = list(observers)
        self._picture = picture
        self._title = title
        self._is_open = True
        self._is_running = False
        self._steps = 0
        self._episode = -1
        self._seed = 0
        self.action_space = stack.action_space
        self.observation_space = stack.observation_space
        self.render_mode = None if picture is None else "rgb_array"

    @property
    def stack(self) -> Stack | StackGroup:
        """Ports and layers."""
        return self._stack

    @property
    def scenario(self) -> Scenario:
        """The simulated world and its task.

        Raises:
            WrongOrder: This environment is not simulated.
        """
        if self._scenario is None:
            raise WrongOrder("This environment drives real devices; it has no simulated world.")
        return self._scenario

    def add_observer(self, observer: Observer) -> None:
        """Have an observer see every step from the next reset on."""
        self._observers.append(observer)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Same seed, same episode, and the same episodes after it. Without one, the next episode of the last
                seed.
            options: `state` starts the episode in a simulation state of `env.scenario.world.states()`. `robot` starts
                it with `joints`, and `gripper` or `hand`, as an observation has them, and `objects` with objects at
                poses (7,) in the base frame (of several robots: the scene), as `env.scenario.object_poses()` has them.

        Raises:
            WrongOrder: The environment is closed.
            InvalidSetup: A seed out of range, an unknown option, or a start that makes no sense.
        """
        if not self._is_open:
            raise WrongOrder("reset was called on a closed environment; make a new one.")
        state, start = self._check_options(options)
        if seed is not None and not 0 <= seed < SEED_LIMIT:
            raise InvalidSetup(f"The seed is {seed}; valid is 0 to 2**63 - 1.")
        super().reset(seed=seed)
        if seed is not None or self._episode < 0:
            # Gymnasium's own seeds have 128 bits.
            self._seed = self.np_random_seed % SEED_LIMIT if seed is None else int(seed)
            self._episode = -1
        self._episode += 1
        self._steps = 0
        info: dict[str, Any] = {}
        if self._scenario is not None:
            self._scenario.begin(Draws(self._seed, self._episode))
            if state is not None:
                self._scenario.world.core.set_state(state)
                self._scenario.world.refresh()
            if start is not None:
                self._scenario.start_at(start)
            info.update(_plain(self._scenario.describe()))
        for port in self._stack.ports:
            port.open()
        self._clock.reset()
        measured = self._stack.measure()
        self._stack.reset(measured, ...)
        observation = self._stack.lift(measured)
        self._is_running = True
        if self._observers:
            first = Transition(
                observation=observation,
                action=None,
                executed=None,
                reward=0.0,
                terminated=False,
                truncated=False,
                info=info,
                time=time.perf_counter(),
                capture_times=self._stack.capture_times(),
            )
            for observer in self._observers:
                observer.on_reset(first, seed)
        return observation, info

    def step(self, action: Mapping[str, Any]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Command all devices, let one control step pass, observe.

        Args:
            action: One array per key of `action_space`.

        Raises:
            InvalidAction: The action is not valid; no device saw it.
            WrongOrder: The environment was not reset, its episode is over, or it is closed.
            Diverged: The simulation left the range of finite numbers; reset starts anew.
            DeviceFault: A device is in its fault state; all others hold.
        """
        if not self._is_running:
            raise WrongOrder(self._explain_order())
        try:
            self._stack.command(action)
            self._clock.advance()
            measured = self._stack.measure()
        except InvalidAction:
            raise
        except BaseException:
            # A device that failed, or Ctrl-C: nothing goes on moving unwatched.
            self._stack.hold()
            raise
        end = int(self._clock.ends[0])
        if end == StepEnd.failed.value:
            self._is_running = False
            raise Diverged("The simulation left the range of finite numbers (see MuJoCo's log); call reset.")
        observation = self._stack.lift(measured)
        self._steps += 1
        info: dict[str, Any] = {"end": END_NAMES[end]}
        reward, terminated = 0.0, False
        if self._scenario is not None:
            outcome = self._scenario.evaluate()
            reward, terminated = float(outcome.reward), bool(outcome.terminated)
            info.update(_plain(outcome.info))
        info.update(_plain(self._stack.info()))
        truncated = self._max_episode_steps is not None and self._steps >= self._max_episode_steps and not terminated
        self._is_running = not (terminated or truncated)
        if self._observers:
            transition = Transition(
                observation=observation,
                action=action,
                executed=self._stack.executed,
                reward=reward,
                terminated=terminated,
                truncated=truncated,
                info=info,
                time=time.perf_counter(),
                capture_times=self._stack.capture_times(),
            )
            try:
                for observer in self._observers:
                    observer.on_step(transition)
            except BaseException:
                # A full disk, a camera that hangs: what goes wrong beside a robot must not leave it moving unwatched.
                self._stack.hold()
                raise
        return observation, reward, terminated, truncated, info

    def render(self) -> Any:
        """Return a picture of the scene, (H, W, 3) uint8; None when made without `render_mode`."""
        if self._picture is None:
            return None
        return self._picture.draw()

    def hold(self) -> None:
        """Make every device stay where it is, also when one of them fails to."""
        self._stack.hold()

    def close(self) -> None:
        """Let go of all devices and observers. Closing twice is harmless."""
        if not self._is_open:
            return
        self._is_open = self._is_running = False
        for observer in self._observers:
            observer.close()
        if self._picture is not None:
            self._picture.close()
        self._stack.close()

    def _explain_order(self) -> str:
        if not self._is_open:
            return "step was called on a closed environment; make a new one."
        if self._episode < 0:
            return "step was called before the first reset; call reset."
        return "step was called after the end of the episode; call reset."

    def _check_options(self, options: Mapping[str, Any] | None) -> tuple[NDArray[np.float64] | None, Start | None]:
        given = dict(options or {})
        state, robot, objects = (given.pop(name, None) for name in ("state", "robot", "objects"))
        if given:
            raise InvalidSetup(f"Unknown reset options {sorted(given)}; valid: 'state', 'robot', 'objects'.")
        if robot is not None or objects is not None:
            if state is not None:
                raise InvalidSetup("The reset option 'state' says all; give it without 'robot' and 'objects'.")
            return None, check_start(self.scenario.robots, self.scenario.task.object_poses(), robot, objects)
        if state is None:
            return None, None
        size = self.scenario.world.core.state_size
        array = np.asarray(state, np.float64)
        if array.shape != (size,) or not np.isfinite(array).all():
            raise InvalidSetup(f"The option 'state' has shape {array.shape}; valid are {size} finite numbers.")
        return array, None

    def __str__(self) -> str:
        """Return the environment, its task and its stack, part by part."""
        task = [f"  {self._scenario}"] if self._scenario is not None else []
        return "\n".join([self._title, *task, str(self._stack)])


def _plain(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers and booleans as Python's own, arrays as they are."""
    return {
        key: _plain(value) if isinstance(value, Mapping) else value if value.ndim else value.item()
        for key, value in told.items()
    }
