from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter
from rcs_data.ledger import Ledger
from vlagents import ImageSpec, Metadata, Observation, PartSpec, Server
from vlagents.policies.scripted import ScriptedPolicy

from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.record import record_all
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.errors import InvalidAction, InvalidSetup, RcsError, SimulationError, UnknownName, WrongOrder
from rcs.policy import Execution, ServedPolicy
from rcs.rollout.episode import EpisodeResult, run_episode
from rcs.rollout.evaluate import evaluate, film
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.foreign import ForeignEnv, ForeignSimulator, _setup
from rcs.rollout.serving import ServerProcess

TINY = Path(__file__).parents[2] / "packages" / "vlagents" / "tests" / "simulators"
METADATA = Metadata(
    name="reacher",
    state=(PartSpec("tquat", 7, "m, xyzw"), PartSpec("goal", 3, "m")),
    action=(PartSpec("xyzrpy", 6, "m, rad", "delta"), PartSpec("gripper", 1, "-1 open, 1 closed")),
    horizon=3,
    rate=20.0,
)


def reach(observation: Observation, instruction: str) -> np.ndarray:
    assert instruction == "reach the goal"
    left = observation.state["goal"] - observation.state["tquat"][:3]
    actions = np.zeros((3, 7))
    for row in actions:
        row[:3], row[6] = np.clip(left, -0.01, 0.01), 1.0
        left = left - row[:3]
    return actions


@pytest.fixture(autouse=True)
def path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(TINY))


@pytest.fixture
def policy() -> Iterator[ServedPolicy]:
    with Server(ScriptedPolicy(reach, METADATA), port=0) as server:
        yield ServedPolicy(address=str(server.address), execution=Execution(mode="open_loop"))


def tiny(folder: Path, task: str = "near", **options: str) -> ForeignSimulator:
    timeout = float(options.pop("timeout", 20))
    name, log = f"tiny_simulator:Reach:{task}", folder / "simulator.log"
    return ForeignSimulator(name=name, python=Path(sys.executable), options=options, timeout=timeout, log=log)


def served(folder: Path) -> ServerProcess:
    """Return a simulator that is served at an address, and listens."""
    words = [sys.executable, "-m", "vlagents.cli", "simulate", "tiny_simulator:Reach:near", "--port", "{port}"]
    server = ServerProcess(words, folder / "log")
    server.wait(lambda: ForeignEnv(ForeignSimulator(name=server.address)).close(), 60.0)
    return server


def run(simulator: ForeignSimulator, policy: ServedPolicy, out: Path | None = None, episodes: int = 3) -> Summary:
    env, summary = ForeignEnv(simulator), Summary()
    evaluation = Evaluation(setup=env.setup, simulator=simulator, agent=policy, episodes=episodes, out=out)
    assert len(list(evaluate(evaluation, summary, env=env))) == episodes
    return summary


def test_a_served_policy_succeeds_with_the_same_results_twice(tmp_path: Path, policy: ServedPolicy) -> None:
    simulator = tiny(tmp_path)
    first, second = run(simulator, policy), run(simulator, policy)
    assert first.successes == 3
    assert first.results == second.results
    assert {result.reward for result in first.results} == {1.0}
    assert all(3 <= result.steps <= 6 for result in first.results)


def test_a_recording_has_the_rewards_and_the_ends_of_the_simulator(tmp_path: Path, policy: ServedPolicy) -> None:
    results: list[EpisodeResult] = []
    with ForeignEnv(tiny(tmp_path)) as env, record_all(env, tmp_path / "data"):
        agent = policy(env)
        results += [run_episode(env, agent, seed=seed) for seed in (1, 2)]
    recorded = Dataset.open(tmp_path / "data").episodes
    assert len(recorded) == 2
    for episode, result in zip(recorded, results, strict=True):
        assert np.nansum(episode.column("reward")) == result.reward == 1.0
        assert [bool(flag) for flag in episode.column("terminated")] == [False] * result.steps + [True]
        assert not np.any(episode.column("truncated"))


