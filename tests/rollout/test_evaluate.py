"""Evaluations: the same starts for everyone, a ledger from which they go on, and films of the episodes in it."""

from __future__ import annotations

import dataclasses
import inspect
import io
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset, DatasetWriter
from rcs_data.ledger import Ledger, Row
from rcs_data.ledger.row import TIMES
from rcs_data.read.verdicts import wilson_interval
from rich.console import Console

import rcs
from rcs.agents.identity import identity_of
from rcs.cli.runs import results_table
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup, RcsError, UnknownName, WrongOrder
from rcs.rollout.collection import seed_of
from rcs.rollout.evaluate import Evaluator, evaluate, film
from rcs.rollout.evaluation import UNSEEN, Evaluation, Summary
from rcs.rollout.logbook import condition_of, differs
from rcs.setups import labs
from tests.rollout.staying import SETUP, Stay, claimed, run


def test_the_expert_succeeds_and_who_stays_does_not() -> None:
    expert = run(setup=rcs.Setup(task="PickCuboid"), agent=None, episodes=2)
    assert (expert.successes, expert.judged, dict(expert.failures)) == (2, 2, {})
    idle = run()
    assert (idle.successes, idle.judged, dict(idle.failures)) == (0, 3, {"timeout": 3})
    assert idle.interval == wilson_interval(0, 3)


def test_episodes_depend_on_the_seed_and_their_number_alone() -> None:
    one, many = run(seed=5), run(seed=5, workers=2)
    assert one.results == many.results
    assert [result.seed for result in one.results] == [UNSEEN + seed_of(5, number) for number in range(3)]
    assert {result.seed for result in run(seed=6).results}.isdisjoint(result.seed for result in one.results)


def test_where_nobody_judges_nothing_is_counted() -> None:
    free = run(setup=rcs.Setup(task="Free", max_episode_steps=2))
    assert (free.judged, dict(free.failures)) == (0, {})
    assert free.interval == (0.0, 1.0)


def test_a_judge_takes_the_place_of_the_task() -> None:
    summary = Summary()
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=2, workers=2)
    for _ in evaluate(evaluation, summary, judge=lambda observation, info: True):
        pass
    assert summary.successes == 2


def test_an_interrupted_evaluation_keeps_what_was_done() -> None:
    summary = Summary()
    for _ in evaluate(Evaluation(setup=SETUP, agent=Stay, episodes=100), summary):
        summary.is_interrupted = len(summary.attempts) == 2
    assert len(summary.attempts) == 2


def test_a_given_environment_is_used_and_closed() -> None:
    env = rcs.make(SETUP)
    attempts = list(evaluate(Evaluation(setup=SETUP, agent=Stay(env), episodes=1, workers=4), env=env))
    assert attempts[0].result.steps == 4
    with pytest.raises(WrongOrder, match="closed"):
        env.reset()


def test_an_environment_of_another_setup_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    env = rcs.make(replace(SETUP, frequency=10.0))
    with pytest.raises(InvalidSetup, match=r"than the evaluation: frequency is 10\.0, not 30\.0\. Evaluate with"):
        list(evaluate(Evaluation(setup=SETUP, agent=Stay, episodes=1, out=tmp_path), env=env))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(WrongOrder, match="closed"):
        env.reset()


def test_an_unknown_agent_leaves_no_environment_open() -> None:
    env = rcs.make(SETUP)
    with pytest.raises(UnknownName, match="Stey"):
        next(evaluate(Evaluation(setup=SETUP, agent="Stey", episodes=1), env=env))
    with pytest.raises(WrongOrder, match="closed"):
        env.reset()


@pytest.mark.parametrize("field", ["episodes", "seed", "workers", "repeat"])
@pytest.mark.parametrize("value", [-1, 1.5, True])
def test_numbers_that_make_no_sense_are_refused(field: str, value: Any) -> None:
    with pytest.raises(InvalidSetup, match=f"{field} is"):
        Evaluation(**{"setup": SETUP, field: value})


def rows_of(folder: Path) -> list[tuple[Any, ...]]:
    """Return all that the rows of a ledger say, besides times."""
    rows = sorted(Ledger(folder).rows.values(), key=lambda row: row.name)
    return [tuple(getattr(row, name) for name in Row.__struct_fields__ if name not in TIMES) for row in rows]


