"""Simulators of other projects, each in its own environment, with scripted policies over the wire."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import Metadata, Observation, PartSpec, Server
from vlagents.policies.scripted import ScriptedPolicy

from rcs.errors import InvalidSetup, RcsError
from rcs.policy import Execution, ServedPolicy
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.foreign import ForeignEnv, ForeignSimulator
from rcs.rollout.serving import serving

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
import scripted_actions  # noqa: E402  beside this file

pytestmark = pytest.mark.interop
ENVIRONMENTS = Path(os.environ.get("VLAGENTS_ENVIRONMENTS", HERE.parents[2] / "build" / "interop"))


def python_of(name: str) -> Path:
    """Return the Python of an environment that `make sims` makes, or skip the test."""
    path = ENVIRONMENTS / name / "bin" / "python"
    if not (path.parent.parent / ".stamp").is_file():
        pytest.skip(f"there is no {path}; `make sims` makes it")
    has_driver = (path.parent.parent / "vulkan/lvp_icd.json").is_file() or "VK_ICD_FILENAMES" in os.environ
    if name == "maniskill" and not has_driver:
        pytest.skip("there is no Vulkan driver for ManiSkill; `make sims` says why, or VK_ICD_FILENAMES names one")
    return path


def simulator(task: str, folder: Path, **options: str) -> ForeignSimulator:
    python = python_of(task.partition(":")[0])
    return ForeignSimulator(name=task, python=python, options=options, log=folder / "log", timeout=300)


def three(simulator: ForeignSimulator, address: str) -> list[EpisodeResult]:
    policy, summary = ServedPolicy(address=address, execution=Execution(mode="open_loop"), timeout=60), Summary()
    env = ForeignEnv(simulator)
    evaluation = Evaluation(setup=env.setup, simulator=simulator, agent=policy, episodes=3, seed=2)
    for _ in evaluate(evaluation, summary, env=env):
        pass
    return summary.results


@contextmanager
def served(act: Callable[[Observation, str], Any], rate: float, *objects: str) -> Iterator[str]:
    with Server(ScriptedPolicy(act, scripted_actions.metadata(act.__name__, rate, *objects)), port=0) as server:
        yield str(server.address)


def rows(simulator: ForeignSimulator, seed: int, steps: int = 12) -> bytes:
    """Return all that is observed in an episode of drawn actions."""
    random, found = np.random.default_rng(0), []
    with ForeignEnv(simulator) as env:
        for _ in range(2):
            observation, _ = env.reset(seed)
            seen = [observation]
            for _ in range(steps):
                action = {
                    name: random.uniform(box.low, box.high).astype(box.dtype)
                    for name, box in env.action_space.spaces.items()
                }
                seen.append(env.step(action)[0])
            found.append(
                b"".join(np.asarray(one[key]).tobytes() for one in seen for key in sorted(one) if key != "frames")
            )
            found[-1] += b"".join(own["rgb"].tobytes() for one in seen for own in one.get("frames", {}).values())
            random = np.random.default_rng(0)
    assert found[0] == found[1]
    return found[0]


def show(task: str, results: list[EpisodeResult]) -> None:
    for one in results:
        print(
            f"{task} seed {one.seed}: success {one.success}, {one.steps} steps, reward {one.reward:.3f} {one.message}"
        )


def test_metaworld_pick_place_succeeds_with_its_own_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = simulator("metaworld:pick-place-v3", tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    # The checkpoint is the name of the policy's task.
    command = f"{task.python} -m vlagents.cli serve sawyer:make --checkpoint {{checkpoint}} --port {{port}}"
    with serving(command, Path("pick-place"), tmp_path / "policy.log") as address:
        results = three(task, address)
        show(task.name, results)
        assert [one.success for one in results] == [True] * 3
        assert three(task, address) == results
    assert rows(task, 5) != rows(task, 6)


@pytest.mark.parametrize(
    ("task", "act", "objects"),
    [
        ("PickCube-v1", scripted_actions.pick_cube, ("obj/tquat", "goal_pos")),
        ("StackCube-v1", scripted_actions.stack_cube, ("cubeA/tquat", "cubeB/tquat")),
    ],
)
def test_maniskill_with_state_and_pictures(task: str, act: Any, objects: tuple[str, ...], tmp_path: Path) -> None:
    by_state = simulator(f"maniskill:{task}", tmp_path)
    with served(act, 20.0, *objects) as address:
        results = three(by_state, address)
        show(by_state.name, results)
        assert [one.success for one in results] == [True] * 3
        assert three(by_state, address) == results
    by_pictures = simulator(f"maniskill:{task}", tmp_path, images="true")
    assert rows(by_pictures, 5) != rows(by_pictures, 6)


@pytest.mark.parametrize("number", [0, 5])
def test_libero_with_state_and_pictures(number: int, tmp_path: Path) -> None:
    by_state = simulator(f"libero:libero_object/{number}", tmp_path, images="false")
    thing = {0: "alphabet_soup_1", 5: "tomato_sauce_1"}[number]
    with served(scripted_actions.put_into_basket, 20.0, f"{thing}/tquat", "basket_1/tquat") as address:
        results = three(by_state, address)
        show(by_state.name, results)
        assert [one.success for one in results] == [True] * 3
        assert three(by_state, address) == results
    by_pictures = simulator(f"libero:libero_spatial/{number}", tmp_path, size="64")
    assert rows(by_pictures, 5, steps=3) != rows(by_pictures, 6, steps=3)


@pytest.mark.parametrize(
    ("name", "wrong", "known"),
    [
        ("metaworld", "pick-v3", "pick-place-v3"),
        ("maniskill", "PickCubes-v1", "'PickCube-v1'?"),
        ("libero", "libero_spatial/10", "libero_spatial/0 … libero_spatial/9"),
        ("libero", "libero/0", "libero_spatial, libero_object"),
    ],
)
def test_unknown_tasks_list_the_known_ones(name: str, wrong: str, known: str, tmp_path: Path) -> None:
    with pytest.raises(RcsError) as caught:
        ForeignEnv(simulator(f"{name}:{wrong}", tmp_path))
    assert known in str(caught.value)


def test_a_policy_of_another_gripper_is_converted_and_of_another_arm_refused(tmp_path: Path) -> None:
    task = simulator("maniskill:PickCube-v1", tmp_path)
    arm, grip = PartSpec("joints", 7, "rad"), PartSpec("gripper", 1, "-1 open, 1 closed")
    with ForeignEnv(task) as env:
        for action, fits in (((scripted_actions.ARM[0], grip), True), ((arm, grip), False)):
            with Server(ScriptedPolicy(lambda *_: np.zeros(7), Metadata("m", action, rate=20.0)), port=0) as server:
                if fits:
                    ServedPolicy(address=str(server.address))(env).close()
                    continue
                with pytest.raises(InvalidSetup, match=r"(?s)gives 'joints'.*takes 'xyzrpy'"):
                    ServedPolicy(address=str(server.address))(env)


def test_missing_assets_of_libero_are_told(tmp_path: Path) -> None:
    with pytest.raises(RcsError, match="never downloaded"):
        ForeignEnv(simulator("libero:libero_object/0", tmp_path, assets=str(tmp_path)))
