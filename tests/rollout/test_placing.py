"""The robot sets the cuboid down where the next episode begins: in simulation, and on fakes with a person."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.agents import Agent, agent_for
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs import Action, Observation
from rcs.errors import InvalidSetup
from rcs.hardware import FakeDriver, Site
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress, seed_of
from rcs.rollout.episode import run_episode
from rcs.rollout.placing import Placer, PlacesInSimulation, Poses, SeededScene, offset
from rcs.rollout.reexecute import reexecute
from rcs.rollout.replay import replay
from rcs.sim.randomisation import Randomisation
from rcs.spatial import Pose

SETUP = rcs.Setup(task_options={"placed_by": "robot"})


def run(collection: Collection) -> Progress:
    progress = Progress()
    for _ in collect(collection, progress):
        pass
    return progress


def test_after_a_success_the_next_episode_begins_where_the_robot_has_set_the_cuboid_down(tmp_path: Path) -> None:
    collection = Collection(setup=SETUP, out=tmp_path / "data", episodes=2, seed=3)
    assert run(collection).kept == 2
    first, *others = Dataset.open(collection.out).episodes
    assert first.outcome["placed"] == {"by": "reset", "why": "no success before"}
    scene = SeededScene(SETUP)
    for number, episode in enumerate(others, start=1):
        placed, pose = episode.outcome["placed"], np.array(episode.outcome["objects"]["cuboid"])
        assert episode.success and placed["by"] == "robot"
        off, angle = offset(scene.poses(collection.seed_of(number))["cuboid"], pose)
        assert (placed["off_mm"], placed["off_deg"]) == pytest.approx((1e3 * off, np.rad2deg(angle)), abs=1e-6)
        assert 0.0 < placed["off_mm"] < 3.0 and placed["off_deg"] < 2.0
        assert pose[2] == pytest.approx(0.0288, abs=1e-4)  # it lies on the table
    assert all(result.is_equal for result in replay(collection.out))
    again = list(reexecute(collection.out, tmp_path / "again", kind="states"))
    assert [result.success for result in again] == [True, True]
    for one, two in zip(Dataset.open(collection.out), Dataset.open(tmp_path / "again"), strict=True):
        np.testing.assert_allclose(two.outcome["objects"]["cuboid"], one.outcome["objects"]["cuboid"], atol=1e-9)


def test_a_resumed_collection_begins_with_a_reset(tmp_path: Path) -> None:
    collection = Collection(setup=SETUP, out=tmp_path / "data", episodes=1)
    run(collection)
    run(dataclasses.replace(collection, episodes=2))
    assert [episode.outcome["placed"]["by"] for episode in Dataset.open(collection.out)] == ["reset", "reset"]


def test_an_arm_that_cannot_follow_its_way_for_a_step_has_set_the_cuboid_down_all_the_same() -> None:
    with rcs.make(SETUP) as env:
        places = PlacesInSimulation(env)
        assert run_episode(env, agent_for(env), seed=seed_of(3, 110)).success
        places.is_held = True
        assert places.next(seed_of(3, 111))[1]["by"] == "robot"
        places.close()


def test_a_cuboid_that_slips_in_the_gripper_on_the_way_is_not_pressed_onto_the_table() -> None:
    # From here the arm swings its elbow round, and the cuboid sinks by 2.5 mm; pressing it down was a collision.
    start = [0.47730, -0.00987, 0.02878, 0.0, 0.0, -0.61502, 0.78851]
    with rcs.make(SETUP) as env, contextlib.closing(PlacesInSimulation(env)) as places:
        result = run_episode(env, agent_for(env), seed=1214854204, options={"objects": {"cuboid": np.array(start)}})
        assert result.success
        places.is_held = True
        _, placed = places.next(4269347463)
    assert placed["by"] == "robot", placed
    assert placed["off_mm"] < 3.0


def test_the_robot_places_among_the_distractors_of_the_last_episode_and_as_late_as_there() -> None:
    varied = Randomisation.off(action_latency=(0.0, 0.05), distractors=2, joint_damping=(0.8, 1.25))
    setup = dataclasses.replace(SETUP, randomisation=varied)
    with rcs.make(setup) as env, contextlib.closing(PlacesInSimulation(env)) as places:
        env.reset(seed=5)
        places.is_held = True
        _, placed = places.next(7)
        assert placed["by"] == "reset"  # the gripper was empty
        for field in ("geom_size", "actuator_delay"):
            there, here = (one.simulation.world.field(field) for one in (places._apart, env))
            np.testing.assert_array_equal(there, here)


class FarFirst(SeededScene):
    """A scene of whose poses at a seed the first ones are out of reach."""

    far = 1

    def poses(self, seed: int, number: int = 0) -> Poses:
        found = super().poses(seed, number)
        return {name: pose + [1.5, 0, 0, 0, 0, 0, 0] for name, pose in found.items()} if number < self.far else found


@pytest.mark.parametrize("far", [1, 1000])
def test_a_pose_out_of_reach_is_told_and_the_next_one_of_the_seed_counts(
    far: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.rollout.placing.SeededScene", FarFirst)
    monkeypatch.setattr(FarFirst, "far", far)
    with rcs.make(SETUP) as env:
        places = PlacesInSimulation(env)
        assert run_episode(env, agent_for(env), seed=0).success
        places.is_held = True
        options, told = places.next(7)
        nearest = SeededScene(SETUP).poses(7, 1)["cuboid"]
        if far == 1:
            assert told["by"] == "robot" and len(told["out_of_reach"]) == 1
            assert options is not None
            off, angle = offset(nearest, options["objects"]["cuboid"])
            assert off < 0.003 and angle < np.deg2rad(2.0)
        else:
            assert options is None
            assert (told["by"], told["why"], len(told["out_of_reach"])) == ("reset", "out_of_reach", 16)
        places.close()


def test_a_cuboid_that_lies_too_far_off_is_placed_by_the_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.rollout.placing.ASTRAY", (1e-6, 1.0))
    with rcs.make(SETUP) as env:
        places = PlacesInSimulation(env)
        assert run_episode(env, agent_for(env), seed=0).success
        places.is_held = True
        options, told = places.next(7)
        assert options is None
        assert told["by"] == "reset" and "mm and" in told["why"]
        places.close()


def test_half_a_turn_of_a_cuboid_does_not_count() -> None:
    pose = np.array([0.4, 0.1, 0.03, 0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    turned = (Pose.from_tquat(pose) * Pose.from_rpy((0.001, 0.0, 0.0), (0.0, 0.0, np.pi - 0.02))).tquat
    assert offset(pose, turned) == pytest.approx((0.001, 0.02))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"workers": 2}, "begins where the one before ended; workers is 2"),
        ({"setup": dataclasses.replace(SETUP, robot="so101")}, "an arm with 5 joints"),
        ({"setup": dataclasses.replace(SETUP, randomisation="default")}, "object_size of the randomisation"),
    ],
)
def test_collections_that_no_robot_can_place_for_are_refused(tmp_path: Path, changes: Any, match: str) -> None:
    with pytest.raises(InvalidSetup, match=match):
        Collection(**{"setup": SETUP, "out": tmp_path, **changes})


def test_a_task_without_a_placer_is_refused() -> None:
    setup = rcs.Setup(task="Place")
    with rcs.make(setup) as env, pytest.raises(InvalidSetup, match="names no placer"):
        Placer(env, SeededScene(setup))


class Filled(FakeGripper):
    """Closes on something."""

    def _command_opening(self, opening: float, force: float | None) -> None:
        super()._command_opening(max(opening, 0.4), force)


class Holding(FakeDriver):
    """Makes grippers with something between their jaws."""

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FakeGripper:
        return Filled(max_width=about.max_width, max_force=about.max_force, name=address or about.name)


class Grasp(Agent):
    """Closes the gripper at once, and keeps what it is told at the start."""

    told: list[Mapping[str, Any]] = []

    def __init__(self, env: rcs.envs.Env) -> None:
        self._steps = 0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self._steps, self._target = 0, np.array(observation["joints"])
        self.told.append(info)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        self._steps += 1
        return {"joints": self._target, "gripper": np.zeros(1)}

    def events(self):
        return ("stop",) if self._steps >= 10 else ()


def on_devices(driver: str, folder: Path) -> Collection:
    place = f"{__name__}:{driver}:192.0.2.1"
    return Collection(
        setup=dataclasses.replace(SETUP, relative="absolute"),
        out=folder / "data",
        episodes=2,
        agent=Grasp,
        hardware=Site(arms={"fr3": place}, grippers={"fr3": place}, arm_stale_after=60.0),
        home_speed=1.0,
    )


@pytest.mark.parametrize("lies_there", [True, False])
def test_on_devices_a_person_says_whether_it_lies_there(
    lies_there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["yes", "", "y", *(["y"] if lies_there else ["n", ""]), "n"])
    questions = list[str]()
    monkeypatch.setattr("builtins.input", lambda question: (questions.append(question), next(answers))[1])
    monkeypatch.setattr(Grasp, "told", [])
    collection = on_devices("Holding", tmp_path)
    run(collection)
    assert next(answers, None) is None
    asked = [question for question in questions if question.startswith("The robot has put the cuboid at")]
    assert len(asked) == 1
    one, two = Dataset.open(collection.out).episodes
    assert one.outcome["placed"]["by"] == "reset"
    wanted = SeededScene(SETUP).poses(collection.seed_of(1))["cuboid"]
    placed, pose = two.outcome["placed"], two.outcome["objects"]["cuboid"]
    assert (placed["by"] == "robot") is lies_there
    off, angle = offset(wanted, np.array(pose))
    assert (0.0 < off < 0.003 and angle < np.deg2rad(2.0)) if lies_there else off == 0.0
    np.testing.assert_allclose(Grasp.told[1]["cuboid"], pose, atol=1e-6)
    np.testing.assert_allclose(two.column("observation/joints")[0], rcs.robots.FR3.home, atol=2e-3)


class Kept(Holding):
    """Keeps its arms."""

    arms: list[FakeArm] = []

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        self.arms.append(super().arm(address, about, options))
        return self.arms[-1]


def test_a_fault_after_a_success_is_asked_about_and_the_person_places_the_cuboid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Kept, "arms", [])
    answers, questions = iter(["yes", "", "y", "y", "yes", "", "n"]), list[str]()

    def answer(question: str) -> str:
        questions.append(question)
        if len(questions) == 3:  # whether the task was done
            Kept.arms[0].trip("the elbow has had enough")
        return next(answers)

    monkeypatch.setattr("builtins.input", answer)
    collection = on_devices("Kept", tmp_path)
    assert run(collection).kept == 2
    assert "the elbow has had enough" in questions[3] and "Put the cuboid" in questions[5]
    placed = [episode.outcome["placed"] for episode in Dataset.open(collection.out).episodes]
    assert placed[1] == {"by": "reset", "why": "fault"}