def test_the_ledger_says_what_was_evaluated_and_how_every_episode_went(tmp_path: Path) -> None:
    run(episodes=2, out=tmp_path / "new" / "folder", tags={"mix": "half"})
    ledger = Ledger(tmp_path / "new" / "folder")
    (condition,) = ledger.conditions.values()
    assert rcs.Setup.from_json({**condition.setup}) == SETUP
    assert condition.agent == f"{Stay.__module__}:Stay"
    assert condition.code.keys() == {"rcs", Stay.__module__}
    assert condition.tags == {"mix": "half"}
    assert condition.versions["robot-control-stack"] == rcs.__version__
    assert [(row.failure, row.judge) for row in ledger.rows.values()] == [("timeout", "task")] * 2
    assert all(row.seconds > 0 for row in ledger.rows.values())


CHANGED: dict[str, Any] = {
    "task": "Push", "task_options": {"lift_height": 0.05}, "reward": "sparse", "discount": 0.9, "robot": "ur5e",
    "end_effector": "robotiq_2f85", "cameras": "wrist", "tactile": "digit", "render_quality": "full",
    "assets": "menagerie", "observe": ("contacts",), "collision_reaction": False,
    "compliance": rcs.Compliance(tcp=(500, 30)), "control": "tquat", "relative": "origin", "native": True,
    "binary_gripper": False, "at_end": "park", "layers": ("KeepTilt",), "gates": {"Guard": {}}, "frequency": 5.0,
    "stepping": "realtime", "sync_time_limit": 5.0, "max_episode_steps": 5, "physics_step": 0.001,
    "randomisation": "default",
}  # fmt: skip
"""Another value for every argument of a setup."""


def test_a_change_of_any_argument_of_a_setup_changes_the_key() -> None:
    fields = {own.name for own in dataclasses.fields(rcs.Setup)}  # pyright: ignore[reportArgumentType]
    assert fields == set(CHANGED), "every argument is changed in this test"
    usual = {"native": {"control": "tquat"}}

    def hash_of(**options: Any) -> str:
        evaluation = Evaluation(setup=replace(SETUP, **options), agent="PickExpert")
        return condition_of(evaluation, identity_of("PickExpert", "PickCuboid")).hash

    hashes = {name: hash_of(**{name: value}, **usual.get(name, {})) for name, value in CHANGED.items()}
    assert len({*hashes.values(), hash_of()}) == len(CHANGED) + 1


def test_the_agent_the_seed_and_code_of_ones_own_are_in_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    source = tmp_path / "my_agent.py"
    words = "from rcs.agents import Agent\n" + inspect.getsource(Stay).replace("Any", "object")
    source.write_text(f"from __future__ import annotations\n{words}")
    out = tmp_path / "out"
    assert len(run(agent="my_agent:Stay", out=out, episodes=1).attempts) == 1
    again = run(agent="my_agent:Stay", out=out, episodes=1)
    assert (again.found, len(again.attempts)) == (1, 1)
    source.write_text(f"{source.read_text()}\n# a change\n")
    assert run(agent="my_agent:Stay", out=out, episodes=1).found == 0
    assert run(agent="my_agent:Stay", out=out, episodes=1, seed=1).found == 0
    assert len(Ledger(out).rows) == 3


