"""An agent that executes the chunks of a policy, which may run elsewhere, and a factory of such agents."""

from __future__ import annotations

import itertools
import json
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs.agents import Agent, Event
from rcs.agents.identity import Identity
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation
from rcs.errors import InvalidSetup, RcsError, WrongOrder
from rcs.policy.actions import PolicyActions
from rcs.policy.execution import Execution, Executor
from rcs.policy.interface import policy_observation, require_fit, vlagents
from rcs.policy.plan import ChunkPlan

if TYPE_CHECKING:
    from vlagents import Metadata, Policy

NOTES = ("policy_latency", "policy_age", "policy_chunk", "policy_row", "policy_is_held", "policy_is_clipped")
"""Notes that are recorded with every step: how late the newest answer was [s], which in simulation is
`Execution.latency`; how old the observation is that it answers [s]; the number of the chunk in the episode and of its
row; whether the robot was held; and whether the policy wanted more than the environment takes."""

WAIT = 5.0
"""Longest wait for an unreachable policy at the beginning of an episode [s], by the clock."""
STUCK = 60.0
"""Longest wait, at the beginning of an episode, for a call of the last one that is under way [s]; a network that is
compiled takes tens of seconds for its first."""
PAUSE = 0.2
"""Pause between two attempts to reach it [s]."""

_numbers = itertools.count()


