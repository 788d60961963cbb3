"""One environment behind the interface of Gymnasium, simulated or real."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import SEED_LIMIT, check_seed
from rcs.envs.limits import Limits, limits_of
from rcs.envs.observer import Observer
from rcs.envs.setup import Setup
from rcs.envs.spaces import JOINTS, Observation
from rcs.envs.start import Start, check_start, check_state
from rcs.envs.step.approach import Approach
from rcs.envs.step.clock import Clock
from rcs.envs.step.engine import Approaches, Engine
from rcs.envs.step.simulation import Simulation
from rcs.envs.step.stack import Stack
from rcs.envs.step.state import EnvState, read_state, write_state
from rcs.errors import InvalidSetup, WrongOrder, require_fields
from rcs.sim.scene import RobotPlacement
from rcs.sim.viewer import Picture

_ONLY = np.zeros(1, np.int32)
"""The copies of a single environment."""


PLACES = {
    "task": "env.simulation.task",
    "scenario": "env.simulation",
    **dict.fromkeys(("world", "sim"), "env.simulation.world"),
    "model": "env.simulation.world.model",
    "data": "env.simulation.world.data, or env.get_state()",
    "robot": "env.setup.robot, or env.stack for its ports and layers",
    "robots": "env.setup.robot, or env.stack for their ports and layers",
    "seed": "env.reset(seed=...)",
    **dict.fromkeys(("observation", "get_obs"), "what env.reset and env.step return"),
    "expert": "rcs.agents.agent_for(env)",
    "num_envs": "rcs.make_vec(task, copies=...)",
}
"""Names that other libraries have on an environment, and where their contents are."""


class Env(gymnasium.Env[Observation, dict[str, Any]]):
    """A robot, simulated or real, as a Gymnasium environment.

    `rcs.make` makes it, or a program puts it together from parts. `print(env)` shows the parts.

    From the first command on, an error in a layer, a task or an observer makes all devices hold, and so does Ctrl-C.
    One thread at a time may use an environment; `hold` may be called from any.
    """

    def __init__(
        self,
        stack: Stack,
        clock: Clock,
        simulation: Simulation | None = None,
        *,
        setup: Setup | None = None,
        robots: Sequence[RobotPlacement] = (),
        platform: Mapping[str, str] | None = None,
        site: str | None = None,
        instruction: str | None = None,
        max_episode_steps: int | None = None,
        observers: Sequence[Observer] = (),
        picture: Picture | None = None,
        render_mode: str | None = None,
        title: str = "rcs.Env",
    ) -> None:
        """Put an environment together; nothing moves and nothing is connected before `reset`.

        Args:
            stack: Ports, layers and gates.
            clock: Lets time pass.
            simulation: A simulated world with its task; None for real devices alone.
            setup: The setup; None for an environment that is put together by hand.
            robots: Its robots, simulated or real; None for those of the simulation.
            platform: Origin of every robot, `robot/end effector` and camera: `simulation`, or the name of a driver.
            site: Hash of a site's entries for the real ones; None without a site.
            instruction: Instruction for the robot; None for that of the task.
            max_episode_steps: An episode is truncated after this many steps; None for no limit.
            observers: Observers of every step.
            picture: Draws what `render` returns; None for an environment that has none.
            render_mode: `rgb_array`, `human`, or None.
            title: First line of the printed environment.
        """
        self._engine = Engine(stack, clock, simulation, max_episode_steps=max_episode_steps)
        for observer in observers:
            self._engine.observers.add(observer)
        if picture is not None:
            self._engine.close_too(picture.close)
        if instruction is not None:
            self._engine.instruction = instruction
        self.stack = stack
        """Ports, layers and gates."""
        self.frequency = clock.frequency
        """Control steps per second [Hz]."""
        self.is_real = clock.is_real
        """Whether steps take real time: on hardware, and in a simulation that keeps the rate of the wall clock."""
        self.is_simulated = simulation is not None
        """Whether there is a simulated world, `simulation.world`."""
        self.has_setup = setup is not None
        """Whether the environment knows the setup that it was made from."""
        self.clock = clock
        """Lets time pass."""
        self._setup = setup
        placements = robots or ([] if simulation is None else [robot.placement for robot in simulation.robots])
        self.robots: dict[str, RobotPlacement] = {robot.name: robot for robot in placements}
        """Descriptions of the robots and where they stand, by name."""
        self.platform = dict(platform or dict.fromkeys(self.robots, "simulation" if simulation else "hardware"))
        """Origin of every robot, end effector and camera: `simulation`, or the name of a driver."""
        self.site = site
        """Hash of a site's entries for the real ones: drivers, addresses, options and times; None without a site."""
        self._picture = picture
        self._title = title
        self._pictures: list[NDArray[np.uint8]] = []
        self.action_space = stack.action_space
        self.observation_space = stack.observation_space
        self.render_mode = render_mode or (None if picture is None else "rgb_array")
        self.metadata = {
            "render_modes": ["human", "rgb_array", "rgb_array_list"],
            "render_fps": max(1, round(clock.frequency)),
        }

    if not TYPE_CHECKING:  # type checkers refuse what is not there

        def __getattr__(self, name: str) -> Any:
            """Name the place of contents that users look for here.

            Raises:
                AttributeError: Always.
            """
            hint = f" Use {PLACES[name]}." if name in PLACES else ""
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}.{hint}")

    @property
    def setup(self) -> Setup:
        """The setup that the environment was made from.

        Raises:
            WrongOrder: It was put together by hand.
        """
        if self._setup is None:
            raise WrongOrder("This environment was put together by hand, without a setup; give Env(setup=...).")
        return self._setup

    @property
    def instruction(self) -> str:
        """The instruction for the robot; `info["instruction"]` of `reset`."""
        return self._engine.instruction

    @property
    def simulation(self) -> Simulation:
        """The simulated world and its task.

        Raises:
            WrongOrder: This environment is not simulated.
        """
        if self._engine.simulation is None:
            raise WrongOrder("This environment drives real devices; it has no simulated world.")
        return self._engine.simulation

    def add_observer(self, observer: Observer) -> None:
        """Add an observer, which sees every step from the next reset on."""
        self._engine.observers.add(observer)

    def remove_observer(self, observer: Observer) -> None:
        """Remove an observer; it sees no more steps."""
        self._engine.observers.remove(observer)

    def note(self, **notes: Any) -> None:
        """Give observers values beside the next step, such as the actor or the time that a policy took."""
        self._engine.observers.note(notes)

    def limits(self) -> Limits:
        """Return the present bounds of every robot's motion: joints, speeds, the step of an action. Nothing moves."""
        return limits_of(self.robots, self.stack, self.frequency)

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]  # takes the seed by position, too
        self, seed: int | None = None, *, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode. On hardware, the first reset connects the devices, and only the option `robot` moves them.

        Args:
            seed: The same seed gives the same episode, and the same episodes after it. None takes the next episode of
                the last seed.
            options: `state` starts the episode in a simulation state of `env.simulation.world.states()`. `robot` starts
                it with `joints`, and `gripper` or `hand`, as an observation has them (several robots: under their
                names), and `objects` with simulated objects at poses (7,) in the base frame (several robots: in the
                scene), as `env.simulation.object_poses()` has them.
                Real arms go to the joints of `robot` on a straight line, at the share `speed` of their largest speeds,
                0.05 by default, when `may_move` is True, or a function that is given a question and returns True.

        Raises:
            WrongOrder: The environment is closed, or another thread uses it.
            InvalidSetup: A seed out of range, an unknown option, a start that makes no sense, or real arms are to move
                and `may_move` is missing.
            Refused: Nobody agreed that real arms move, or a gate has stopped them on the way.
            DeviceFault: A device is in its fault state, which `recover` clears, or a real arm has not arrived.
        """
        with self._engine.calls.enter("reset"):
            if not self._engine.is_open:
                raise WrongOrder("reset was called on a closed environment; make a new one.")
            state, start, approach = self._check_options(options)
            seed = None if seed is None else check_seed(seed)
            super().reset(seed=seed)
            if seed is not None or self._engine.episodes < 0:
                # Gymnasium's own seeds have 128 bits.
                self._engine.seeds[...] = self.np_random_seed % SEED_LIMIT if seed is None else seed
                self._engine.episodes[...] = -1
            observation, info = self._engine.start(state=state, start=start, approach=approach)
            self._look()
            return observation, info

    def step(self, action: Mapping[str, Any]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Command all devices, let one control step pass, observe.

        `info["end"]` is the reason for the end of the step: `period`, `converged`, `interrupted` or `limit`. A device
        that enters its fault state ends the episode: all devices hold, it is truncated, `info["end"]` is `fault`, and
        `info["faults"]` has the reasons by device; where a device can no longer be measured, the observation is that of
        the step before. A simulation that leaves the range of finite numbers ends the episode as `diverged`, with the
        last good observation, its time and the task's keys. `info["target"]` has the absolute targets of the action,
        and `info["refused"]` the reason of a gate that let nothing through.
        `info["time"]` is the time of the observation [s], and in real time `info["late"]` how late the step ended [s]
        and `info["ages"]` how old each sensor's reading is [s]. `info["clamped"]` counts, by arm and by limit, the
        commands since `open` that were beyond a streamed arm's limits, which it keeps.

        Args:
            action: One array per key of `action_space`.

        Raises:
            InvalidAction: The action is not valid; no device saw it. If a device itself refuses it, others may have
                seen it; then all hold, and the episode goes on.
            WrongOrder: The environment was not reset, its episode is over, it is closed, or another thread uses it.
            SimulationError: MuJoCo has given a step up, such as for want of memory for contacts.
        """
        engine = self._engine
        with engine.calls.enter("step"):
            engine.require_running()
            if engine.is_over:
                raise WrongOrder("step was called after the end of the episode; call reset.")
            step = engine.step(action)
            if self.render_mode is not None:
                self._look()
            return step.observation, float(step.reward), bool(step.terminated), bool(step.truncated), step.info

    def _look(self) -> None:
        """Draw, if the render mode needs it at every step."""
        if self._picture is None:
            return
        if self.render_mode == "human":
            self._picture.show()
        elif self.render_mode == "rgb_array_list":
            self._pictures.append(self._picture.draw())

    def render(self) -> Any:
        """Return a picture of the scene, (H, W, 3) uint8, a list of all since the last call, or None, by mode."""
        if self._picture is None or self.render_mode == "human":
            return None
        if self.render_mode == "rgb_array_list":
            pictures, self._pictures = self._pictures, []
            return pictures
        return self._picture.draw()

    def get_state(self) -> EnvState:
        """Return everything that decides what follows, to go back to it with `set_state`; it survives pickling.

        It is the state of the simulation, of layers and task, of cameras, counters and random numbers. Observers,
        agents and callbacks in Python keep their memory. Real devices have no such state.

        Raises:
            WrongOrder: The environment drives real devices, was not reset, is closed, or another thread uses it.
        """
        with self._engine.calls.enter("get_state"):
            return read_state(self._engine, _ONLY)

    def set_state(self, state: EnvState) -> Observation:
        """Go on from a state, also one of a copy of a batch; the same actions lead to the same bits.

        An episode that is being recorded ends here, without a verdict.

        Args:
            state: State from `get_state` of this environment, or of another one that is made from the same parts.

        Returns:
            The observation in that state.

        Raises:
            InvalidSetup: The state is that of another environment, or of several copies.
            WrongOrder: The environment drives real devices, was not reset, is closed, or another thread uses it.
        """
        with self._engine.calls.enter("set_state"):
            return write_state(self._engine, state, _ONLY)

    def hold(self) -> None:
        """Make every device stay where it is, even if one of them fails to. Any thread may call it.

        The next action counts from where the devices are then, as after `rebase`.
        """
        self._engine.hold()

    def rebase(self, robot: str | None = None) -> None:
        """Count from the measured state from now on, after a person or another program has moved the devices.

        A relative action that says "stay" then stays, and the bounds of a step count from here. An origin of relative
        actions moves here too.

        Args:
            robot: Name of the robot, where there are several; None for all.

        Raises:
            WrongOrder: The environment was not reset, is closed, or another thread uses it.
            UnknownName: There is no robot of this name.
        """
        with self._engine.calls.enter("rebase"):
            self._engine.rebase(robot)

    def recover(self) -> None:
        """Clear the faults of all devices; nothing moves. Then call `reset`.

        Raises:
            WrongOrder: The environment is closed, or another thread uses it.
            DeviceFault: A device cannot recover.
        """
        with self._engine.calls.enter("recover"):
            self._engine.recover()

    def close(self) -> None:
        """Let go of all devices, then of observers and pictures, whatever fails. Closing twice is harmless.

        During a step of another thread, it makes all devices hold at once, and closes them after the step. With
        `at_end="park"` in the setup, real arms go home before, unless something has gone wrong.

        Raises:
            BaseException: The first failure, with a note of the others; everything else is closed.
        """
        placements = list(self.robots.values())
        homes = {
            one.name: {JOINTS: np.array(one.arm.home)}
            for one in placements
            if self.platform.get(one.name) != "simulation"
        }
        if not homes or not self.has_setup or self.setup.at_end == "hold":
            return self._engine.close()
        return self._engine.close(Approach(placements=placements, robots=homes, may_move=True).go)

    def _check_options(
        self, options: Mapping[str, Any] | None
    ) -> tuple[NDArray[np.float64] | None, Start | None, Approaches | None]:
        if options is not None and not isinstance(options, Mapping):
            raise InvalidSetup(f"The reset options are {options!r}; valid is a dictionary, or None.")
        given = dict(options or {})
        state, robot, objects = (given.pop(name, None) for name in ("state", "robot", "objects"))
        manner = {name: given.pop(name) for name in ("may_move", "speed") if name in given}
        require_fields("reset option", given, ("state", "robot", "objects", "may_move", "speed"))
        if robot is None and objects is None:
            return (None if state is None else check_state(state, self.simulation.world.core.state_size)), None, None
        if state is not None:
            raise InvalidSetup("The reset option 'state' cannot be combined with 'robot' or 'objects'.")
        placements = list(self.robots.values())
        start = check_start(
            placements, self.simulation.task.object_poses() if self.is_simulated else {}, robot, objects
        )
        real = {name: own for name, own in start.robots.items() if self.platform.get(name) != "simulation"}
        if not real:
            return None, start, None
        others = {name: own for name, own in start.robots.items() if name not in real}
        approach = Approach(placements=placements, robots=real, **manner)
        return None, replace(start, robots=others) if self.is_simulated else None, approach.go

    def __str__(self) -> str:
        """Return the environment, its task and its stack, part by part."""
        task = [f"  {self.simulation}"] if self.is_simulated else []
        return "\n".join([self._title, *task, str(self.stack)])
