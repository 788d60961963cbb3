"""Simulators of other projects as environments: each in its own Python, behind vlagents' wire.

The same agents, executions of chunks, seeds, films and figures as in the simulation here. An action and an observation
have the names and units of `envs.spaces`; the mapping from those of the simulator is explicit, and part of the setup.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.cameras import Cameras
from rcs.envs.env import Env
from rcs.envs.episode_random import SEED_LIMIT, check_seed
from rcs.envs.ports.port import Port
from rcs.envs.setup import Setup
from rcs.envs.spaces import FRAMES, GRIPPER, RGB, Arrays, Control, Observation
from rcs.envs.step.chain import Chain
from rcs.envs.step.clock import Clock, Outcome
from rcs.envs.step.stack import Stack
from rcs.errors import InvalidSetup, RcsError, SimulationError, UnknownName, WrongOrder
from rcs.policy.agent import TOKEN
from rcs.policy.interface import key_of, vlagents
from rcs.rollout.serving import ServerProcess

if TYPE_CHECKING:
    from vlagents.simulators.client import SimulatorClient
    from vlagents.simulators.interface import Moment, SimulatorMapping

ENVIRONMENTS = Path("build/interop")
"""Where `make sims` makes an environment for each simulator."""
STARTUP = 300.0
"""Longest duration until a simulator listens [s]."""


@dataclass(frozen=True, kw_only=True)
class ForeignSimulator:
    """A simulator of another project: by name, to be started in its own Python, or at the address of a server."""

    name: str
    """`simulator:task`, such as `libero:libero_spatial/0`; or the address of `vlagents simulate`, `vla://host:port`."""
    python: Path | None = None
    """Python of the simulator's environment; None for the one that `make sims` makes, and at an address."""
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    """Options of the simulator, such as `size` of images; none at an address."""
    mapping: Path | None = None
    """JSON file with a `SimulatorMapping`; None for the simulator's own."""
    timeout: float = 120.0
    """Longest duration of a reset or a step [s]; the episode then ends without a verdict."""
    log: Path | None = None
    """File to which everything is appended that the simulator prints; None for a new temporary one."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            InvalidSetup: The simulator runs already, so that nobody would read its options or its Python.
        """
        if self.is_address and (self.options or self.python is not None):
            raise InvalidSetup(
                f"The simulator at {self.name} runs already. Give its options to `vlagents simulate`, and leave out "
                "simulator_options and simulator_python."
            )

    @property
    def is_address(self) -> bool:
        """True if it runs already."""
        return "://" in self.name

    def start(self) -> ServerProcess:
        """Start the simulator's server.

        Raises:
            UnknownName: There is no such simulator.
            InvalidSetup: There is no such Python.
        """
        name = self.name.partition(":")[0]
        python = self.python or ENVIRONMENTS / name / "bin" / "python"
        if not python.is_file():
            known = vlagents("vlagents.simulators.served").BUILT_IN
            if self.python is None and name not in known:
                hint = "One of your own is module:Class:task, and needs its Python (simulator_python)."
                raise UnknownName("simulator", name, known, hint=hint)
            raise InvalidSetup(
                f"The simulator {self.name!r} needs its own Python, and there is no {python}. `make sims` makes it "
                "in a checkout; else name one that has vlagents and the simulator."
            )
        words = [str(python), "-m", "vlagents.cli", "simulate", self.name, "--port", "{port}"]
        words += [word for name, value in self.options.items() for word in (f"--{name.replace('_', '-')}", value)]
        log = self.log or Path(tempfile.mkdtemp(prefix="rcs-simulator-")) / "simulator.log"
        return ServerProcess(words, log)

    def read_mapping(self) -> SimulatorMapping | None:
        """Return the mapping of the file.

        Raises:
            InvalidSetup: The file has none.
        """
        if self.mapping is None:
            return None
        try:
            values = json.loads(self.mapping.read_text("utf-8"))
            return vlagents("vlagents.simulators.interface").SimulatorMapping.from_dict(values)
        except (OSError, ValueError, RecursionError) as err:
            raise InvalidSetup(f"{self.mapping} has no mapping of a simulator: {err}") from err


