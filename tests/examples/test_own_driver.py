"""The template of a driver passes its contract, from its folder and installed by pip."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "examples" / "18_own_driver"


@pytest.mark.slow
@pytest.mark.parametrize("way", ["files", pytest.param("pip", marks=pytest.mark.extras)])
def test_the_tests_of_the_package_pass(tmp_path: Path, way: str) -> None:
    python, paths = sys.executable, [str(PACKAGE / "src")]
    if way == "pip":
        source = shutil.copytree(PACKAGE, tmp_path / "source", ignore=shutil.ignore_patterns("__pycache__"))
        python, paths = environment_with(source, tmp_path / "venv"), []
    path = os.pathsep.join(filter(None, [*paths, os.environ.get("PYTHONPATH", "")]))
    command = [python, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, env=environment, cwd=PACKAGE, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "SKIPPED" not in done.stdout
    assert " passed" in done.stdout
    if way == "pip":  # by the name of its entry point
        named = "from rcs.hardware.driver import driver_named; print(type(driver_named('line_gripper')).__name__)"
        done = subprocess.run([python, "-c", named], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "LineGripperDriver"


def environment_with(source: Path, folder: Path) -> str:
    """Install a package by pip into an environment of its own, which sees this one's, and return its Python."""
    venv.create(folder)
    python = str(folder / "bin" / "python")
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "tests.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", str(source)]
    subprocess.run(pip, check=True, timeout=120)
    return python


def test_the_page_of_the_documents_names_what_is_there() -> None:
    page = (PACKAGE.parents[1] / "docs/extend/driver.md").read_text()
    for file in PACKAGE.rglob("*.py"):
        if file.name != "__init__.py":
            assert str(file.relative_to(PACKAGE)) in page
    driver = (PACKAGE / "src/line_gripper/driver.py").read_text()
    for function in ("_open", "_state", "_command_opening", "_has_arrived", "_hold", "_recover", "_close", "_ask"):
        assert f"`{function}`" in page
        assert f"def {function}(" in driver


def test_the_page_shows_a_driver_as_it_is() -> None:
    root = PACKAGE.parents[1]
    real = (root / "src/rcs/hardware/digit.py").read_text() + (root / "pyproject.toml").read_text()
    _, shown = (root / "docs/extend/driver.md").read_text().split("## The driver, line by line")
    fences = shown.split("```text\n")[1:]
    assert len(fences) == 5
    for fence in fences:
        for line in fence.split("```")[0].splitlines():
            assert f"{line}\n" in real, line