def test_the_model_of_a_robot_of_ones_own_is_in_the_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = Path(__file__).parents[2] / "examples" / "06_own_robot" / "src" / "my_robot"
    package = shutil.copytree(example, tmp_path / "copied_robot", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.syspath_prepend(str(tmp_path))
    evaluation = Evaluation(setup=rcs.Setup(task="Free", robot="copied_robot.description:MY_ROBOT"), agent=Stay)

    def hash_of() -> str:
        return condition_of(evaluation, identity_of(Stay, "Free")).hash

    hashes = [hash_of(), hash_of()]
    for name, change in (("my_robot.xml", "<!-- a change -->"), ("description.py", "# a change")):
        path = package / name
        path.write_text(f"{path.read_text()}\n{change}\n")
        hashes.append(hash_of())
    assert hashes[0] == hashes[1]
    assert len(set(hashes)) == 3


def test_another_calibration_in_the_same_file_is_another_condition(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    evaluation = Evaluation(setup=replace(SETUP, cameras=rcs.Cameras(("side",), calibration=str(path))))
    usual = Path(labs.__file__).with_name("fr3_cameras.json").read_text()
    hashes = set[str]()
    for text in (usual, f"{usual}\n", usual):
        path.write_text(text)
        hashes.add(condition_of(evaluation, identity_of(None, "PickCuboid")).hash)
    assert len(hashes) == 2


def test_another_site_is_another_condition_and_a_camera_that_is_not_used_is_none() -> None:
    evaluation = Evaluation(setup=rcs.Setup(task="Free", frequency=30.0), agent=Stay)

    def hash_of(address: str = "192.0.2.1", **others: Any) -> str:
        site = rcs.Site(arms={"fr3": f"fake:{address}"}, grippers={"fr3": "fake:a"}, **others)
        with rcs.make(evaluation.setup, hardware=site) as env:
            return condition_of(evaluation, identity_of(Stay, "Free"), env).hash

    assert hash_of() == hash_of() == hash_of(cameras={"wrist": "fake:b"})
    assert len({hash_of(), hash_of("192.0.2.2"), hash_of(stale_after=1.0)}) == 3


def test_a_film_of_an_episode_that_a_person_judged_is_compared_by_what_was_done(tmp_path: Path) -> None:
    summary = Summary()
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=2, out=tmp_path)
    answers = iter([True, None])
    list(evaluate(evaluation, summary, env=rcs.make(SETUP), judge=lambda observation, info: next(answers)))
    judged = list(Ledger(tmp_path).rows.values())
    assert [row.judge for row in judged] == ["person", "nobody"]
    again = run().results
    for row, result in zip(judged, again, strict=False):
        assert not differs(row, result)
        assert differs(row, replace(result, steps=result.steps + 1))


def test_an_evaluation_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run(out=whole, episodes=5)
    summary = Summary()
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=5, out=parts)
    for _ in evaluate(evaluation, summary):
        summary.is_interrupted = len(summary.attempts) == 2
    assert len(Ledger(parts).rows) == 2
    summary = Summary()
    assert len(list(evaluate(evaluation, summary))) == 3
    assert (summary.found, len(summary.results)) == (2, 5)
    assert rows_of(parts) == rows_of(whole)


def test_repetitions_are_run_and_counted_apart(tmp_path: Path) -> None:
    run(out=tmp_path, episodes=2)
    summary = run(out=tmp_path, episodes=2, repeat=2)
    assert (summary.found, len(summary.attempts)) == (2, 6)
    assert (summary.judged, len(summary.results), summary.interval) == (2, 2, wilson_interval(0, 2))
    assert (len(summary.repetitions), summary.changed) == (4, 0)
    one = next(attempt for attempt in summary.attempts if attempt.number == 5)
    summary.attempts.remove(one)
    summary.attempts.append(replace(one, result=replace(one.result, success=True, failure=None)))
    assert (summary.successes, summary.changed) == (0, 1)
    page = io.StringIO()
    Console(width=120, file=page).print(results_table(summary, 1.0, 1))
    told = " ".join(page.getvalue().split())
    assert "0 of 2 = 0.0 %" in told and "4 repeated, 1 ended differently" in told
    ledger = Ledger(tmp_path)
    assert [row.repeat for row in ledger.rows.values()] == [0, 0, 1, 1, 2, 2]
    assert len({row.seed for row in ledger.rows.values()}) == 2


@pytest.mark.slow
def test_two_agents_and_four_processes_lose_and_overwrite_nothing(tmp_path: Path) -> None:
    together = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from staying import SETUP, Stay
