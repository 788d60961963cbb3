"""vla-eval, from the package index, evaluates a policy that is served here."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import ImageSpec, Metadata, Observation, PartSpec
from vlagents.other_wires.vla_eval import VlaEvalServer
from vlagents.policies.scripted import ScriptedPolicy

pytestmark = pytest.mark.interop
PROJECT = Path(__file__).parents[3]
ENVIRONMENTS = Path(os.environ.get("VLAGENTS_ENVIRONMENTS", PROJECT / "build" / "interop"))


def evaluated(
    environment: str, name: str, folder: Path, act: Callable[[Observation, str], Any], needs: Metadata
) -> Any:
    """Return the tasks of the result of vla-eval, or skip the test."""
    python = ENVIRONMENTS / environment / "bin" / "python"
    if not (python.parent.parent / ".stamp").is_file():
        pytest.skip(f"there is no {python}; `make sims` makes it")
    with VlaEvalServer(ScriptedPolicy(act, needs), port=0) as server:
        words = [str(python), str(PROJECT / "tests/interop/vla_eval_client.py"), str(server.address), str(folder), name]
        done = subprocess.run(words, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    (result,) = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(result))
    return result["tasks"]


def test_its_harness_evaluates_a_policy_of_ours(tmp_path: Path) -> None:
    seen: set[str] = set()

    def act(observation: Observation, instruction: str) -> Any:
        seen.add(instruction)
        assert tuple(observation.image("front")[0, 0]) == (200, 100, 50), "a PNG loses nothing"
        at, goal = np.split(observation.state["states"], 2)
        if instruction == "reach down":
            return np.zeros((2, 3))
        step = np.clip(goal - at, -0.1, 0.1)
        return np.array([step, np.clip(goal - at - step, -0.1, 0.1)])

    images, state = (ImageSpec("front", 32, 48),), (PartSpec("states", 6),)
    needs = Metadata("reacher", action=(PartSpec("raw", 3),), images=images, state=state, horizon=2, rate=10.0)
    tasks = evaluated("vla-eval", "reach", tmp_path / "results", act, needs)
    found = {task["task"]: [(one["metrics"]["success"], one["steps"]) for one in task["episodes"]] for task in tasks}
    assert found == {"reach up": [(True, 3)] * 3, "reach down": [(False, 20)] * 3}
    assert seen == {"reach up", "reach down"}


def test_its_benchmark_of_libero_runs_a_policy_of_ours(tmp_path: Path) -> None:
    heights: list[float] = []

    def act(observation: Observation, instruction: str) -> Any:
        assert instruction == "pick up the alphabet soup and place it in the basket"
        assert {observation.image(name).shape for name in ("agentview", "wrist")} == {(256, 256, 3)}
        heights.append(float(observation.state["states"][2]))
        return np.array([0.0, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0])

    images, state = (ImageSpec("agentview", 256, 256), ImageSpec("wrist", 256, 256)), (PartSpec("states", 8),)
    needs = Metadata("down", action=(PartSpec("raw", 7),), images=images, state=state, rate=20.0)
    (task,) = evaluated("libero", "libero", tmp_path / "results", act, needs)
    assert [(one["metrics"]["success"], one["steps"]) for one in task["episodes"]] == [(False, 6)]
    assert heights == sorted(heights, reverse=True)
    assert heights[0] - heights[-1] > 0.02, "the arm went down"