class Connection:
    """The simulator's process, if it is ours, and the connection to it. After a failure both are made anew."""

    def __init__(self, simulator: ForeignSimulator) -> None:
        """Start and connect.

        Raises:
            InvalidSetup: The mapping does not fit the simulator; the message has all differences.
            RcsError: It does not start or cannot be reached.
        """
        self._simulator, self._mapping = simulator, simulator.read_mapping()
        self._process: ServerProcess | None = None
        self._client: SimulatorClient | None = None
        client = self._open()
        try:
            self.facts, self.mapping, self.offer = client.facts, client.mapping, client.offer
        except BaseException:
            self.close(must_end=True)
            raise

    def begin(self, seed: int) -> Moment:
        """Begin an episode; a simulator that was lost before is started, or connected to, again.

        Raises:
            SimulationError: As `call`.
            RcsError: It does not start or cannot be reached again, is another one now, or was opened by another
                program.
        """
        if self._client is not None:
            try:
                return self.call(lambda client: client.begin(seed))
            except SimulationError as err:
                if not isinstance(err.__cause__, vlagents().ConnectionLost):
                    raise
        try:
            if self._open().facts != self.facts:
                self.close(must_end=True)
                raise RcsError("Another simulator, or another version, is there now.")
        except RcsError as err:
            raise RcsError(
                f"The simulator {self.facts.name} is gone, so this episode was not begun; start it, and run the same "
                f"again to go on. {err}"
            ) from err
        return self.call(lambda client: client.begin(seed))

    def call(self, act: Callable[[SimulatorClient], Moment]) -> Moment:
        """Return the answer to a call.

        Raises:
            SimulationError: The simulator failed in any way: it died, was late, raised an error, or sent nonsense.
            RcsError: Another program has opened it since, which says nothing about the episode.
        """
        assert self._client is not None, "an episode has begun"
        try:
            return act(self._client)
        except vlagents("vlagents.errors").SimulatorTaken as err:
            self.close(must_end=True)
            raise RcsError(
                f"Another program has opened the simulator {self.facts.name} at {self._simulator.name} since, and it "
                "serves one at a time, so this episode is left out. End the other, or start a simulator for each, and "
                "run the same again to go on."
            ) from err
        except (vlagents().VlagentsError, OSError) as err:
            self.close(must_end=True)
            raise SimulationError(f"{self.facts.name}: {type(err).__name__}: {err}") from err

    def close(self, *, must_end: bool = False) -> None:
        """End the connection, and the process if it is ours. A second call does nothing.

        Args:
            must_end: Whether the process is ended by force at once, because it may hang.
        """
        client, self._client = self._client, None
        process, self._process = self._process, None
        if client is not None:
            client.close()
        if process is not None:
            process.end(grace=0.0 if must_end else 10.0)

    def _open(self) -> SimulatorClient:
        simulator = self._simulator
        try:
            if simulator.is_address:
                self._client = self._connected(simulator.name)
            else:
                self._process = process = simulator.start()
                self._client = process.wait(lambda: self._connected(process.address), STARTUP)
        except BaseException:
            self.close(must_end=True)
            raise
        return self._client

    def _connected(self, address: str) -> SimulatorClient:
        """Return a client; the token is that of the environment variable `VLAGENTS_TOKEN`, as of a policy."""
        v, module = vlagents(), vlagents("vlagents.simulators.client")
        try:
            token, timeout = os.environ.get(TOKEN), self._simulator.timeout
            return module.SimulatorClient(address, self._mapping, token=token, timeout=timeout)
        except v.InvalidInput as err:
            raise InvalidSetup(str(err)) from err
        except (v.VlagentsError, OSError) as err:
            raise RcsError(f"{type(err).__name__}: {err}") from err


class ForeignPort(Port):
    """Actions and observations of a simulator of another project."""

    def __init__(self, connection: Connection) -> None:
        """Announce them as the mapping has them."""
        offer = connection.offer
        low, high = connection.mapping.bounds(connection.facts)
        self._names = [part.name for part in offer.action]
        ends = np.cumsum([part.size for part in offer.action])
        taken: dict[str, spaces.Box] = {}
        for part, end in zip(offer.action, ends, strict=True):
            columns, dtype = slice(end - part.size, end), np.float32 if key_of(part.name) == GRIPPER else np.float64
            taken[part.name] = spaces.Box(low[columns].astype(dtype), high[columns].astype(dtype), dtype=dtype)
        shown: dict[str, spaces.Space[Any]] = {
            part.name: spaces.Box(-np.inf, np.inf, (part.size,), np.float64) for part in offer.state
        }
        if offer.images:
            boxes = {one.name: spaces.Box(0, 255, (one.height, one.width, 3), np.uint8) for one in offer.images}
            shown[FRAMES] = spaces.Dict({name: spaces.Dict({RGB: box}) for name, box in boxes.items()})
        self.action_spaces, self.observation_spaces = taken, shown
        self.action: NDArray[np.float64] = np.zeros(int(ends[-1]))
        """The last action, its parts side by side."""
        self.moment: Moment | None = None
        """The simulator after the last reset or step."""

    def command(self, action: Arrays) -> None:
        """Keep the action for the clock."""
        self.action = np.concatenate([np.asarray(action[name], np.float64) for name in self._names])

    def observe(self) -> Observation:
        """Return what the simulator showed last."""
        assert self.moment is not None, "the environment is reset first"
        seen = self.moment.observation
        observed: Observation = {name: np.array(part) for name, part in seen.state.items()}
        if seen.images:
            observed[FRAMES] = {name: {RGB: seen.image(name)} for name in seen.images}
        return observed


