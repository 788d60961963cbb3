"""The template of a driver passes its contract, from its folder and installed by pip."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "examples" / "18_own_driver"


@pytest.mark.slow
@pytest.mark.parametrize("way", ["files", pytest.param("pip", marks=pytest.mark.extras)])
def test_the_tests_of_the_package_pass(tmp_path: Path, way: str) -> None:
    paths = [str(PACKAGE / "src")]
    if way == "pip":
        source = shutil.copytree(PACKAGE, tmp_path / "source", ignore=shutil.ignore_patterns("__pycache__"))
        target = tmp_path / "site"
        pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(target), str(source)]
        subprocess.run(pip, check=True, timeout=120)
        paths = [str(target)]
    path = os.pathsep.join(filter(None, [*paths, os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, env=environment, cwd=PACKAGE, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "SKIPPED" not in done.stdout
    assert " passed" in done.stdout


def test_the_page_of_the_documents_names_what_is_there() -> None:
    page = (PACKAGE.parents[1] / "docs/extend/driver.md").read_text()
    for file in PACKAGE.rglob("*.py"):
        if file.name != "__init__.py":
            assert str(file.relative_to(PACKAGE)) in page
    driver = (PACKAGE / "src/line_gripper/driver.py").read_text()
    for function in ("_open", "_state", "_command_opening", "_has_arrived", "_hold", "_recover", "_close", "_ask"):
        assert f"`{function}`" in page
        assert f"def {function}(" in driver
