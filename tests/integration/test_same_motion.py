"""An episode of a seed is the one that it was: scene, start, motion and reward, of every task and kind of agent.

If a change is meant, `python tests/integration/test_same_motion.py` writes the new figures.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("same_motion.json")
SEED = 3
EARLY = 20
"""Steps in which nothing is touched yet: up to here, all machines agree in more digits."""
FIELDS = (
    "body_mass", "body_inertia", "body_pos", "jnt_range", "dof_damping", "dof_armature", "geom_type", "geom_size",
    "geom_pos", "geom_friction", "geom_solref", "geom_solimp", "geom_margin", "geom_contype", "geom_conaffinity",
    "geom_group", "geom_rgba", "mat_rgba", "mat_specular", "mat_texrepeat", "tex_data", "light_pos", "light_dir",
    "light_diffuse", "light_ambient", "light_specular", "cam_pos", "cam_quat", "cam_fovy", "cam_intrinsic",
    "actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "actuator_ctrlrange", "site_pos", "eq_solref",
)  # fmt: skip
"""Fields of the model that are compared, each as one number."""


def setups() -> dict[str, dict[str, Any]]:
    """Return the options of the tool that compares the bits of two checkouts, by task and robot."""
    spec = importlib.util.spec_from_file_location("same_bits", ROOT / "tools" / "same_bits.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.SETUPS


SOFT = rcs.Compliance(tcp=(500, 30))
SEEN = {"layers": ("ObserveTarget",), "observe": ("privileged", "contacts")}
SETUPS: dict[str, dict[str, Any]] = {
    **setups(),
    "PickCuboid:fr3:PickTeacher": {**SEEN, "reward": "sparse", "task_options": {"obstacles": 2}},
    "Place:fr3:PlaceTeacher": SEEN,
    "Free:ur5e:chance": {"control": "xyzrpy", "layers": ("KeepTilt", "ObserveTarget"), "frequency": 10.0},
    "Free:so101:chance": {"control": "xyzrpy", "layers": ("BoundLead", "DisturbActions"), "binary_gripper": False},
    "Free:fr3:chance": {"control": "tquat", "relative": "origin", "compliance": SOFT},
    "Free:dual_fr3:chance": {"control": "twist", "gates": ("Guard",)},
}
"""The agents of the last ones are named; without a name it is the expert, and `chance` acts at random."""


class Chance:
    """Draw actions, the same ones each time."""

    def __init__(self, env: Any) -> None:
        self._space = env.action_space

    def reset(self, observation: Any, info: Any) -> None:
        self._space.seed(SEED)

    def act(self, observation: Any, info: Any) -> Any:
        return self._space.sample()


def number(values: Any) -> float:
    """Return one number that changes with any of some."""
    flat = np.asarray(values, np.float64).reshape(-1)
    return float(flat @ np.cos(np.arange(flat.size)))


def numbers(observation: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    """Give a number for each array of an observation, with its path."""
    for key, value in observation.items():
        if isinstance(value, Mapping):
            yield from numbers(value, f"{above}{key}/")
        else:
            yield f"{above}{key}", number(value)


def motion(name: str) -> dict[str, dict[str, float]]:
    """Return the figures of an episode: of the model, the first observation, an early one, and the end."""
    task, robot, *agents = name.split(":")
    with rcs.make(task, robot=robot, max_episode_steps=200, **SETUPS[name]) as env:
        agent: Any = Chance(env) if agents == ["chance"] else agent_for(env, *agents)
        observation, info = env.reset(seed=SEED)
        agent.reset(observation, info)
        model = env.simulation.world.model
        found = {
            "model": {field: number(getattr(model, field)) for field in FIELDS},
            "start": dict(numbers(observation)),
        }
        total, steps, is_over = 0.0, 0, False
        while not is_over and (agents != ["chance"] or steps < 3 * EARLY):
            observation, reward, terminated, truncated, info = env.step(agent.act(observation, info))
            total, steps, is_over = total + float(reward), steps + 1, terminated or truncated
            if steps == EARLY:
                found["early"] = dict(numbers(observation))
        return {**found, "end": {"return": total, "steps": steps, "success": float(info.get("success", 0.0))}}


@pytest.mark.parametrize("name", SETUPS)
def test_an_episode_of_a_seed_is_the_one_that_it_was(name: str) -> None:
    was, found = json.loads(FILE.read_text())[name], motion(name)
    for part, tolerance in (("model", 1e-6), ("start", 1e-6), ("early", 1e-5), ("end", 5e-2)):
        assert found[part] == pytest.approx(was[part], rel=tolerance, abs=tolerance), f"{part}: see {__file__}"


if __name__ == "__main__":
    lines = (f"{json.dumps(name)}: {json.dumps(motion(name))}" for name in SETUPS)
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
