"""An agent that executes the chunks of a policy, which may run elsewhere."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs.agents import Agent, Event
from rcs.envs.env import Env
from rcs.envs.spaces import Action, Observation
from rcs.errors import InvalidSetup, RcsError
from rcs.policy.actions import PolicyActions
from rcs.policy.execution import Execution, Executor
from rcs.policy.interface import policy_observation, require_fit, vlagents
from rcs.policy.plan import ChunkPlan, Plan

if TYPE_CHECKING:
    from vlagents import Metadata, Policy

NOTES = ("policy_latency", "policy_age", "policy_chunk", "policy_row", "policy_is_held", "policy_is_clipped")
"""Notes that are recorded with every step: how long the newest answer took [s], how old the observation is that it
answers [s], the number of the chunk in the episode and of its row, whether the robot was held, and whether the policy
wanted more than the environment takes."""

LOST = "policy"
"""The class of a failure in which the policy, or the connection to it, failed."""

WAIT = 5.0
"""Longest wait for an unreachable policy at the beginning of an episode [s], by the clock."""
PAUSE = 0.2
"""Pause between two attempts to reach it [s]."""

CONTINUES = "continues"
"""Key of a chunk's info: 1 if the policy has continued what was in flight."""

_numbers = itertools.count()


class ChunkAgent(Agent):
    """Shows a policy what the environment observes, and executes its chunks by time.

    In simulation, time is the simulation's, and stands still while the policy computes: the same seed gives the same
    bytes. Where steps take real time, a thread calls the policy, and time is the host's monotonic clock. When there is
    nothing to execute, because the policy is late, silent, gone, or sends what is no chunk, the robot holds.
    """

    def __init__(
        self,
        env: Env,
        policy: Policy,
        *,
        execution: Execution | None = None,
        instruction: str | None = None,
        session: str | None = None,
    ) -> None:
        """Prepare to act in an environment; the policy is not called yet.

        Args:
            env: The environment.
            policy: A policy of vlagents: a client, or one in this process.
            execution: How its chunks are executed; None for the usual way.
            instruction: The instruction for the policy; None for the environment's.
            session: The policy's session for this robot, if it serves several; None for a new one.

        Raises:
            InvalidSetup: Policy and environment do not fit; the message has all differences.
        """
        self._env, self._policy = env, policy
        self._v = vlagents()
        self.metadata: Metadata = policy.metadata()
        """The metadata of the policy."""
        require_fit(env, self.metadata)
        execution = execution or Execution()
        if env.is_real and execution.latency:
            raise InvalidSetup(f"latency is {execution.latency} s; it is for simulated time, remove it in real time.")
        self.execution = execution
        """The execution of its chunks."""
        self._period = 1.0 / env.frequency
        self._given_instruction = instruction
        self._session = session or f"{env.setup.robot_label} {next(_numbers)}"
        self._actions = PolicyActions(env, self.metadata)
        self._executor = Executor(execution, self._period, f"policy {self._session}" if env.is_real else None)
        self._instruction = ""
        self._needs_reset = self._has_ended = False
        self._message: str | None = None
        self._now = self._begun = 0.0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode; a policy that fails does so in this episode, and the robot holds.

        Raises:
            RcsError: The policy cannot be reached, for `WAIT` seconds.
            InvalidSetup: Another policy is at the address.
        """
        self._executor.reset()
        self._actions.reset(observation)
        self._has_ended, self._message = False, None
        given = self._given_instruction
        self._instruction = str(info.get("instruction", "")) if given is None else given
        self._begun = float(info.get("time", 0.0))
        self._now = self._time(info)
        self._needs_reset = True
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
        command = self._executor.step(now, lambda plan, delay: self._question(observation, info, plan, delay))
        if self._executor.error is not None and not had_error:
            self._lose(self._executor.error)
        return self._actions.hold(observation) if command is None else self._actions.action(command)

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
    def failure(self) -> str | None:
        """`policy` if the policy or its connection failed in this episode."""
        return None if self._message is None else LOST

    @property
    def failure_message(self) -> str | None:
        """The first error of the policy or its connection in this episode."""
        return self._message

    @property
    def error(self) -> Exception | None:
        """The error of the policy or its connection because of which the robot holds."""
        return self._executor.error

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

    def _reach(self) -> None:
        """Begin, and wait for a policy that cannot be reached: its server may be starting again."""
        until = time.monotonic() + WAIT
        while True:
            try:
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
        self._message = self._message or f"{type(error).__name__}: {error}"
        self._has_ended |= self.execution.on_loss == "end"

    def _question(
        self, observation: Observation, info: Mapping[str, Any], plan: Plan | None, delay: float
    ) -> Callable[[], ChunkPlan]:
        """Return the call of the policy for the present observation; see `Question`."""
        seen = policy_observation(
            observation, self.metadata, time=self._now, instruction=self._instruction, session=self._session
        )
        start = self._actions.start(observation, info)
        if plan is not None and self.metadata.continues:
            previous = self._actions.in_flight(plan, self._now, start)
            seen = replace(seen, previous=previous, frozen=self._actions.frozen(delay, len(previous)))

        def compute() -> ChunkPlan:
            if self._needs_reset:
                self._begin()
            chunk = self._policy.infer(seen)
            if chunk.actions.shape[1] != self.metadata.size:
                raise self._v.BadMessage(
                    f"The policy sent actions of {chunk.actions.shape[1]} numbers; it announced {self.metadata.size}."
                )
            # Without a rate, a row is a step of this loop.
            period = chunk.period if self.metadata.rate > 0 else self._period
            return ChunkPlan(
                self._actions.parts,
                chunk.actions,
                time=seen.time,
                period=period,
                start=start,
                continues=chunk.info.get(CONTINUES) == 1,
            )

        return compute