from rcs.rollout import Evaluation, evaluate
name, out = sys.argv[1], Path({str(tmp_path / "together")!r})
agent = Stay if name == "idle" else "PickExpert"
list(evaluate(Evaluation(setup=SETUP, agent=agent, episodes=12, out=out, name=name)))
"""
    processes = [
        subprocess.Popen([sys.executable, "-c", together, name]) for name in ("idle", "expert", "idle", "expert")
    ]
    assert [process.wait(120) for process in processes] == [0] * 4
    ledger = Ledger(tmp_path / "together")
    assert ledger.damage == []
    assert len(ledger.rows) == 24
    for name in ("idle", "expert"):
        assert len({row.seed for row in ledger.of(ledger.find(name))}) == 12


class Fickle(Stay):
    """Has other weights from its third episode on."""

    episodes = 0

    def reset(self, observation: Any, info: Any) -> None:
        self.episodes += 1

    @property
    def weights(self) -> str:
        return "new" if self.episodes > 2 else "old"


def test_weights_that_change_end_the_evaluation(tmp_path: Path) -> None:
    env = rcs.make(SETUP)
    summary = Summary()
    with pytest.raises(RcsError, match=r"weights of Fickle changed .* from old to new\. Episode 2 is left out"):
        list(evaluate(Evaluation(setup=SETUP, agent=Fickle(env), out=tmp_path), summary, env=env))
    assert [row.weights for row in Ledger(tmp_path).rows.values()] == ["old", "old"]
    assert len(summary.attempts) == 2


class Lost(Stay):
    """Loses the connection to its policy in its second episode."""

    episodes = 0
    failure, failure_message = "policy", "ConnectionLost: gone"

    def reset(self, observation: Any, info: Any) -> None:
        self.episodes += 1

    @property
    def is_lost(self) -> bool:
        return self.episodes == 2


def test_an_episode_in_which_the_policy_was_lost_has_neither_row_nor_recording(tmp_path: Path) -> None:
    env = rcs.make(SETUP)
    evaluation = Evaluation(setup=SETUP, agent=Lost(env), episodes=3, out=tmp_path / "ledger")
    with DatasetWriter.open(tmp_path / "data", dataset_info(env)) as writer:
        env.add_observer(recorder := Recorder(writer))
        with pytest.raises(RcsError, match=r"The policy was lost: ConnectionLost: gone\. Episode 1 is left out"):
            list(evaluate(evaluation, env=env, recorder=recorder))
    assert len(Ledger(tmp_path / "ledger").rows) == 1
    assert [episode.outcome["attempt"] for episode in Dataset.open(tmp_path / "data")] == [0]


def test_objects_are_not_placed_by_the_robot_between_episodes() -> None:
    with pytest.raises(InvalidSetup, match=r"only a collection does.*Use placed_by='reset'"):
        Evaluation(setup=replace(SETUP, task_options={"placed_by": "robot"}))


@pytest.mark.parametrize(
    "options", [{"until": 0.05}, {"against": "a"}, {"until": 2.0, "against": "a", "out": Path("x")}]
)
def test_an_early_end_needs_a_level_another_agent_and_a_ledger(options: Any) -> None:
    with pytest.raises(InvalidSetup, match="until"):
        Evaluation(setup=SETUP, **options)


@pytest.mark.gl
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_failures_are_filmed_first_and_end_as_they_did(tmp_path: Path, workers: int) -> None:
    setup = rcs.Setup(task="PickCuboid", max_episode_steps=88)  # enough for some of the episodes
    evaluation = Evaluation(setup=setup, episodes=4, workers=workers, out=tmp_path)
    list(evaluate(evaluation))
    verdicts = [row.success for row in Ledger(tmp_path).rows.values()]
    most = verdicts.count(False) + 1
    made = list(film(evaluation, most))
    assert len(made) == min(most, 4)
    assert not any(differs(row, result) for row, result in made)
    filmed = [row.success for row in Ledger(tmp_path).rows.values() if Ledger(tmp_path).film(row).is_file()]
    assert filmed.count(False) == verdicts.count(False)
    assert sorted(path.suffix for path in (tmp_path / "films").iterdir()) == [".mp4"] * len(made)
    assert list(film(evaluation, most)) == [], "films that are there are not made again"


@pytest.mark.gl
def test_a_film_that_another_process_makes_is_left_to_it(tmp_path: Path) -> None:
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=2, out=tmp_path)
    list(evaluate(evaluation))
    first, second = Ledger(tmp_path).rows.values()
    with claimed(tmp_path, f"film of {first.name}"):
        assert [row.name for row, _ in film(evaluation, 2)] == [second.name]
    assert [row.name for row, _ in film(evaluation, 2)] == [first.name]
    assert all(Ledger(tmp_path).film(row).is_file() for row in (first, second))


class Dice(Stay):
    """Acts otherwise in every process."""

    def act(self, observation: Any, info: Any) -> Any:
        self._action["joints"][:] = 0.01 * ((time.time_ns() % 7) - 3)
        return self._action


@pytest.mark.gl
def test_a_film_of_another_outcome_is_told_and_removed(tmp_path: Path) -> None:
    evaluation = Evaluation(setup=SETUP, agent=Dice, episodes=2, out=tmp_path)
    list(evaluate(evaluation))
    made = list(film(evaluation, 2))
    different = [row for row, result in made if differs(row, result)]
    assert different, "its reward differs"
    assert not any(Ledger(tmp_path).film(row).exists() for row in different)


def test_real_devices_alone_have_no_film(tmp_path: Path) -> None:
    env = rcs.make("Free", hardware="fake")
    with pytest.raises(InvalidSetup, match="no picture to film"):
        Evaluator(Evaluation(setup=env.setup, agent=Stay), films=tmp_path, env=env)
