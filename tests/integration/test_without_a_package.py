"""A task and an agent of one's own in a script, a notebook or a folder, without a package around them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rcs_data import Dataset

SOURCE = Path(__file__).parents[2] / "examples" / "06_own_robot" / "src" / "my_robot" / "task.py"
RCS = ("-c", "from rcs.cli.main import main; main()")
IN_A_CELL = """

if __name__ == "__main__":
    import rcs
    from rcs.agents import agent_for
    from rcs.envs.layers import Layer
    from rcs.rollout.episode import run_episode

    class Watch(Layer):
        "A layer of the script."

    PushToLine.expert = LineExpert
    env = rcs.make(PushToLine, layers=[Watch])
    print(env.setup.task, *env.setup.layers, run_episode(env, agent_for(env), seed=0).success)
    print(rcs.make_vec(PushToLine, copies=2).reset(seed=0)[1]["block"].shape)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a task and its expert in one file."""
    shutil.copy(SOURCE, tmp_path / "pushing.py")
    return tmp_path


def run(folder: Path, *arguments: str) -> str:
    environment = {**os.environ, "COLUMNS": "200", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, timeout=60, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_classes_of_a_script_are_a_task_an_expert_and_a_layer(folder: Path) -> None:
    with (folder / "pushing.py").open("a") as script:
        script.write(IN_A_CELL)
    told = run(folder, "pushing.py")
    assert "__main__:PushToLine __main__:Watch True" in told
    assert "(2, 7)" in told


def test_collect_and_eval_take_the_classes_of_a_file_in_the_folder(folder: Path) -> None:
    named = ("pushing:PushToLine", "--agent", "pushing:LineExpert", "--cameras", "none", "--episodes", "2")
    run(folder, *RCS, "collect", *named, "--workers", "2", "--out", "pushed", "--no-report")
    dataset = Dataset.open(folder / "pushed")
    assert dataset.info.setup["task"] == "pushing:PushToLine"
    assert dataset.info.origin["collection"]["agent"] == "pushing:LineExpert"
    assert len(dataset) == 2
    told = run(folder, *RCS, "eval", *named, "--workers", "1", "--out", "judged")
    assert (folder / "judged" / "ledger.jsonl").is_file()
    assert "of 2 = " in told
