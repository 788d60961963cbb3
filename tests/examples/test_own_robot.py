"""A package of someone else adds a robot by its entry points alone, and nothing of ours is touched."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from rcs.data import Dataset
from rcs.devices import lookup

PACKAGE = Path(__file__).parents[2] / "examples" / "06_own_robot"
RCS = ("-c", "from rcs.cli.main import main; main()")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process in which the package is installed: what an installer writes, on the path."""
    site = tmp_path_factory.mktemp("site")
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines: list[str] = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    paths = [str(site), str(PACKAGE / "src"), os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(filter(None, paths))
    return {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "200"}


def run(installed: dict[str, str], *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        env=installed,
        cwd=PACKAGE,
        check=False,
        timeout=60,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_the_robot_is_unknown_before_its_package_is_installed() -> None:
    assert "my_robot" not in lookup.names("arm")


def test_the_tests_of_the_package_pass(installed: dict[str, str]) -> None:
    told = run(installed, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider")
    assert " passed" in told
    assert "failed" not in told
    assert told.count("SKIPPED") == told.count("override lose_link")  # a simulated arm has no link


def test_the_robot_is_listed_with_its_id(installed: dict[str, str]) -> None:
    told = run(installed, *RCS, "list")
    for text in ("My robot, 6 joints", "My robot, from its URDF", "rcs/PickCuboid-MyRobot-v0", "rcs/PickCuboid-FR3-v0"):
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


@pytest.mark.extras
def test_pip_installs_the_package_and_its_robot_is_there(tmp_path: Path) -> None:
    source, site = tmp_path / "source", tmp_path / "site"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(site), str(source)]
    done = subprocess.run(pip, check=False, timeout=120, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    environment = {**os.environ, "PYTHONPATH": str(site)}
    out = tmp_path / "dataset"
    options = ("--robot", "my_robot", "--cameras", "none", "--episodes", "1", "--workers", "1", "--out", str(out))
    run(environment, *RCS, "collect", "PickCuboid", *options)
    assert Dataset.open(out).episodes[0].success