@pytest.mark.parametrize("fault", ["die", "nan", pytest.param("hang", marks=pytest.mark.slow)])
def test_a_simulator_that_fails_gives_an_episode_without_a_verdict_and_the_next_one_runs(
    fault: str, tmp_path: Path, policy: ServedPolicy
) -> None:
    bad = Evaluation(setup=Setup("tiny:near")).seed_of(0) % (1 << 31)
    # The simulator counts the two steps of waiting: it fails in the second step of the policy.
    options = {"fault": fault, "bad_seed": str(bad), "at": "4", "timeout": "2" if fault == "hang" else "20"}
    lost, after = run(tiny(tmp_path, **options), policy, tmp_path / "ledger", episodes=2).results
    assert after.success is True
    assert (lost.success, lost.failure, lost.steps) == (None, "simulator", 1)
    words = {"die": "ConnectionLost", "hang": "DeadlineExceeded", "nan": "not finite"}
    assert lost.message is not None
    assert words[fault] in lost.message
    rows = list(Ledger(tmp_path / "ledger").rows.values())
    assert [(row.success, row.failure, row.judge) for row in rows] == [
        (None, "simulator", "nobody"),
        (True, None, "task"),
    ]


def test_an_episode_whose_simulator_fails_in_the_reset_has_neither_recording_nor_film(
    tmp_path: Path, policy: ServedPolicy
) -> None:
    bad = Evaluation(setup=Setup("tiny:near")).seed_of(0) % (1 << 31)
    simulator = tiny(tmp_path, fault="raise", bad_seed=str(bad), at="1")  # a step of waiting is part of the reset
    env = ForeignEnv(simulator)
    evaluation = Evaluation(setup=env.setup, simulator=simulator, agent=policy, episodes=2, out=tmp_path / "ledger")
    with DatasetWriter.open(tmp_path / "data", dataset_info(env)) as writer:
        env.add_observer(recorder := Recorder(writer))
        lost, after = [attempt.result for attempt in evaluate(evaluation, env=env, recorder=recorder)]
    assert (lost.failure, lost.steps, after.success) == ("simulator", 0, True)
    (recorded,) = Dataset.open(tmp_path / "data").episodes
    assert (recorded.success, recorded.outcome["attempt"]) == (True, 1)
    made = list(film(evaluation, 2))
    assert [row.failure for row, _ in made] == ["simulator", None]
    ledger = Ledger(tmp_path / "ledger")
    assert [ledger.film(row).is_file() for row, _ in made] == [False, True]


def test_a_simulator_that_is_gone_ends_the_run_and_its_episodes_are_left_to_be_run(
    tmp_path: Path, policy: ServedPolicy
) -> None:
    out, server = tmp_path / "ledger", served(tmp_path)
    try:
        simulator = ForeignSimulator(name=server.address, timeout=2.0)
        env = ForeignEnv(simulator)
        evaluation = Evaluation(setup=env.setup, simulator=simulator, agent=policy, episodes=3, out=out)
        attempts = evaluate(evaluation, env=env)
        assert next(attempts).result.success
        server.end(grace=0.0)
        with pytest.raises(RcsError, match=r"tiny:near is gone, so this episode was not begun.*ConnectionLost"):
            list(attempts)
    finally:
        server.end()
    assert [row.success for row in Ledger(out).rows.values()] == [True]
    server = served(tmp_path)
    try:
        env = ForeignEnv(simulator := replace(simulator, name=server.address))
        list(evaluate(replace(evaluation, simulator=simulator), env=env))
    finally:
        server.end()
    assert [row.success for row in Ledger(out).rows.values()] == [True] * 3


@pytest.mark.parametrize("when", ["in an episode", "between two"])
def test_a_simulator_that_another_program_opens_ends_the_run_and_its_episode_is_no_row(
    when: str, tmp_path: Path, policy: ServedPolicy
) -> None:
    out, server = tmp_path / "ledger", served(tmp_path)
    try:
        env = ForeignEnv(simulator := ForeignSimulator(name=server.address))

        def take(observation: Observation, instruction: str) -> np.ndarray:
            if env.np_random_seed == evaluation.seed_of(1):
                ForeignEnv(simulator).close()
            return reach(observation, instruction)

        with Server(ScriptedPolicy(take, METADATA), port=0) as taking:
            agent = policy if when == "between two" else replace(policy, address=str(taking.address))
            evaluation = Evaluation(setup=env.setup, simulator=simulator, agent=agent, episodes=3, out=out)
            attempts = evaluate(evaluation, env=env)
            assert next(attempts).result.success
            if when == "between two":
                ForeignEnv(simulator).close()
            with pytest.raises(RcsError, match="Another program has opened the simulator tiny:near") as caught:
                list(attempts)
            assert not isinstance(caught.value, SimulationError)
        assert [row.success for row in Ledger(out).rows.values()] == [True]
        env = ForeignEnv(simulator)
        list(evaluate(replace(evaluation, agent=policy, out=tmp_path / "again"), env=env))
    finally:
        server.end()
    assert [row.success for row in Ledger(tmp_path / "again").rows.values()] == [True] * 3