class ChunkAgent(Agent):
    """Shows a policy what the environment observes, and executes its chunks by time.

    In simulation, time is the simulation's, and stands still while the policy computes: the same seed gives the same
    bytes. Where steps take real time, a thread calls the policy, and time is the host's monotonic clock. When there is
    nothing to execute, because the policy is late, silent, gone, or sends what is no chunk, the robot holds.
    """

    def __init__(
        self, env: Env, policy: Policy, *, execution: Execution | None = None, instruction: str | None = None
    ) -> None:
        """Prepare to act in an environment; the policy is not called yet.

        Args:
            env: The environment.
            policy: A policy of vlagents: a client, or one in this process.
            execution: How its chunks are executed; None for the usual way.
            instruction: The instruction for the policy; None for the environment's.

        Raises:
            InvalidSetup: Policy and environment do not fit; the message has all differences.
        """
        self._env, self._policy = env, policy
        self._v = vlagents()
        self.metadata: Metadata = policy.metadata()
        """The metadata of the policy."""
        require_fit(env, self.metadata, instruction)
        execution = execution or Execution()
        if env.is_real and execution.latency:
            raise InvalidSetup(f"latency is {execution.latency} s; it is for simulated time, remove it in real time.")
        self.execution = execution
        """The execution of its chunks."""
        self._period = 1.0 / env.frequency
        self._given_instruction = instruction
        self._session = f"{env.setup.robot_label} {next(_numbers)}"
        self._actions = PolicyActions(env, self.metadata)
        self._executor = Executor(execution, self._period, f"policy {self._session}" if env.is_real else None)
        self._instruction = ""
        self._turn = threading.Lock()  # a policy in this process takes one call at a time
        self._episode = 0
        self._needs_reset = self._has_ended = self._is_lost = False
        self._message: str | None = None
        self._now = self._begun = 0.0
        self._latencies: list[float] = []

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode; a policy that fails does so in this episode, and the robot holds.

        A call of the last episode that is under way ends first; one that waits is not made any more.

        Raises:
            RcsError: The policy cannot be reached, for `WAIT` seconds, or does not return, for `STUCK` seconds.
            InvalidSetup: Another policy is at the address.
        """
        self._episode += 1
        self._executor.reset()
        self._actions.reset(observation, info)
        self._has_ended, self._is_lost, self._message = False, False, None
        self._latencies = []
        given = self._given_instruction
        self._instruction = str(info.get("instruction", "")) if given is None else given
        self._begun = float(info.get("time", 0.0))
        self._now = self._time(info)
        self._needs_reset = True
        self._await_last_call()
        try:
            self._reach()
        except InvalidSetup:
            raise
        except Exception as err:  # whatever it is, the robot holds and the log says why
            if self._is_gone(err):
                raise RcsError(f"{type(err).__name__}: {err} So this episode was not begun.") from err
            self._executor.fail(err, self._now)
            self._lose(err)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the action for this moment, or that of holding."""
        self._now = now = self._time(info)
        had_error = self._executor.error is not None
        command = self._executor.step(now, lambda: self._question(observation, info))
        if self._executor.chunks > len(self._latencies):
            self._latencies.append(self._executor.seconds)
        if self._executor.error is not None and not had_error:
            self._lose(self._executor.error)
        return self._actions.hold(observation) if command is None else self._actions.action(command)

    def lead_only(self, robot: str) -> None:
        """Act for one robot of several: when there is nothing to execute, the others go on."""
        self._actions.robot = robot

    @property
    def note_fields(self) -> Sequence[Note]:
        """The numbers of `NOTES`."""
        return [Note(name) for name in NOTES]

    def notes(self) -> Mapping[str, Any]:
        """Return latency, age, place in the chunk, and whether the robot is held; see `NOTES`."""
        executor = self._executor
        values = (
            executor.latency,
            executor.age(self._now),
            float(executor.chunks - 1) if executor.chunks else np.nan,
            executor.row(self._now),
            float(self._actions.is_held),
            float(self._actions.is_clipped),
        )
        return dict(zip(NOTES, values, strict=True))

    def events(self) -> Sequence[Event]:
        """Return `stop` once the policy is lost and `on_loss` is `end`."""
        return ("stop",) if self._has_ended else ()

    @property
    def is_lost(self) -> bool:
        """True if the server was gone or silent, before the policy itself failed in this episode."""
        return self._is_lost

    @property
    def weights(self) -> str | None:
        """The hash that the server reports."""
        return self.metadata.checkpoint_hash or None

    @property
    def latencies(self) -> Sequence[float]:
        """How long each answer took by the clock [s]; of several in one step, only the last one is kept."""
        return self._latencies

    @property
    def failure(self) -> str | None:
        """`policy` if the policy or its connection failed in this episode."""
        return None if self._message is None else "policy"

    @property
    def failure_message(self) -> str | None:
        """The first error of the policy or its connection in this episode."""
        return self._message

    def close(self) -> None:
        """End the thread and close the policy."""
        self._executor.close()
        self._policy.close()

    def _time(self, info: Mapping[str, Any]) -> float:
        """Return when the present step begins [s]: in simulated time, or by the monotonic clock.

        Simulated steps of 1/30 s are 16, 17 and 17 physics steps long; they count as 1/30 s each.
        """
        if self._env.is_real:
            return time.perf_counter()
        simulated = float(info["time"])
        if self._env.setup.stepping == "sync":
            return simulated
        return self._begun + round((simulated - self._begun) / self._period) * self._period

    def _begin(self) -> None:
        """Begin an episode of the policy; a client whose server was gone connects anew."""
        seed = int(self._env.np_random_seed) % 2**32
        self._policy.reset(self._session, self._instruction, seed=seed)
        if self._policy.metadata() != self.metadata:
            self._has_ended = True
            raise InvalidSetup("Another policy is at the address now; make the agent anew.")
        self._needs_reset = False

    def _await_last_call(self) -> None:
        if not self._turn.acquire(timeout=STUCK):
            raise RcsError(
                f"The policy {self.metadata.name!r} has not returned from a call of the last episode for {STUCK:g} s, "
                "so this episode was not begun. End the program and mend the policy, or serve it in a process of its "
                "own (`vlagents serve`), where a call has a `timeout`."
            )
        self._turn.release()

    def _reach(self) -> None:
        """Begin, and wait for a policy that cannot be reached: its server may be starting again."""
        until = time.monotonic() + WAIT
        while True:
            try:
                with self._turn:
                    return self._begin()
            except Exception as err:
                if not self._is_gone(err) or time.monotonic() + PAUSE > until:
                    raise
            time.sleep(PAUSE)

    def _is_gone(self, error: Exception) -> bool:
        """Return whether the policy cannot be reached, rather than one that fails."""
        own = (self._v.PolicyFailed, self._v.InvalidInput)
        return isinstance(error, (self._v.VlagentsError, OSError)) and not isinstance(error, own)

    def _lose(self, error: Exception) -> None:
        self._needs_reset = True
        if self._message is None:
            self._is_lost = self._is_gone(error)
        self._message = self._message or f"{type(error).__name__}: {error}"
        self._has_ended |= self.execution.on_loss == "end"

    def _question(self, observation: Observation, info: Mapping[str, Any]) -> Callable[[], ChunkPlan]:
        """Return the call of the policy for the present observation; see `Question`."""
        seen = policy_observation(
            observation, self.metadata, time=self._now, instruction=self._instruction, session=self._session
        )
        start, episode = self._actions.start(observation, info), self._episode

        def compute() -> ChunkPlan:
            with self._turn:
                if episode != self._episode:
                    raise WrongOrder("The episode of this question is over.")
                if self._needs_reset:
                    self._begin()
                self._needs_reset = True  # until it answers: only the first of several failures is seen by `_lose`
                chunk = self._policy.infer(seen)
                self._needs_reset = episode != self._episode  # a reset may have come meanwhile
            if chunk.actions.shape[1] != self.metadata.size:
                raise self._v.BadMessage(
                    f"The policy sent actions of {chunk.actions.shape[1]} numbers; it announced {self.metadata.size}."
                )
            # Without a rate, a row is a step of this loop.
            period = chunk.period if self.metadata.rate > 0 else self._period
            return ChunkPlan(self._actions.parts, chunk.actions, time=seen.time, period=period, start=start)

        return compute


