from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter

import rcs
from rcs.agents import Agent, PickExpert
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup
from rcs.rollout.episode import Answer, play, run_episode


class Wait(Agent):
    """Stays where it is, and has something go wrong in its third step."""

    def __init__(self, env: Any, *, has_fault: bool = False) -> None:
        self._env = env
        self._has_fault = has_fault
        self._steps = 0
        self._rest = 0.0 if env.setup.relative == "last_step" else env.robots["fr3"].arm.home

    def reset(self, observation: Any, info: Any) -> None:
        self._steps = 0

    def act(self, observation: Any, info: Any) -> Any:
        self._steps += 1
        if self._has_fault and self._steps == 3:
            self._env.stack.faults = lambda: {"arm": "touched something"}
        action = self._env.action_space.sample()
        action["joints"][:] = self._rest
        return action


def test_where_no_task_judges_success_is_not_known() -> None:
    env = rcs.make("Free", max_episode_steps=5)
    result = run_episode(env, Wait(env), seed=0)
    assert (result.success, result.failure, result.steps) == (None, None, 5)


def test_a_task_that_is_not_done_in_time_has_failed() -> None:
    env = rcs.make("PickCuboid", max_episode_steps=5)
    result = run_episode(env, Wait(env), seed=0)
    assert (result.success, result.failure, result.steps) == (False, "timeout", 5)


@pytest.mark.parametrize("task", ["PickCuboid", "Free"])
def test_an_episode_that_a_fault_ends_has_failed_in_simulation_and_is_not_judged_on_devices(task: str) -> None:
    for hardware, success in ((None, False), ("fake", None)):
        env = rcs.make(task, hardware=hardware)
        result = run_episode(env, Wait(env, has_fault=True), seed=0)
        env.close()
        assert (result.success, result.failure, result.steps) == (success, "fault", 3)


def test_a_judge_has_the_last_word_and_its_first_tag_is_the_class_of_a_failure() -> None:
    env = rcs.make("PickCuboid", max_episode_steps=5)
    for answer, failure in (
        (Answer(success=False, stages=1, tags=("slip", "late"), words="to the left"), "slip"),
        (Answer(success=False), "timeout"),
        (Answer(success=True, tags=("slow",)), None),
    ):
        result = run_episode(env, Wait(env), seed=0, judge=lambda observation, info, answer=answer: answer)
        assert (result.success, result.failure) == (answer.success, failure)
        assert (result.stages, result.tags, result.words) == (answer.stages, answer.tags, answer.words)


class Lost(Wait):
    """Knows why it fails."""

    failure = "policy"


@pytest.mark.parametrize("first", [Answer(success=False, tags=("slip",)), Answer(success=True), Answer(success=None)])
def test_an_answer_that_is_taken_back_leaves_no_tag_and_the_class_is_that_of_the_episode(first: Answer) -> None:
    env = rcs.make("PickCuboid", max_episode_steps=2)
    for agent, failure in ((Lost(env), "policy"), (Wait(env), "timeout")):
        result = run_episode(env, agent, seed=0, judge=lambda observation, info: first)
        again = result.corrected(Answer(success=False))
        assert (again.success, again.failure, again.tags) == (False, failure, ())
        late = again.corrected(Answer(success=False, tags=("late",)))
        assert (late.failure, late.corrected(Answer(success=True)).failure) == ("late", None)


def test_stages_are_the_most_that_were_reached() -> None:
    env = rcs.make("PickCuboid")
    assert run_episode(env, PickExpert(env), seed=0).stages == 3
    assert run_episode(env, Wait(env), seed=0, max_steps=5).stages == 0
    with rcs.make("Free", max_episode_steps=5) as free:
        assert run_episode(free, Wait(free), seed=0).stages is None


class Slow(Wait):
    """Decides at 10 Hz, and notes how often it did."""

    rate = 10.0

    def notes(self) -> Any:
        return {"decision": self._steps}


