"""The ledger of one evaluation: which of its episodes are there, which are to be run, and their results."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import importlib.metadata
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rcs_data.files.closing import Closing
from rcs_data.ledger import Condition, Ledger, Pairs, Row
from rcs_data.ledger.condition import key_of

from rcs.agents.identity import Identity, code_of
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import versions
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.errors import InvalidSetup, RcsError
from rcs.robots.description import Description
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import Answer, EpisodeResult
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.setups.resolve import resolve, with_camera_names


def condition_of(evaluation: Evaluation, identity: Identity, env: Env | None = None) -> Condition:
    """Return what the episodes of an evaluation share.

    Args:
        evaluation: The evaluation.
        identity: The agent.
        env: The environment, if its devices are real; None for simulation.

    Raises:
        UnknownName: The setup names something that is not there.
        InvalidSetup: Its parts do not fit each other.
    """
    setup, own, files, software = evaluation.setup, list[str](), dict[str, str](), versions()
    if evaluation.simulator is None:
        setup = with_camera_names(setup)
        parts = resolve(setup)  # before anything is written
        own, files = list(_modules(setup, parts)), _models(parts)
    if identity.trained is not None and not identity.policy:  # a network in this process: other sums, other actions
        for name in ("torch", "stable-baselines3"):
            with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # the agent says what it lacks
                software[name] = importlib.metadata.version(name)
    if identity.policy or evaluation.simulator is not None:
        software["rcs-vlagents"] = importlib.metadata.version("rcs-vlagents")
    if (path := setup.cameras.calibration) is not None:  # its content may change
        files["cameras.calibration"] = hashlib.sha256(Path(path).read_bytes()).hexdigest()
    if env is not None and env.site is not None:  # of real devices, the platform has the drivers alone
        files["site"] = env.site
    platform = {} if env is None else env.platform
    return Condition(
        agent=evaluation.name or identity.name,
        weights=identity.weights,
        trained=identity.trained,
        data=identity.data,
        policy=identity.policy,
        execution=identity.execution,
        task=setup.task,
        robot=setup.robot_label,
        setup=setup.to_json(),
        platform={name: driver for name, driver in platform.items() if driver != "simulation"},
        tags=evaluation.tags,
        code={**code_of([*identity.modules, *own]), **files},
        versions=software,
    )


def _described(parts: Parts) -> list[Description]:
    """Return the arms, end effectors, cameras and tactile sensors of a setup."""
    mounted = [one for robot in parts.robots for one in (robot.arm, robot.end_effector) if one is not None]
    return [*mounted, *(one.camera for one in parts.cameras), *(one.sensor for one in parts.tactile)]


def _models(parts: Parts) -> dict[str, str]:
    """Return the hashes of the models' files, except those that count with the sources of this package."""
    package = Path(__file__).parents[1]
    return {
        f"model.{one.name}": hashlib.sha256(one.mjcf.read_bytes()).hexdigest()
        for one in _described(parts)
        if one.mjcf.is_file() and not one.mjcf.is_relative_to(package)
    }


def _modules(setup: Setup, parts: Parts) -> Iterator[str]:
    """Yield the modules that a setup has parts of."""
    for name in [setup.robot] if isinstance(setup.robot, str) else setup.robot.values():
        yield from filter(None, (lookup.module_of("lab", name), lookup.module_of("arm", name)))
    for one in (robot.end_effector for robot in parts.robots):  # also that of a lab
        if one is not None:
            yield from filter(None, (lookup.module_of("gripper", one.name), lookup.module_of("hand", one.name)))
    yield from (one.module for one in _described(parts) if one.module)
    yield lookup.find("task", setup.task).__module__
    yield from (lookup.find("layer", name).__module__ for name in setup.layers)
    yield from (lookup.find("gate", name).__module__ for name in setup.gates)