class ForeignClock(Clock):
    """Lets a simulator of another project make its steps; its time stands still in between."""

    def __init__(self, connection: Connection, port: ForeignPort) -> None:
        """Keep the simulator's time."""
        self._connection, self._port = connection, port
        super().__init__(frequency=connection.facts.rate, now=self._time)
        self.is_real = False

    def advance(self, copies: Any = None, repeat: Callable[[], None] | None = None) -> None:
        """Make a step with the port's action."""
        self._port.moment = self._connection.call(lambda client: client.advance(self._port.action))

    def outcome(self) -> Outcome:
        """Return reward and verdict of the simulator."""
        moment = self._port.moment
        assert moment is not None, "a step was made"
        is_done = moment.is_over and bool(moment.success)
        return Outcome(moment.reward, is_done, moment.is_over and not is_done, {"success": moment.success})

    def _time(self) -> float:
        return 0.0 if self._port.moment is None else self._port.moment.observation.time


class ForeignEnv(Env):
    """A task of another project's simulator. Its reward and its verdict are the simulator's.

    A simulator that dies, is late or sends numbers that are not finite raises `SimulationError`; the next reset starts
    it, or connects, again, and raises `RcsError` if that fails.
    """

    def __init__(self, simulator: ForeignSimulator) -> None:
        """Start the simulator, or connect to it.

        Raises:
            MissingDependency: vlagents is not installed.
            InvalidSetup: The mapping does not fit the simulator; the message has all differences.
            RcsError: It does not start or cannot be reached.
        """
        self._connection, self._is_closed = Connection(simulator), False
        facts, mapping = self._connection.facts, self._connection.mapping
        try:
            self._port = ForeignPort(self._connection)
            super().__init__(
                Stack(Chain([self._port])),
                ForeignClock(self._connection, self._port),
                setup=_setup(self._connection, simulator),
                platform={facts.name.partition(":")[0]: "simulation"},
                instruction=mapping.instruction,
                max_episode_steps=mapping.steps,
                render_mode="rgb_array" if mapping.images else None,
                title=f"{facts.name} ({', '.join(f'{name} {version}' for name, version in facts.versions.items())})",
            )
        except BaseException:
            self._connection.close(must_end=True)
            raise

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]  as `Env.reset`
        self, seed: int | None = None, *, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed starts the same one.

        Args:
            seed: Seed of the episode; without one, that after the last seed.
            options: None; a simulator of another project has none.

        Raises:
            WrongOrder: The environment is closed.
            InvalidSetup: There are options, or the seed is out of range.
            SimulationError: The simulator failed.
            RcsError: It does not start or cannot be reached again, is another one now, or was opened by another
                program.
        """
        if options:
            raise InvalidSetup(f"The reset options are {options!r}; a simulator of another project has none.")
        if self._is_closed:
            raise WrongOrder("reset was called on a closed environment; make a new one.")
        chosen = (int(self.np_random_seed) + 1) % SEED_LIMIT if seed is None else check_seed(seed)
        self._port.moment = self._connection.begin(chosen)
        observation, info = super().reset(chosen)
        return observation, {**info, "success": self._port.moment.success}

    def render(self) -> Any:
        """Return the simulator's images side by side, (H, W, 3) uint8; None without any."""
        moment = self._port.moment
        if moment is None or not moment.observation.images:
            return None
        images = [moment.observation.image(name) for name in moment.observation.images]
        height = max(len(image) for image in images)
        return np.concatenate([np.pad(one, ((0, height - len(one)), (0, 0), (0, 0))) for one in images], axis=1)

    def close(self) -> None:
        """End the simulator, if it was started here. Closing twice is harmless."""
        self._is_closed = True
        super().close()
        self._connection.close()


def _setup(connection: Connection, simulator: ForeignSimulator) -> Setup:
    """Return everything that decides what happens, as a setup."""
    facts, mapping = connection.facts, connection.mapping
    arm = next((part for part in connection.offer.action if key_of(part.name) in get_args(Control)), None)
    control: Any = "joints" if arm is None else key_of(arm.name)
    return Setup(
        facts.name,
        task_options={
            "mapping": mapping.to_dict(),
            "versions": dict(facts.versions),
            "options": dict(simulator.options),
            "images": {image.name: [image.height, image.width] for image in connection.offer.images},
        },
        robot=facts.name.partition(":")[0],
        cameras=Cameras(names=tuple(image.name for image in mapping.images)),
        control=control,
        relative="last_step" if arm is not None and arm.meaning == "delta" else "absolute",
        frequency=facts.rate,
        max_episode_steps=mapping.steps,
    )