def test_a_simulator_at_an_address_has_one_process(tmp_path: Path, setup: Setup) -> None:
    simulator = ForeignSimulator(name="vla://127.0.0.1:9")
    for changes in ({"workers": 2}, {"ray": "auto"}, {"ray": "auto", "workers": 0}):
        with pytest.raises(InvalidSetup, match=r"The simulator at vla:.*workers=1 and no ray, or the name"):
            Evaluation(setup=setup, simulator=simulator, **changes)
    assert Evaluation(setup=setup, simulator=tiny(tmp_path), workers=2).workers == 2


def test_a_simulator_of_ones_own_that_does_not_start_again_ends_the_run(tmp_path: Path, policy: ServedPolicy) -> None:
    source = tmp_path / "tiny_simulator.py"
    source.write_text((TINY / source.name).read_text())
    bad = Evaluation(setup=Setup("tiny:near")).seed_of(0) % (1 << 31)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(tmp_path))
        env = ForeignEnv(simulator := tiny(tmp_path, fault="die", bad_seed=str(bad), at="4"))
        source.write_text("1 / 0")
        evaluation = Evaluation(setup=env.setup, simulator=simulator, agent=policy, out=tmp_path / "ledger")
        with pytest.raises(RcsError, match=r"(?s)tiny:near is gone, .*ZeroDivisionError"):
            list(evaluate(evaluation, env=env))
    assert [row.failure for row in Ledger(tmp_path / "ledger").rows.values()] == ["simulator"]


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Setup]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(TINY))
        with ForeignEnv(tiny(tmp_path_factory.mktemp("tiny"))) as env:
            yield env.setup


def test_the_setup_has_the_mapping_and_all_that_decides_what_happens(tmp_path: Path, setup: Setup) -> None:
    assert setup.task == "tiny:near"
    assert setup.robot_label == "tiny"
    assert (setup.frequency, setup.control, setup.relative) == (20.0, "xyzrpy", "last_step")
    mapping = setup.task_options["mapping"]
    assert mapping["images"][0]["flip"] == "rows"
    assert setup.task_options["versions"].keys() == {"tiny", "sources"}
    other = tmp_path / "mapping.json"
    other.write_text(json.dumps({**mapping, "wait": 5}))
    with ForeignEnv(replace(tiny(tmp_path), mapping=other)) as env:
        assert env.setup != setup
        assert env.setup.task_options["mapping"]["wait"] == 5


def test_the_size_of_images_is_part_of_the_setup(tmp_path: Path) -> None:
    simulator = tiny(tmp_path)
    with ForeignEnv(simulator) as env:
        own = env._connection
        facts = replace(own.facts, images=(ImageSpec("front", 24, 32),))
        larger: Any = SimpleNamespace(facts=facts, mapping=own.mapping, offer=own.mapping.offer(facts))
        assert _setup(own, simulator) == env.setup
        assert _setup(larger, simulator) != env.setup


@pytest.mark.parametrize("options", [{"options": {"size": "64"}}, {"python": Path(sys.executable)}])
def test_what_a_simulator_that_runs_cannot_be_told_is_refused(options: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"vla://127\.0\.0\.1:9 runs already\. Give its options to"):
        ForeignSimulator(name="vla://127.0.0.1:9", **options)