class Logbook(Closing):
    """The ledger of an evaluation. Nothing is written before the first episode."""

    def __init__(
        self,
        evaluation: Evaluation,
        identity: Identity,
        condition: Condition,
        judge: str = "task",
        *,
        is_blind: bool = False,
    ) -> None:
        """Read what is there.

        Args:
            evaluation: The evaluation, which has a folder.
            identity: The agent.
            condition: The condition that its episodes share.
            judge: The judge, `task` or `person`.
            is_blind: Whether nothing that is written may say who acts.

        Raises:
            DatasetError: Something else is in the folder, or it cannot be read.
            InvalidSetup: There is no agent to decide against.
        """
        assert evaluation.out is not None
        self._evaluation, self._identity, self._judge, self._is_blind = evaluation, identity, judge, is_blind
        self.condition = condition
        """The condition that the episodes share."""
        self.hash = condition.hash
        """Its hash."""
        is_there = evaluation.out.is_dir() and any(evaluation.out.iterdir())
        self._ledger = Ledger.open(evaluation.out) if is_there else None
        self.pairs = Pairs()
        """Verdicts of this agent, A, and of the one to decide against, B, as far as they are compared."""
        self._compared, self._is_decided = 0, False
        self._theirs: dict[int, bool | None] = {}
        if evaluation.against is not None:
            if self._ledger is None:
                raise InvalidSetup(f"There is no ledger in {evaluation.out}, so nothing to decide against.")
            against = self._ledger.find(evaluation.against, besides=self.hash)
            if against == self.hash:
                raise InvalidSetup(
                    f"{evaluation.against!r} is the agent that is evaluated; name another to decide against."
                )
            self._theirs = {row.seed: row.success for row in self._ledger.of(against)}

    @property
    def ledger(self) -> Ledger:
        """The ledger; the folder becomes one if it is none yet."""
        if self._ledger is None:
            assert self._evaluation.out is not None
            self._ledger = Ledger.open(self._evaluation.out)
        return self._ledger

    def row_of(self, number: int) -> Row | None:
        """Return the row of an episode, by its number; None if it is not there."""
        return None if self._ledger is None else self._ledger.rows.get(self._evaluation.name_of(self.hash, number))

    def take(self, summary: Summary) -> None:
        """Add the episodes that are there, and not in a summary yet, to it."""
        if self._ledger is None:
            return
        self._ledger.refresh()
        known = {attempt.number for attempt in summary.attempts}
        for number in self._evaluation.numbers:
            if number not in known and (row := self.row_of(number)) is not None:
                summary.attempts.append(_attempt(number, row))

    def missing(self, summary: Summary) -> Iterator[int]:
        """Yield the numbers to be run, each when it is requested; those running elsewhere are left to others."""
        for number in self._evaluation.numbers:
            if summary.is_interrupted or self.is_decided(summary):
                return
            if self.is_missing(number):
                yield number

    def is_missing(self, number: int) -> bool:
        """Return whether an episode is neither there nor running elsewhere; it is then this process's own."""
        key, repeat = key_of(self.hash, self._evaluation.seed_of(number)), self._evaluation.repeat_of(number)
        return self.row_of(number) is None and self.ledger.claim(key, repeat)

    def add(self, attempt: Attempt, corrections: int = 0) -> None:
        """Write the result of an episode.

        Args:
            attempt: The episode.
            corrections: How often the answer of its judge was taken back before.

        Raises:
            RcsError: Other weights acted than those that the evaluation began with, or a policy at an address was lost
                in simulation, where that says nothing about it.
            DatasetError: The disk is full or fails.
        """
        if attempt.weights != self._identity.weights:
            which = "" if self._is_blind else f", from {self._identity.weights} to {attempt.weights}"
            whose = "a policy" if self._is_blind else self.condition.agent
            raise RcsError(
                f"The weights of {whose} changed during the evaluation{which}. Episode {attempt.number} is left out; "
                "run it again to evaluate the new ones."
            )
        if attempt.is_lost and not self.condition.is_real:
            words = "its message is hidden" if self._is_blind else attempt.result.message
            raise RcsError(
                f"The policy was lost: {words}. Episode {attempt.number} is left out; start the "
                "server, and run the same again to go on."
            )
        condition, result = self.condition, attempt.result
        p50, p99 = np.percentile(attempt.latencies, (50, 99)).tolist() if attempt.latencies else (None, None)
        if not self._is_blind:
            self.ledger.register(condition, self._identity.place)
        seed = self._evaluation.seed_of(attempt.number)
        judge = "task" if result.own_failure in (FAULT, DIVERGED) else self._judge  # nobody is asked about these
        row = Row(
            key=key_of(self.hash, seed),
            repeat=self._evaluation.repeat_of(attempt.number),
            condition=self.hash,
            seed=seed,
            agent=condition.agent,
            weights=condition.weights,
            trained=condition.trained,
            data=condition.data,
            task=condition.task,
            robot=condition.robot,
            is_real=condition.is_real,
            success=result.success,
            failure=result.failure,
            message=result.words or (None if self._is_blind else result.message),
            judge="nobody" if result.success is None else judge,
            stages=result.stages,
            tags=result.tags,
            corrections=corrections,
            steps=result.steps,
            reward=result.reward if math.isfinite(result.reward) else None,
            latency_p50=p50,
            latency_p99=p99,
            seconds=attempt.seconds,
            ended=datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds"),
        )
        self.ledger.add(row)

    def correct(self, attempt: Attempt, answer: Answer) -> Attempt:
        """Write another answer of the judge for an episode that is there, and return the attempt with it.

        Raises:
            DatasetError: The disk is full or fails.
        """
        row = self.row_of(attempt.number)
        assert row is not None, "it was answered"
        corrected = replace(attempt, result=attempt.result.corrected(answer))
        self.add(corrected, row.corrections + 1)
        self.pairs, self._compared, self._is_decided = Pairs(), 0, False  # counted anew
        return corrected

    def is_decided(self, summary: Summary) -> bool:
        """Return whether the episodes so far decide between this agent and the other one.

        Only episodes before the first that still runs count, in the order of their numbers: successes end sooner than
        failures, so that whatever ended first would favour them. Those that other processes have written count too.
        """
        if self._evaluation.until is None:
            return False
        ours = {attempt.number: attempt.result.success for attempt in summary.attempts}
        while not self._is_decided and self._compared < self._evaluation.episodes:
            if self._compared not in ours:
                if (row := self.row_of(self._compared)) is None:
                    break
                ours[self._compared] = row.success
            seed = self._evaluation.seed_of(self._compared)
            pair = Pairs.of({seed: ours[self._compared]}, {seed: self._theirs.get(seed)})
            self.pairs = self.pairs + pair
            self._compared += 1
            self._is_decided = self.pairs.is_decided(self._evaluation.until)
        return self._is_decided

    def close(self) -> None:
        """Give up what was claimed. Closing twice is harmless."""
        if self._ledger is not None:
            self._ledger.close()


def _attempt(number: int, row: Row) -> Attempt:
    result = EpisodeResult(
        seed=row.seed,
        steps=row.steps,
        success=row.success,
        failure=row.failure,
        reward=math.nan if row.reward is None else row.reward,
        message=row.message,
        stages=row.stages,
        tags=row.tags,
    )
    return Attempt(number=number, result=result, weights=row.weights, seconds=row.seconds, is_found=True)


def differs(row: Row, result: EpisodeResult) -> bool:
    """Return whether an episode that was run again went otherwise than its row says."""
    reward = math.nan if row.reward is None else row.reward
    is_alike = row.steps == result.steps and bool(np.isclose(result.reward, reward, equal_nan=True))
    if row.judge == "person" or (row.judge == "nobody" and row.failure is None):  # nobody judges a film
        return not is_alike
    return not is_alike or (row.success, row.failure) != (result.success, result.failure)
