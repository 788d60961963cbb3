"""Rules of the Makefile, with stand-ins for the programs that they call, and pins of what they install."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PYTHON = ".venv/bin/python"


def stand_in(file: Path, program: str) -> str:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\n{program}\n")
    file.chmod(0o755)
    return str(file)


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = ["make", "-f", str(ROOT / "Makefile"), "-C", str(folder), *words]
    alone = {"PATH": os.environ["PATH"]}  # not part of a `make test` around this
    return subprocess.run(command, capture_output=True, text=True, check=False, env=alone)


@pytest.mark.parametrize(("status", "is_green"), [(0, True), (1, True), (2, False), (3, False), (5, False)])
def test_only_tests_that_fail_are_run_once_more(status: int, is_green: bool, tmp_path: Path) -> None:
    stand_in(tmp_path / PYTHON, f'case "$*" in *--last-failed*) exit 0;; esac; exit {status}')
    done = make(tmp_path, "test", "-o", "test-cpp", "-o", "gl")
    assert (done.returncode == 0) == is_green, done.stderr
    assert ("once more" in done.stdout) == (status == 1)


def test_one_failed_benchmark_does_not_end_the_others(tmp_path: Path) -> None:
    stand_in(tmp_path / PYTHON, 'echo "ran $1"; case "$1" in *b.py) exit 1;; esac')
    (tmp_path / "benchmarks").mkdir()
    for name in ("a", "b", "c"):
        (tmp_path / "benchmarks" / f"{name}.py").touch()
    done = make(tmp_path, "bench", "-o", ".venv/.stamp-extras", "-o", ".venv/.stamp-drivers", "-o", "gl")
    assert done.stdout.count("ran benchmarks/") == 3
    assert done.returncode != 0
    assert "Failed: benchmarks/b.py\n" in done.stderr


@pytest.mark.parametrize("version", ["3.11", "3.12"])
def test_an_interpreter_other_than_that_of_the_environment_is_refused(version: str, tmp_path: Path) -> None:
    stand_in(tmp_path / PYTHON, "echo 3.11")
    other = stand_in(tmp_path / "python", f"echo {version}")
    done = make(tmp_path, "same-python", f"PYTHON={other}")
    assert (done.returncode == 0) == (version == "3.11"), done.stderr
    assert (f"PYTHON is {other}, but .venv has Python 3.11" in done.stderr) == (version != "3.11")


@pytest.mark.parametrize("version", [(3, 10), (3, 15)])
def test_an_interpreter_for_which_mujoco_has_no_wheel_is_refused(version: tuple[int, int], tmp_path: Path) -> None:
    python = stand_in(tmp_path / "python", f'exec {sys.executable} -c "import sys; sys.version_info = {version}; $2"')
    command, given = [ROOT / "tools" / "system_packages", "build"], {**os.environ, "PYTHON": python}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=given)
    assert done.returncode == 1
    assert f"PYTHON is {python}; it must name a Python of 3.11 to 3.14" in done.stderr


def test_every_package_that_the_tests_bring_is_pinned() -> None:
    pins = (line.partition("==")[0] for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines()[1:])
    pinned = {canonicalize_name(pin) for pin in pins} | {"robot-control-stack", "rcs-data", "rcs-vlagents"}
    left = [("robot-control-stack", extra) for extra in ("", "dev")]
    found = set(left)
    while left:
        name, extra = left.pop()
        for one in map(Requirement, requires(name) or ()):
            if one.marker is None or one.marker.evaluate({"extra": extra}):
                new = {(canonicalize_name(one.name), asked) for asked in ("", *one.extras)} - found
                found |= new
                left += new
    assert {name for name, _ in found} - pinned == set()