def recorded(env: Any, agent: Agent, out: Path, **options: Any) -> Any:
    """Return the recorded rows of an episode."""
    with DatasetWriter.open(out, dataset_info(env, notes=["decision"])) as writer:
        recorder = Recorder(writer)
        env.add_observer(recorder)
        recorder.name_next("000000")
        run_episode(env, agent, seed=0, **options)
        recorder.finish(None)
    return Dataset.open(out)["000000"]


def test_the_action_of_a_slow_agent_is_repeated_and_its_notes_are_recorded_where_it_decided(tmp_path: Path) -> None:
    env = rcs.make("Free", frequency=30.0, relative=False, max_episode_steps=7)
    episode = recorded(env, Slow(env), tmp_path / "set")
    nan = np.nan
    np.testing.assert_array_equal(episode.column("notes/decision"), [nan, 1, nan, nan, 2, nan, nan, 3])
    actions = episode.column("action/gripper")[1:, 0]
    assert (actions[0:3] == actions[0]).all()
    assert (actions[3:6] == actions[3]).all()
    assert actions[0] != actions[3]


@pytest.mark.parametrize(
    ("options", "text"),
    [({"frequency": 25.0, "relative": False}, "must be a multiple"), ({"frequency": 30.0}, "would add up")],
)
def test_a_rate_that_does_not_fit_the_environment_is_refused(options: dict[str, Any], text: str) -> None:
    env = rcs.make("Free", **options)
    with pytest.raises(InvalidSetup, match=text):
        run_episode(env, Slow(env))


def test_a_judge_sees_the_last_observation_and_takes_the_place_of_the_task() -> None:
    env = rcs.make("PickCuboid", max_episode_steps=3)
    seen: list[float] = []

    def judge(observation: Any, info: Any) -> bool:
        seen.append(info["time"])
        return True

    result = run_episode(env, Wait(env), seed=0, judge=judge)
    assert (result.success, result.failure) == (True, None)
    assert seen == [pytest.approx(0.1, abs=2e-3)]
    assert run_episode(env, Wait(env), seed=0, judge=lambda observation, info: None).success is None


def test_most_steps_and_options_are_kept_and_every_step_is_yielded() -> None:
    env = rcs.make("PickCuboid", max_episode_steps=None)
    joints = np.array(env.robots["fr3"].arm.home) + 0.1
    start = {"robot": {"joints": joints}}
    steps = list(play(env, Wait(env), seed=0, options=start, max_steps=4))
    assert [step.row for step in steps] == [0, 1, 2, 3, 4], "the reset, too"
    assert [step.is_over for step in steps] == [False] * 4 + [True]
    assert run_episode(env, Wait(env), seed=0, options=start, max_steps=4).reward == steps[-1].reward
    with pytest.raises(InvalidSetup, match="max_steps is 0"):
        run_episode(env, Wait(env), max_steps=0)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_all_devices_hold_when_the_agent_breaks_the_episode_off(error: type[BaseException]) -> None:
    class Fails(Wait):
        def act(self, observation: Any, info: Any) -> Any:
            action = super().act(observation, info)
            action["joints"][0] += 0.5
            if self._steps == 2:
                raise error("the policy server is gone")
            return action

    env = rcs.make("Free", relative=False)
    with pytest.raises(error):
        run_episode(env, Fails(env))
    robot = env.simulation.robots[0]
    np.testing.assert_array_equal(robot._memory[: len(robot.joints)], robot.joints)  # not on the way elsewhere
    env.close()


def test_all_devices_hold_when_a_caller_stops_early() -> None:
    class Goes(Wait):
        def act(self, observation: Any, info: Any) -> Any:
            action = super().act(observation, info)
            action["joints"][0] += 0.5
            return action

    env = rcs.make("Free", relative=False)
    steps = play(env, Goes(env))
    for step in steps:
        if step.row == 2:
            steps.close()
    robot = env.simulation.robots[0]
    np.testing.assert_array_equal(robot._memory[: len(robot.joints)], robot.joints)
    env.close()