TOKEN = "VLAGENTS_TOKEN"
"""Environment variable with the token of the server."""


@dataclass(frozen=True, kw_only=True)
class ServedPolicy:
    """A policy behind an address, and how its chunks are executed. Called with an environment, it makes an agent."""

    address: str
    """`vla://host:port`, `vlas://`, `ws://`, `wss://`, `gr00t://` or `openvla+http://`."""
    execution: Execution = field(default_factory=Execution)
    """Options of the execution of its chunks."""
    instruction: str | None = None
    """The instruction; None for the environment's."""
    timeout: float = 5.0
    """Longest duration of an answer [s]."""
    certificate: str | None = None
    """File with the certificate that the server's must be signed by."""
    trained: int | None = None
    """Steps that the training had made; None if that is not known."""
    described_in: str | None = None
    """JSON file with the policy's metadata, as `Metadata.to_dict` has them, for servers that do not send them: those of
    openpi, GR00T and OpenVLA."""

    def identify(self) -> Identity:
        """Return what the server says of the policy; its folder counts only if it does not say which weights act.

        Raises:
            RcsError: There is no policy; see `connect`.
        """
        metadata = self.metadata()
        policy = metadata.to_dict()
        weights, data = (policy.pop(name, "") or None for name in ("checkpoint_hash", "data_hash"))
        if weights is not None:
            policy.pop("checkpoint", None)
        execution = {**asdict(self.execution), "instruction": self.instruction, "timeout": self.timeout}
        return Identity(
            name=metadata.name,
            weights=weights,
            trained=self.trained,
            data=data,
            place=self.address,
            policy=policy,
            execution=execution,
        )

    def connect(self) -> Any:
        """Return a client, a policy of vlagents; the token is that of the environment variable `VLAGENTS_TOKEN`.

        Raises:
            MissingDependency: vlagents is not installed.
            InvalidSetup: The address is invalid or takes no metadata, or the file with them is wrong.
            RcsError: There is no server, it does not answer, or it requires another token.
        """
        v = vlagents()
        if self.described_in is not None and self.address.startswith("vla"):
            raise InvalidSetup(f"{self.address} sends its own metadata; leave out described_in.")
        try:
            options = {} if self.described_in is None else {"metadata": _described(Path(self.described_in), v)}
            return v.connect(
                self.address, token=os.environ.get(TOKEN), timeout=self.timeout, certificate=self.certificate, **options
            )
        except v.InvalidInput as err:
            raise InvalidSetup(str(err)) from err
        except (v.VlagentsError, OSError) as err:
            raise RcsError(f"{type(err).__name__}: {err}") from err

    def metadata(self) -> Metadata:
        """Connect, and return the metadata of the policy.

        Raises:
            RcsError: There is no policy; see `connect`.
        """
        with self.connect() as client:
            return client.metadata()

    def __call__(self, env: Env) -> ChunkAgent:
        """Connect, and return an agent for an environment.

        Raises:
            InvalidSetup: Policy and environment do not fit; the message has all differences.
            RcsError: There is no policy; see `connect`.
        """
        client = self.connect()
        try:
            return ChunkAgent(env, client, execution=self.execution, instruction=self.instruction)
        except BaseException:
            client.close()
            raise


def _described(path: Path, v: Any) -> Metadata:
    try:
        return v.Metadata.from_dict(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"{path} has no metadata of a policy: {err}") from err
