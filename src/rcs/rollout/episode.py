"""One rollout: an agent acts in an environment until the episode is over."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import require_whole

from rcs.agents import Agent, Pace
from rcs.envs.env import Env
from rcs.envs.spaces import Observation
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.errors import SimulationError

OPEN = 0.5
"""A gripper command of at least this opens."""

TIMEOUT = "timeout"
"""The class of a failure of which nobody knows more."""

SIMULATOR = "simulator"
"""The class of a failure of another project's simulator, which says nothing about the agent."""

STAGES = ("is_touched", "is_grasped", "success")
"""Flags of `info`, in the order in which a task comes to them."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A judge's answer."""

    success: bool | None
    """Whether the task was done; None if that is not known."""
    stages: int | None = None
    """Stages of the task that were reached; None if the judge did not count."""
    tags: tuple[str, ...] = ()
    """Tags; the first is the class of a failure."""
    words: str | None = None
    """Words on it; None without any."""


Judge = Callable[[Observation, Mapping[str, Any]], Answer | bool | None]
"""Returns an answer by the last observation and info, or only whether the task was done."""


@dataclass(frozen=True, kw_only=True)
class EpisodeResult:
    """The result of an episode."""

    seed: int | None
    steps: int
    success: bool | None
    """True if the task was done; None without a verdict, as on devices or after a fault."""
    failure: str | None
    """Class of the failure: `fault` of a device, `diverged` of the simulation, `simulator` if that of another project
    failed, or one of the agent; None otherwise."""
    reward: float
    """Sum over the episode."""
    message: str | None = None
    """The agent's message about a problem, even if the task was done in the end, or the reasons of a fault of real
    devices; None without one."""
    stages: int | None = None
    """Stages of the task that were reached: objects touched, grasped, all done, or as a judge counts; None if nobody
    counted."""
    tags: tuple[str, ...] = ()
    """Tags of a judge."""
    words: str | None = None
    """A judge's words; None without any."""
    own_failure: str | None = field(default=None, compare=False)
    """Class that a failure has without a judge's tags, also where the task was done: another answer may follow."""

    def outcome(self) -> dict[str, Any]:
        """Return the outcome to store, besides success and seed, with the rest of an answer under a ledger's names."""
        more = {"stages": self.stages, "tags": list(self.tags) or None, "message": self.words}
        given = {name: value for name, value in more.items() if value is not None}
        return {"failure": self.failure, "reward": self.reward, **given}

    def corrected(self, answer: Answer) -> EpisodeResult:
        """Return the result with another answer of the judge."""
        failure = None if answer.success is not False else next(iter(answer.tags), self.own_failure or TIMEOUT)
        return replace(self, failure=failure, **vars(answer))


@dataclass(frozen=True, kw_only=True)
class Step:
    """The result of the reset, or of a step."""

    row: int
    """0 after the reset, then the number of the step."""
    observation: Observation
    info: dict[str, Any]
    reward: float = 0.0
    """Sum since the reset."""
    was_touched: bool = False
    """Whether an object was touched before the gripper was commanded to close."""
    stages: int | None = None
    """Most stages that were reached since the reset; None if no task counts them."""
    is_over: bool


def play(
    env: Env,
    agent: Agent,
    *,
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    max_steps: int | None = None,
    known: Mapping[str, Any] | None = None,
    is_over: Callable[[], bool] | None = None,
) -> Generator[Step]:
    """Run an agent until the episode is over, and yield the reset and every step.

    If an error or Ctrl-C ends it, or the generator is closed earlier, all devices hold.

    Args:
        env: The environment.
        agent: The agent, which acts until the end, or until its event `stop`, at which all devices hold. If it decides
            at a lower rate than the environment, its last action is repeated; its notes are given to observers with the
            steps in which it decided.
        seed: Seed of the reset.
        options: Options of the reset.
        max_steps: Largest number of steps, besides the environment's limit; None for no limit.
        known: Further entries of the info that the agent gets, in every step.
        is_over: Called after every step; if it returns True, that is like the event `stop`.

    Raises:
        InvalidSetup: The agent's rate does not divide the environment's, or its repeated actions would add up.
    """
    pace, more = Pace(env, agent), dict(known or {})
    observation, info = env.reset(seed=seed, options=options)
    step = Step(row=0, observation=observation, info=info, stages=_most(None, info), is_over=max_steps == 0)
    try:
        pace.reset(observation, {**info, **more})
        yield step
        while not step.is_over:
            action = pace.act(step.observation, {**step.info, **more})
            env.note(**pace.notes())
            observation, reward, terminated, truncated, info = env.step(action)
            step = Step(
                row=step.row + 1,
                observation=observation,
                info=info,
                reward=step.reward + float(reward),
                was_touched=step.was_touched or (bool(info.get("is_touched", False)) and bool(is_open(action))),
                stages=_most(step.stages, info),
                is_over=terminated or truncated or step.row + 1 == max_steps,
            )
            if not step.is_over and ("stop" in agent.events() or (is_over is not None and is_over())):
                step = replace(step, is_over=True)
                env.hold()
            yield step
    except BaseException:
        env.hold()  # the last command must not go on unsupervised
        raise


