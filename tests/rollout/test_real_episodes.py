"""Collections on real devices, here fakes: a person agrees, places the objects, judges, and sees to faults."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.agents import Agent, agent_for
from rcs.agents.script import Script
from rcs.devices.fakes import FakeArm
from rcs.envs import Action, Gate, Observation
from rcs.errors import DeviceFault, InvalidSetup, RcsError, Refused
from rcs.hardware import FakeDriver, Site
from rcs.robots.description import ArmDescription
from rcs.robots.fr3 import FR3
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.supervisor import VirtualSupervisor, supervisor_of
from rcs.virtual import VirtualProcess

HOME = np.array(FR3.home)
SETUP = rcs.Setup(frequency=30.0, relative="absolute")
made: list[FakeArm] = []


class Elsewhere(FakeDriver):
    """Makes arms that stand somewhere else than at home."""

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        arm = super().arm(address, about, options)
        arm.body.values = arm.body.target = np.array(about.home) - 0.1
        made.append(arm)
        return arm


class Nod(Agent):
    """Moves a joint for a few steps, and keeps what it is told at the start."""

    told: list[Mapping[str, Any]] = []
    trips_in: list[int] = []
    """Episodes, counted from 0, in which a device fails."""
    lost_in: list[int] = []
    """Episodes in which its policy is lost."""

    def __init__(self, env: rcs.envs.Env) -> None:
        pass

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self._steps, self._target = 0, np.array(observation["joints"])
        self.told.append(info)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        self._steps += 1
        if self._steps == 3 and len(self.told) - 1 in self.trips_in:
            made[-1].trip("the elbow has had enough")
        self._target[5] += 0.005
        return {"joints": self._target, "gripper": np.zeros(1)}

    def events(self):
        return ("stop",) if self._steps >= 8 else ()

    failure_message = "ConnectionLost: gone"

    @property
    def is_lost(self) -> bool:
        return len(self.told) - 1 in self.lost_in


class FarEnough(Gate):
    """Ends an episode in the third step of `Nod`; no device is in its fault state then."""

    def admit(self, targets: Mapping[str, Action], measured: Mapping[str, Observation]) -> Mapping[str, Action]:
        if targets[""]["joints"][5] > HOME[5] + 0.012:
            refused = Refused("that is far enough")
            refused.ends_episode = True
            raise refused
        return targets


STOPPED = dataclasses.replace(SETUP, gates={f"{__name__}:FarEnough": {}})


@pytest.fixture(autouse=True)
def clean() -> None:
    made.clear()
    Nod.told, Nod.trips_in, Nod.lost_in = [], [], []


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """Has a person answer, and returns the questions."""

    def answers(*given: str) -> list[str]:
        left, questions = iter(given), list[str]()

        def answer(question: str) -> str:
            questions.append(question)
            try:
                return next(left)
            except StopIteration:
                raise EOFError from None

        monkeypatch.setattr("builtins.input", answer)
        return questions

    return answers


def plan(out: Path, **changes: Any) -> Collection:
    driver = f"{__name__}:Elsewhere:192.0.2.1"
    site = Site(arms={"fr3": driver}, grippers={"fr3": driver}, arm_stale_after=60.0)
    return Collection(
        **{"setup": SETUP, "out": out, "episodes": 2, "agent": Nod, "hardware": site, "home_speed": 1.0, **changes}
    )


def run(collection: Collection) -> Progress:
    progress = Progress()
    for _ in collect(collection, progress):
        pass
    return progress


def place_of(seed: int) -> np.ndarray:
    with rcs.make(SETUP) as env:
        env.reset(seed=seed)
        return env.simulation.object_poses()["cuboid"]


def test_a_person_agrees_once_places_the_object_where_the_seed_has_it_and_judges(tmp_path: Path, say) -> None:
    questions = say("yes", "", "y", "", "n")
    collection = plan(tmp_path / "data")
    progress = run(collection)
    assert (progress.kept, [attempt.result.success for attempt in progress.attempts]) == (2, [True, False])
    motion, first, judged, second, _ = questions
    assert motion.startswith("Before every episode, and now: Move fr3 by up to 0.10 rad")
    assert judged.startswith("Was the task done?")
    assert first != second
    for number, question in enumerate((first, second)):
        x, y, _ = place_of(collection.seed_of(number))[:3]
        assert f"the cuboid at x {x:.3f} m, y {y:.3f} m" in question


def test_every_episode_begins_at_home_and_is_recorded_in_real_time_with_the_objects_places(tmp_path: Path, say) -> None:
    say("yes", "", "y", "", "n")
    collection = plan(tmp_path / "data")
    run(collection)
    episodes = Dataset.open(collection.out).episodes
    assert [episode.success for episode in episodes] == [True, False]
    for number, episode in enumerate(episodes):
        assert episode.seed == collection.seed_of(number)
        np.testing.assert_allclose(episode.column("observation/joints")[0], HOME, atol=1e-3)
        assert episode.column("observation/gripper")[0] == pytest.approx(1.0)
        assert episode.outcome["objects"]["cuboid"] == pytest.approx(list(place_of(episode.seed)))
        assert np.median(np.diff(episode.column("time/monotonic"))) == pytest.approx(1 / 30, rel=0.1)
    for told, episode in zip(Nod.told, episodes, strict=True):
        np.testing.assert_allclose(told["cuboid"], episode.outcome["objects"]["cuboid"], atol=1e-6)
    assert not made[-1].is_open


@pytest.mark.parametrize("answers", [("n",), ()])
def test_without_leave_nothing_moves(tmp_path: Path, say, answers: tuple[str, ...]) -> None:
    say(*answers)
    with pytest.raises(Refused):
        run(plan(tmp_path / "data"))
    np.testing.assert_array_equal(made[-1].body.values, HOME - 0.1)
    assert not made[-1].is_open


@pytest.mark.parametrize("answers", [("yes",), ("yes", "")])
def test_when_the_person_has_gone_the_collection_ends_with_the_devices_closed(tmp_path: Path, say, answers) -> None:
    say(*answers)
    with pytest.raises(Refused, match="run the command at a terminal"):
        run(plan(tmp_path / "data"))
    assert not Dataset.open(tmp_path / "data").episodes
    assert not made[-1].is_open


def test_after_a_fault_the_person_decides_and_the_episode_is_made_again(tmp_path: Path, say) -> None:
    Nod.trips_in = [0]
    questions = say("yes", "", "y", "yes", "", "y", "", "y")
    progress = run(plan(tmp_path / "data"))
    assert "the elbow has had enough" in questions[2]
    assert questions[3].startswith("Before every episode, and now")  # the way may not be what it was
    assert [attempt.number for attempt in progress.attempts] == [0, 1]
    assert [episode.success for episode in Dataset.open(tmp_path / "data").episodes] == [True, True]


def test_a_fault_that_nobody_clears_ends_the_collection_which_goes_on_later(tmp_path: Path, say) -> None:
    Nod.trips_in = [1]
    say("yes", "", "y", "", "n")
    with pytest.raises(DeviceFault, match="the elbow has had enough"):
        run(plan(tmp_path / "data"))
    first, second = Dataset.open(tmp_path / "data").episodes
    assert (first.success, second.success, second.outcome["end"]) == (True, None, "fault")
    assert not made[-1].is_open
    Nod.trips_in = []
    say("yes", "", "n")
    progress = run(plan(tmp_path / "data"))
    assert (progress.found, progress.again, progress.kept) == (1, 1, 2)
    assert [episode.success for episode in Dataset.open(tmp_path / "data").episodes] == [True, False]


def test_an_episode_that_a_gate_ends_is_made_again_only_when_the_person_agrees(tmp_path: Path, say) -> None:
    questions = say("yes", "", "yes", "yes", "", "no")
    with pytest.raises(DeviceFault, match="that is far enough"):
        run(plan(tmp_path / "data", setup=STOPPED))
    assert len(Nod.told) == 2
    assert ["far enough" in question for question in questions] == [False, False, True, False, False, True]
    (episode,) = Dataset.open(tmp_path / "data").episodes
    assert (episode.success, episode.outcome["end"]) == (None, "fault")


@pytest.mark.parametrize(("words", "begun"), [("Put the cuboid", 0), ("far enough", 1)])
def test_an_interruption_before_an_episode_begins_none(
    words: str, begun: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = Progress()

    def answer(question: str) -> str:
        progress.is_interrupted |= words in question
        return "yes"

    monkeypatch.setattr("builtins.input", answer)
    assert list(collect(plan(tmp_path / "data", setup=STOPPED), progress)) == []
    assert len(Nod.told) == begun


def test_an_answer_is_kept_in_the_outcome_under_the_names_of_a_ledger(tmp_path: Path, say) -> None:
    say("yes", "", "n 1 #slip #late out of the left finger")
    run(plan(tmp_path / "data", episodes=1))
    (episode,) = Dataset.open(tmp_path / "data").episodes
    answer = {"failure": "slip", "stages": 1, "tags": ["slip", "late"], "message": "out of the left finger"}
    assert answer.items() <= episode.outcome.items()


def test_an_episode_that_nobody_could_judge_does_not_count(tmp_path: Path, say) -> None:
    say("yes", "", "?")
    assert run(plan(tmp_path / "data", episodes=1)).kept == 0
    say("yes", "", "y")
    progress = run(plan(tmp_path / "data", episodes=1))
    assert (progress.again, progress.kept) == (1, 1)


def test_an_episode_in_which_the_policy_was_lost_is_left_out_and_the_same_goes_on(tmp_path: Path, say) -> None:
    Nod.lost_in = [1]
    say("yes", "", "y", "", "n")
    with pytest.raises(RcsError, match=r"The policy was lost: ConnectionLost: gone\. Episode 1 is left out"):
        run(plan(tmp_path / "data"))
    assert [episode.success for episode in Dataset.open(tmp_path / "data")] == [True]
    say("yes", "", "y")
    progress = run(plan(tmp_path / "data"))
    assert (progress.found, progress.kept) == (1, 2)


def test_more_than_one_process_is_refused(tmp_path: Path) -> None:
    for changes in ({"workers": 2}, {"ray": "auto"}):
        with pytest.raises(InvalidSetup, match="one process of this machine"):
            plan(tmp_path, **changes)


def test_a_script_is_over_when_it_has_held_its_goal_or_given_up() -> None:
    setup = dataclasses.replace(SETUP, task_options={"hold_time": 60.0})
    with rcs.make(setup) as env:
        expert = agent_for(env)
        assert isinstance(expert, Script)
        observation, info = env.reset(seed=0)
        expert.reset(observation, info)
        since: float | None = None
        while not expert.is_over(0.5):
            observation, _, _, truncated, info = env.step(expert.act(observation, info))
            assert not truncated
            since = info["time"] if expert.phase == "hold" and since is None else since
        assert since is not None
        assert info["time"] - since == pytest.approx(0.5, abs=0.1)
        lost = {**info, "cuboid": np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])}
        expert.reset(observation, lost)
        assert (expert.phase, expert.is_over(0.5)) == ("given up", True)


@pytest.fixture(scope="module")
def virtual() -> Iterator[VirtualProcess]:
    with VirtualProcess("so101") as process:
        yield process


def test_the_virtual_robot_at_a_sites_address_places_its_objects_and_judges(virtual: VirtualProcess) -> None:
    supervisor = supervisor_of(rcs.Setup(robot="so101"), virtual.site)
    assert isinstance(supervisor, VirtualSupervisor)
    assert supervisor.name == virtual.name
    assert supervisor.may_move("?")
    assert supervisor.may_recover("a fault of yesterday")
    supervisor.place(5, {})
    assert not supervisor.may_recover("a fault of today")
    with rcs.make("PickCuboid", robot="so101") as env:
        env.reset(seed=5)
        placed = env.simulation.object_poses()["cuboid"]
    seen = supervisor.look({"cuboid": placed + 0.1})
    np.testing.assert_allclose(seen["cuboid"], placed, atol=1e-3)  # it is measured, not believed
    assert supervisor.judge({}, {}) is False
    carried = rcs.Setup(robot="so101", task_options={"placed_by": "robot"})
    assert isinstance(supervisor_of(carried, virtual.site), VirtualSupervisor)


def test_elsewhere_it_is_the_person(virtual: VirtualProcess) -> None:
    setup = rcs.Setup(robot="so101")
    assert not isinstance(supervisor_of(setup, "so101:/dev/ttyACM77"), VirtualSupervisor)
    assert not isinstance(supervisor_of(setup, "fake"), VirtualSupervisor)


def test_a_virtual_robot_with_the_scene_of_another_task_is_refused(virtual: VirtualProcess) -> None:
    for setup in (rcs.Setup(task="Place", robot="so101"), rcs.Setup(robot="so101", task_options={"pose": "flat"})):
        with pytest.raises(InvalidSetup, match="has the scene of PickCuboid, not of"):
            supervisor_of(setup, virtual.site)