def test_a_mapping_or_a_policy_that_does_not_fit_is_refused_before_the_first_episode(
    tmp_path: Path, setup: Setup
) -> None:
    mapping = setup.task_options["mapping"]
    wrong = tmp_path / "mapping.json"
    wrong.write_text(json.dumps({**mapping, "steps": 1000, "start": "stored", "wait_action": [1.0]}))
    with pytest.raises(InvalidSetup, match=r"(?s)1 numbers; an action has 7.*1000 are more"):
        ForeignEnv(replace(tiny(tmp_path), mapping=wrong))
    for text in ("{", json.dumps({"steps": 3})):
        wrong.write_text(text)
        with pytest.raises(InvalidSetup, match="has no mapping"):
            ForeignEnv(replace(tiny(tmp_path), mapping=wrong))
    needs = replace(METADATA, state=(PartSpec("joints", 7, "rad"),), action=(PartSpec("joints", 7, "rad"),))
    server = Server(ScriptedPolicy(reach, needs), port=0)
    with server, ForeignEnv(tiny(tmp_path)) as env, pytest.raises(InvalidSetup) as caught:
        ServedPolicy(address=str(server.address))(env)
    assert all(
        part in str(caught.value) for part in ("needs 'joints'", "gives 'joints'", "takes 'xyzrpy'", "'gripper'")
    )


def test_what_cannot_start_says_why(tmp_path: Path) -> None:
    with pytest.raises(RcsError, match=r"(?s)ended with 1\. All that it printed is in .*simulator\.log:\n.*near, far"):
        ForeignEnv(tiny(tmp_path, task="nearby"))
    with pytest.raises(UnknownName, match=r"no simulator named 'gazebo'\..*Known: libero, maniskill, metaworld\."):
        ForeignEnv(ForeignSimulator(name="gazebo:pick"))
    with pytest.raises(InvalidSetup, match="make sims"):
        ForeignEnv(ForeignSimulator(name="maniskill:PickCube-v1", python=tmp_path / "python"))
    with pytest.raises(RcsError, match="ConnectionLost"):
        ForeignEnv(ForeignSimulator(name="vla://127.0.0.1:9"))


def test_the_token_of_the_environment_is_sent_and_another_one_is_an_error_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VLAGENTS_TOKEN", "right")
    server = served(tmp_path)
    try:
        monkeypatch.setenv("VLAGENTS_TOKEN", "wrong")
        began = time.monotonic()
        with pytest.raises(RcsError, match="does not take the token of the environment variable VLAGENTS_TOKEN"):
            server.wait(lambda: ForeignEnv(ForeignSimulator(name=server.address)).close(), 60.0)
        assert time.monotonic() - began < 20.0
    finally:
        server.end()


def test_a_simulator_of_which_no_environment_can_be_made_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, processes_with: Callable[[str], list[str]]
) -> None:
    mark = f"RCS_TEST_SIMULATOR={tmp_path}"
    monkeypatch.setenv(*mark.split("=", 1))

    def fail(*_: Any) -> Setup:
        assert processes_with(mark), "it listens"
        raise InvalidSetup("on purpose")

    monkeypatch.setattr("rcs.rollout.foreign._setup", fail)
    with pytest.raises(InvalidSetup, match="on purpose"):
        ForeignEnv(tiny(tmp_path))
    assert processes_with(mark) == []


def test_actions_are_checked_and_episodes_end_as_elsewhere(tmp_path: Path) -> None:
    with ForeignEnv(tiny(tmp_path)) as env:
        still = {"xyzrpy": np.zeros(6), "gripper": np.zeros(1, np.float32)}
        with pytest.raises(WrongOrder):
            env.step(still)
        with pytest.raises(InvalidSetup, match="reset options"):
            env.reset(0, options={"state": 1})
        observation, info = env.reset(0)
        assert info["instruction"] == "reach the goal"
        assert env.observation_space.contains(observation)
        with pytest.raises(InvalidAction):
            env.step({**still, "gripper": np.full(1, 2.0, np.float32)})
        steps, is_over = 0, False
        while not is_over:
            *_, terminated, truncated, info = env.step(still)
            steps, is_over = steps + 1, truncated
            assert not terminated
        assert (steps, info["success"]) == (60, False)
        with pytest.raises(InvalidSetup, match="seed"):
            env.reset(-1)
        assert info["time"] == pytest.approx(3.0)
    with pytest.raises(WrongOrder, match="closed"):
        env.reset(0)


def test_a_simulator_at_an_address_is_left_running(tmp_path: Path) -> None:
    server = served(tmp_path)
    try:
        env = ForeignEnv(ForeignSimulator(name=server.address, timeout=2.0))
        env.reset(0)
        server.end(grace=0.0)
        with env, pytest.raises(SimulationError, match="tiny:near: ConnectionLost"):
            env.step({"xyzrpy": np.zeros(6), "gripper": np.zeros(1, np.float32)})
    finally:
        server.end()