def run_episode(
    env: Env,
    agent: Agent,
    *,
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    judge: Judge | None = None,
    max_steps: int | None = None,
    known: Mapping[str, Any] | None = None,
    is_over: Callable[[], bool] | None = None,
) -> EpisodeResult:
    """Run one episode, at the end of which all real devices hold; all devices hold after an error or Ctrl-C.

    Args:
        env: The environment.
        agent: The agent; see `play`, which yields every step instead.
        seed: Seed of the reset.
        options: Options of the reset.
        judge: Returns whether the task was done, in the place of the task; not called after a fault.
        max_steps: Largest number of steps, besides the environment's limit; None for no limit.
        known: Further entries of the info that the agent gets, in every step.
        is_over: Called after every step; if it returns True, that is like the event `stop`.

    Raises:
        InvalidSetup: The agent's rate does not divide the environment's, its repeated actions would add up, or
            `max_steps` is below 1.
    """
    if max_steps is not None:
        require_whole("max_steps", max_steps, 1)
    step: Step | None = None
    try:
        steps = play(env, agent, seed=seed, options=options, max_steps=max_steps, known=known, is_over=is_over)
        for step in steps:  # noqa: B007  the last one counts
            pass
    except SimulationError as err:
        if env.is_simulated:  # here, and not by another project
            raise
        row, reward = (0, 0.0) if step is None else (step.row, step.reward)
        return EpisodeResult(seed=seed, steps=row, success=None, failure=SIMULATOR, reward=reward, message=str(err))
    assert step is not None, "the reset is a step, too"
    is_simulated, end = set(env.platform.values()) == {"simulation"}, step.info["end"]
    if not is_simulated and end != FAULT:
        env.hold()  # real devices are in motion still, while the episode is judged and the next one prepared
    answer, has_ended = Answer(success=step.info.get("success"), stages=step.stages), end not in (FAULT, DIVERGED)
    if judge is not None and has_ended:
        given = judge(step.observation, step.info)
        answer = given if isinstance(given, Answer) else Answer(success=given)
    success, failure = verdict(end, answer.success, step.was_touched, agent)
    _, own_failure = verdict(end, False, step.was_touched, agent)
    message = agent.failure_message if has_ended else None
    if not is_simulated and end == FAULT:
        message = "; ".join(f"{name}: {reason}" for name, reason in step.info.get("faults", {}).items())
    return EpisodeResult(
        seed=seed,
        steps=step.row,
        # A device that fails says nothing about the agent; a simulated arm fails because of what the agent did.
        success=success if is_simulated or end != FAULT else None,
        failure=failure if success is not False else next(iter(answer.tags), failure),
        reward=step.reward,
        message=message,
        stages=answer.stages,
        tags=answer.tags,
        words=answer.words,
        own_failure=own_failure,
    )


def verdict(end: str, success: Any, was_touched: bool, agent: Agent) -> tuple[bool | None, str | None]:
    """Return success and class of the failure of a simulated episode.

    Args:
        end: The entry `end` of the last info.
        success: The verdict of the task or of a judge; None without one.
        was_touched: Whether an object was touched before the gripper was commanded to close.
        agent: The agent, which may know why it failed.
    """
    if end in (FAULT, DIVERGED):
        return False, end
    if success is None or success:
        return None if success is None else True, None
    return False, agent.failure or ("collision" if was_touched else TIMEOUT)


def stages_of(info: Mapping[str, Any]) -> NDArray[np.int64] | None:
    """Return how many of `STAGES` are reached now, (*leading,), of those that the task has; None if it has none."""
    flags = [np.asarray(info[name], np.bool_) for name in STAGES if name in info]
    return np.max([number * flag for number, flag in enumerate(flags, 1)], axis=0) if flags else None


def _most(before: int | None, info: Mapping[str, Any]) -> int | None:
    now = stages_of(info)
    return before if now is None else max(before or 0, int(now))


def randomisation_of(env: Env) -> dict[str, Any]:
    """Return the outcome's entry about the randomisation of the present episode; empty if there is none."""
    drawn = {field: values.tolist() for field, values in env.simulation.randomisation.items()}
    return {"randomisation": drawn} if drawn else {}


def is_open(action: Mapping[str, Any], copies: int | None = None) -> NDArray[np.bool_]:
    """Return whether every gripper was commanded to be open, so that touching something is a collision.

    Args:
        action: The action.
        copies: Number of copies with an action each; None for a single environment.
    """
    parts = list(action.values()) if all(isinstance(value, Mapping) for value in action.values()) else [action]
    shape = () if copies is None else (copies,)
    if not all("gripper" in part for part in parts):
        return np.zeros(shape, np.bool_)
    return np.all([np.reshape(part["gripper"], (*shape, -1)).min(-1) >= OPEN for part in parts], axis=0)
