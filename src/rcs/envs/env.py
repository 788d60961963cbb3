"""One environment: ports and layers, a clock and a task behind the interface of Gymnasium."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.envs.clock import Clock
from rcs.envs.draws import SEED_LIMIT, Draws, check_seed
from rcs.envs.group import StackGroup
from rcs.envs.observers import Observer, Transition
from rcs.envs.scenario import Scenario
from rcs.envs.setup import Setup
from rcs.envs.spaces import Observation
from rcs.envs.stack import Stack, copied, for_all
from rcs.envs.start import Start, check_start, check_state
from rcs.envs.turn import Turn
from rcs.errors import DeviceFault, Diverged, InvalidAction, InvalidSetup, UnknownName, WrongOrder
from rcs.sim.picture import Picture
from rcs.sim.scene import RobotPlacement

END_NAMES = {end.value: end.name for end in (getattr(StepEnd, name) for name in StepEnd.__members__)}
"""What `info["end"]` says, unless a device has failed: then it is `FAULT`."""

FAULT = "fault"


class Env(gymnasium.Env[Observation, dict[str, Any]]):
    """A robot, simulated or real, as a Gymnasium environment.

    Made by `rcs.make`, or from parts by hand. `print(env)` shows the parts.

    Whatever goes wrong from the first command on, all devices hold: an error in a layer, a task or an observer, and
    Ctrl-C. One thread at a time may use an environment; `hold` may be called from any.
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
        setup: Setup | None = None,
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
            setup: What it was made from; None where it was put together by hand.
        """
        self._stack = stack
        self._setup = setup
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
        self._broken_off_by = ""
        self._must_rebase = False
        self._last_observation: Observation = {}
        self._turn = Turn()
        self._is_commanded = False
        self.action_space = stack.action_space
        self.observation_space = stack.observation_space
        self.render_mode = None if picture is None else "rgb_array"

    @property
    def setup(self) -> Setup:
        """The setup that the environment was made from.

        Raises:
            WrongOrder: It was put together by hand, without a setup.
        """
        if self._setup is None:
            raise WrongOrder("This environment was put together by hand, without a setup.")
        return self._setup

    @property
    def robots(self) -> Mapping[str, RobotPlacement]:
        """The robots by name: arm, end effector, and where they stand."""
        return {robot.placement.name: robot.placement for robot in self.scenario.robots}

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

    @property
    def is_simulated(self) -> bool:
        """Whether there is a simulated world, `scenario.world`."""
        return self._scenario is not None

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
            WrongOrder: The environment is closed, or another thread uses it.
            InvalidSetup: A seed out of range, an unknown option, or a start that makes no sense.
            DeviceFault: A device is in its fault state; `recover` clears it.
        """
        with self._turn.take("reset"):
            if not self._is_open:
                raise WrongOrder("reset was called on a closed environment; make a new one.")
            state, start = self._check_options(options)
            seed = None if seed is None else check_seed(seed)
            try:
                return self._begin(seed, state, start)
            except BaseException as err:
                self._break_off(err)
                raise

    def _begin(
        self, seed: int | None, state: NDArray[np.float64] | None, start: Start | None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with options that were checked."""
        super().reset(seed=seed)
        if seed is not None or self._episode < 0:
            # Gymnasium's own seeds have 128 bits.
            self._seed = self.np_random_seed % SEED_LIMIT if seed is None else seed
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
        self._open_ports()
        if faults := self._stack.faults():
            raise DeviceFault(f"Devices are in their fault state: {_listed(faults)}. Clear it with env.recover().")
        self._clock.reset()
        measured = self._stack.measure()
        self._stack.reset(measured, ...)
        observation = self._stack.lift(measured)
        self._last_observation = observation
        self._must_rebase = False
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

        A device that enters its fault state ends the episode: all devices hold, it is truncated, `info["end"]` is
        `fault`, and `info["faults"]` has the reasons by device. Where a device can no longer be measured, the
        observation is the one of the step before. Otherwise, `info["target"]` has what the action came to, as absolute
        targets.

        Args:
            action: One array per key of `action_space`.

        Raises:
            InvalidAction: The action is not valid; no device saw it. Only when a device itself refuses it may others
                have seen it; then all hold, and the episode goes on.
            WrongOrder: The environment was not reset, its episode is over, it is closed, or another thread uses it.
            Diverged: The simulation left the range of finite numbers, in MuJoCo's words; reset starts anew.
            SimulationError: MuJoCo has given a step up, in its words, such as for want of memory for contacts.
        """
        with self._turn.take("step"):
            if not self._is_running:
                raise WrongOrder(self._explain_order())
            self._is_commanded = False
            try:
                return self._advance(action)
            except BaseException as err:
                if isinstance(err, InvalidAction) and not self._is_commanded:
                    raise  # nothing was sent, nothing is remembered
                # Nothing goes on moving unwatched, also when a second Ctrl-C comes while the devices are told to hold.
                try:
                    self._break_off(err)
                except KeyboardInterrupt:
                    self._break_off(err)
                    raise
                raise

    def _advance(self, action: Mapping[str, Any]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make a step; who calls it looks after what it raises."""
        measured: Observation | None = None
        try:
            if self._must_rebase:
                self._must_rebase = False  # before, for another thread may set it meanwhile
                self._stack.rebase()
            mapped = self._stack.map(action)
            self._is_commanded = True
            self._stack.send(mapped)
            if self._must_rebase:
                self._stack.hold()  # another thread has said so before the targets were sent
            self._clock.advance()
            measured = self._stack.measure()
            faults = self._stack.faults()
        except DeviceFault as err:
            faults = self._stack.faults() or {"device": str(err)}
        if faults:
            self._hold_in_fault(faults)
            if measured is None:
                return self._end_without_row(faults)
        assert measured is not None, "without a fault, everything was measured"
        end = int(self._clock.ends[0])
        if end == StepEnd.failed.value:
            why = self._scenario.world.why_diverged() if self._scenario is not None else ""
            raise Diverged(f"The simulation diverged: {why or 'a step failed.'} Call reset to start anew.")
        observation = self._stack.lift(measured)
        self._last_observation = observation
        self._steps += 1
        info: dict[str, Any] = {"end": END_NAMES[end]}
        reward, terminated = 0.0, False
        if self._scenario is not None:
            outcome = self._scenario.evaluate()
            reward, terminated = float(outcome.reward), bool(outcome.terminated)
            info.update(_plain(outcome.info))
        info.update(_plain(self._stack.info()))
        info["target"] = copied(self._stack.target)
        truncated = self._max_episode_steps is not None and self._steps >= self._max_episode_steps and not terminated
        if faults:
            info.update(end=FAULT, faults=faults)
            terminated, truncated = False, True
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
            for observer in self._observers:
                observer.on_step(transition)
            if faults:
                self._tell_end(FAULT, faults)
        return observation, reward, terminated, truncated, info

    def _hold_in_fault(self, faults: dict[str, str]) -> None:
        """Have all devices hold; one that refuses in its fault state is told in `faults`."""
        self._must_rebase = True
        try:
            self._stack.hold()
        except Exception as err:  # noqa: BLE001  the device that failed may refuse everything; the reason is passed on
            faults["hold"] = f"{type(err).__name__}: {err}"

    def _end_without_row(self, faults: dict[str, str]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """End the episode in a step that not all devices took part in: observers are told its end, but see no step."""
        self._is_running = False
        self._tell_end(FAULT, faults)
        try:
            observation = self._stack.lift(self._stack.measure())
        except DeviceFault:
            observation = copied(self._last_observation)
        return observation, 0.0, False, True, {"end": FAULT, "faults": faults}

    def _break_off(self, error: BaseException) -> None:
        """Have all devices hold after an error, end the episode, and tell the observers."""
        self._must_rebase = True
        calls: list[Callable[[], None]] = [self._stack.hold]
        # A device that refuses an action is no reason to end the episode: the next one may be better.
        if not isinstance(error, InvalidAction) and self._is_running:
            calls.append(lambda: self._tell_end("exception", {type(error).__name__: str(error)}))
            self._is_running = False
            self._broken_off_by = type(error).__name__
        try:
            for_all(calls)
        except Exception as err:  # noqa: BLE001  the first error is the one to be raised
            error.add_note(f"While the devices were told to hold: {type(err).__name__}: {err}")

    def _tell_end(self, end: str, reasons: Mapping[str, str]) -> None:
        for_all([lambda observer=observer: observer.on_end(end, reasons) for observer in self._observers])

    def _open_ports(self) -> None:
        """Open all ports; where one fails, no device stays open."""
        try:
            for port in self._stack.ports:
                port.open()
        except BaseException as err:
            try:
                self._stack.close()
            except Exception as also:  # noqa: BLE001  why a device could not be opened is the error to be raised
                err.add_note(f"While the other devices were closed: {type(also).__name__}: {also}")
            raise

    def render(self) -> Any:
        """Return a picture of the scene, (H, W, 3) uint8; None when made without `render_mode`."""
        if self._picture is None:
            return None
        return self._picture.draw()

    def hold(self) -> None:
        """Make every device stay where it is, also when one of them fails to. May be called from any thread.

        The next action counts from where the devices are then, as after `rebase`.
        """
        self._must_rebase = True
        self._stack.hold()

    def rebase(self, robot: str | None = None) -> None:
        """Make what follows count from the measured state: after devices were moved by somebody else, or taken over.

        A relative action that says "stay" then stays, and the bounds of a step count from here. An origin of relative
        actions moves here too.

        Args:
            robot: Name of the robot, where there are several; None for all.

        Raises:
            WrongOrder: The environment was not reset, is closed, or another thread uses it.
            UnknownName: There is no robot of this name.
        """
        with self._turn.take("rebase"):
            if not self._is_open or self._episode < 0:
                raise WrongOrder("rebase was called before the first reset, or on a closed environment.")
            if robot is None:
                self._stack.rebase()
            elif isinstance(self._stack, StackGroup):
                self._stack.rebase(robot)
            else:
                raise UnknownName("robot", robot, (), hint="This environment has one robot; call rebase().")

    def recover(self) -> None:
        """Clear the faults of all devices; nothing moves. Then call `reset`.

        Raises:
            WrongOrder: The environment is closed, or another thread uses it.
            DeviceFault: A device cannot recover.
        """
        with self._turn.take("recover"):
            if not self._is_open:
                raise WrongOrder("recover was called on a closed environment; make a new one.")
            self._must_rebase = True
            self._stack.recover()

    def close(self) -> None:
        """Let go of all devices, then of observers and pictures, whatever fails. Closing twice is harmless.

        Called while another thread makes a step, it has all devices hold at once, and closes them after the step.

        Raises:
            BaseException: The first failure, with a note of the others; everything else is closed.
        """
        if not self._is_open:
            return
        self._is_open = self._is_running = False
        calls: list[Callable[[], None]] = []
        if self._turn.is_of_another_thread:
            calls = [self._stack.hold, self._turn.wait]
        calls += [self._stack.close, *(observer.close for observer in self._observers)]
        if self._picture is not None:
            calls.append(self._picture.close)
        if self._scenario is not None:
            calls.append(self._scenario.world.close)
        for_all(calls)

    def _explain_order(self) -> str:
        if not self._is_open:
            return "step was called on a closed environment; make a new one."
        if self._episode < 0:
            return "step was called before the first reset; call reset."
        if self._broken_off_by:
            return f"step was called after {self._broken_off_by} broke the episode off; call reset."
        return "step was called after the end of the episode; call reset."

    def _check_options(self, options: Mapping[str, Any] | None) -> tuple[NDArray[np.float64] | None, Start | None]:
        if options is not None and not isinstance(options, Mapping):
            raise InvalidSetup(f"The reset options are {options!r}; valid is a dictionary, or None.")
        given = dict(options or {})
        state, robot, objects = (given.pop(name, None) for name in ("state", "robot", "objects"))
        if given:
            raise InvalidSetup(f"Unknown reset options {sorted(given)}; valid: 'state', 'robot', 'objects'.")
        if robot is not None or objects is not None:
            if state is not None:
                raise InvalidSetup("The reset option 'state' cannot be combined with 'robot' or 'objects'.")
            return None, check_start(self.scenario.robots, self.scenario.task.object_poses(), robot, objects)
        if state is None:
            return None, None
        return check_state(state, self.scenario.world.core.state_size), None

    def __str__(self) -> str:
        """Return the environment, its task and its stack, part by part."""
        task = [f"  {self._scenario}"] if self._scenario is not None else []
        return "\n".join([self._title, *task, str(self._stack)])


def _listed(faults: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in faults.items())


def _plain(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers and booleans as Python's own, arrays as they are."""
    return {
        # `dict` and not `Mapping`: an abstract class takes ten times as long to ask for.
        key: _plain(value) if isinstance(value, dict) else value if value.ndim else value.item()
        for key, value in told.items()
    }
