"""A package adds robot, task, agent, layer and driver by its entry points alone, and nothing of ours is touched."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from rcs_data import Dataset
from rcs_data.ledger import Ledger

from rcs.devices import lookup

PACKAGE = Path(__file__).parents[2] / "examples" / "06_own_robot"
RCS = ("-c", "from rcs.cli.main import main; main()")


@pytest.fixture(scope="module", params=["files", pytest.param("pip", marks=pytest.mark.extras)])
def installed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process in which the package is installed: what an installer writes, on the path."""
    site = tmp_path_factory.mktemp("site")
    paths = [str(site)]
    if request.param == "pip":
        source = shutil.copytree(PACKAGE, site / "source", ignore=shutil.ignore_patterns("__pycache__"))
        pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(site), str(source)]
        subprocess.run(pip, check=True, timeout=120)
    else:
        write_metadata(site)
        paths.append(str(PACKAGE / "src"))
    path = os.pathsep.join(filter(None, [*paths, os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "200"}


def write_metadata(site: Path) -> None:
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines: list[str] = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


def run(installed: dict[str, str], *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        env=installed,
        cwd=PACKAGE,
        check=False,
        timeout=300,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_the_robot_is_unknown_before_its_package_is_installed() -> None:
    assert "my_robot" not in lookup.names("arm")


@pytest.mark.slow
def test_the_tests_of_the_package_pass(installed: dict[str, str]) -> None:
    told = run(installed, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider")
    assert " passed" in told
    assert "failed" not in told
    assert told.count("SKIPPED") == told.count("override lose_link")  # a simulated arm has no link


def test_all_that_it_has_is_listed(installed: dict[str, str]) -> None:
    told = run(installed, *RCS, "list")
    robots = ("My robot, 6 joints", "My robot, from its URDF", "rcs/PickCuboid-MyRobot-v0", "rcs/PickCuboid-FR3-v0")
    for text in (*robots, "PushToLine", "LineExpert", "Wander", "HalfSpeed", "my_driver", "rcs/PushToLine-MyRobot-v0"):
        assert text in told


def test_the_robot_collects_a_dataset(installed: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "dataset"
    options = ("--robot", "my_robot", "--cameras", "none", "--episodes", "3", "--workers", "2", "--out", str(out))
    run(installed, *RCS, "collect", "PickCuboid", *options)
    episodes = Dataset.open(out).episodes
    assert [episode.success for episode in episodes] == [True] * 3
    assert (out / "report.html").is_file()


def test_what_it_collected_replays_bit_for_bit(installed: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "dataset"
    options = ("--robot", "my_robot_urdf", "--cameras", "none", "--episodes", "1", "--workers", "1", "--out", str(out))
    run(installed, *RCS, "collect", "PickCuboid", *options, "--no-report")
    assert "1 of 1 episodes bit-equal" in run(installed, *RCS, "data", "replay", str(out))


def test_its_task_is_collected_with_its_layer_and_replays_bit_for_bit(
    installed: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "dataset"
    options = ("--robot", "my_robot", "--layers", "HalfSpeed", "--reward", "sparse", "--cameras", "none")
    run(installed, *RCS, "collect", "PushToLine", *options, "--episodes", "2", "--workers", "2", "--out", str(out))
    dataset = Dataset.open(out)
    assert [episode.success for episode in dataset.episodes] == [True, True]
    assert dataset.info.setup["layers"] == ["HalfSpeed"]
    rewards = dataset.episodes[0].column("reward")
    assert rewards[-1] == 1.0
    assert not rewards[1:-1].any(), "sparse"
    assert "2 of 2 episodes bit-equal" in run(installed, *RCS, "data", "replay", str(out))


def test_its_agent_is_evaluated_beside_the_expert(installed: dict[str, str], tmp_path: Path) -> None:
    options = ("--robot", "my_robot", "--episodes", "4", "--workers", "2")
    run(installed, *RCS, "eval", "PushToLine", *options, "--out", str(tmp_path))
    run(installed, *RCS, "eval", "PushToLine", *options, "--agent", "Wander", "--out", str(tmp_path))
    ledger = Ledger(tmp_path)
    expert, chance = ({row.seed: row.success for row in ledger.of(one)} for one in ledger.conditions)
    assert expert.keys() == chance.keys()
    assert (sum(map(bool, expert.values())), sum(map(bool, chance.values()))) == (4, 0)
    assert ledger.find("Wander")


def test_a_change_of_its_lab_or_its_model_is_another_condition(installed: dict[str, str], tmp_path: Path) -> None:
    source, out = shutil.copytree(PACKAGE / "src", tmp_path / "src"), tmp_path / "out"
    mine = {**installed, "PYTHONPATH": os.pathsep.join((str(source), installed["PYTHONPATH"]))}
    options = ("--robot", "my_robot", "--episodes", "1", "--max-episode-steps", "2", "--workers", "1")
    changes = (("lab.py", ""), ("lab.py", ""), ("lab.py", "# a change"), ("my_robot.xml", "<!-- a change -->"))
    rows: list[int] = []
    for name, change in changes:
        path = source / "my_robot" / name
        path.write_text(path.read_text() + change)
        run(mine, *RCS, "eval", "PushToLine", *options, "--out", str(out))
        rows.append(len(Ledger(out).rows))
    assert rows == [1, 1, 2, 3]


def test_gymnasium_makes_its_task_by_id_and_its_driver_makes_it_real(installed: dict[str, str]) -> None:
    told = run(installed, "-c", ON_THE_ROBOT)
    assert "block" in told
    assert "{'my_robot': 'my_driver', 'my_robot/franka_hand': 'my_driver'}" in told
    assert "5 steps" in told


ON_THE_ROBOT = """
import gymnasium
import rcs
from rcs.agents import agent_for
from rcs.rollout.episode import run_episode
env = gymnasium.make("rcs.installed:rcs/PushToLine-MyRobot-v0")
print(env.reset(seed=0)[1].keys())
env = rcs.make("PushToLine", robot="my_robot", hardware="my_driver:192.0.2.7", layers=["HalfSpeed"])
print(env.platform)
print(run_episode(env, agent_for(env, "Wander"), max_steps=5).steps, "steps")
env.close()
"""
