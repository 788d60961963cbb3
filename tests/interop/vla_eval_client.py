"""Evaluates a policy with vla-eval's own harness and its recording: vla_eval_client.py ADDRESS FOLDER NAME.

The benchmark `reach` is vla-eval's interface around a point that is to reach a goal, with images as PNG; `libero` is
vla-eval's own benchmark of LIBERO, for six steps.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from vla_eval import api
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, RAW, DimSpec


class Reach(StepBenchmark):
    """A point moves by an action; the task is done when it is at the goal."""

    def __init__(self, send_state: bool = False) -> None:
        """Show the state if the policy says that it needs it."""
        super().__init__()
        self._send_state = send_state

    def get_tasks(self) -> list[dict[str, Any]]:
        return [{"name": f"reach {way}", "way": way} for way in ("up", "down")]

    def reset(self, task: dict[str, Any]) -> Any:
        assert self._send_state, "the policy's hello asks for the state"
        self._at, self._goal = np.zeros(3), np.array([0.0, 0.0, 0.3 if task["way"] == "up" else -0.3])
        return self._at

    def step(self, action: dict[str, Any]) -> StepResult:
        given = np.asarray(action["actions"])
        assert given.shape == (3,)
        self._at = self._at + given
        is_done = bool(np.linalg.norm(self._at - self._goal) < 1e-3)
        return StepResult(obs=self._at, reward=float(is_done), done=is_done, info={})

    def make_obs(self, raw_obs: Any, task: dict[str, Any]) -> dict[str, Any]:
        image = np.zeros((32, 48, 3), np.uint8)
        image[0, 0] = (200, 100, 50)
        return {
            "images": {"front": image},
            "task_description": task["name"],
            "states": np.concatenate([raw_obs, self._goal]).astype(np.float32),
        }

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        return {"success": step_result.done}

    def get_metadata(self) -> dict[str, Any]:
        return {"max_steps": 20}

    def get_action_spec(self) -> dict[str, DimSpec]:
        return {"raw": RAW}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        return {"front": IMAGE_RGB, "language": LANGUAGE}


if __name__ == "__main__":
    address, folder, name = sys.argv[1:]
    sys.modules["vla_eval_client"] = sys.modules["__main__"]
    benchmark: dict[str, Any] = {"benchmark": "vla_eval_client:Reach", "episodes_per_task": 3}
    if name == "libero":
        from vlagents.simulators.libero import prepare

        prepare()
        benchmark = {"benchmark": "vla_eval.benchmarks.libero.benchmark:LIBEROBenchmark", "episodes_per_task": 1}
        benchmark |= {"max_tasks": 1, "max_steps": 6, "params": {"suite": "libero_object"}}
    results = api.run({"benchmarks": [benchmark]}, server_url=address, output_dir=folder, docker=False)
    print(json.dumps([{"tasks": one["tasks"]} for one in results], default=str))
    assert Path(folder).is_dir()
