"""Programs of others use the core in C++ by CMake: as a subdirectory, and installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import mujoco
import pytest

ROOT = Path(__file__).parents[2]
CONSUMER = ROOT / "tests" / "cpp_consumer"
MUJOCO = Path(mujoco.__file__).parent
ANSWER = f"2 copies, 1.5 m, MuJoCo {mujoco.mj_version()}\n"
LIBRARIES = [f"-DMUJOCO_DIR={MUJOCO}", f"-DRUCKIG_DIR={sysconfig.get_path('platlib')}"]
WITHOUT_PYTHON = ["-DCMAKE_DISABLE_FIND_PACKAGE_Python=ON", *LIBRARIES]


def tool(name: str) -> str | None:
    """Return the path of a program next to this Python, else of one on the path."""
    return shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)


def run(*command: str | Path) -> str:
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_DIR", "RUCKIG_DIR")}
    done = subprocess.run(
        [str(c) for c in command], capture_output=True, text=True, timeout=600, check=False, env=environment
    )
    if done.returncode:
        pytest.fail(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}", pytrace=False)
    return done.stdout


def configure(source: Path, build: Path, *options: str) -> None:
    cmake, ninja = tool("cmake"), tool("ninja")
    if cmake is None or not (shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")):
        pytest.skip("building a program in C++ needs cmake and a C++ compiler")
    generator = ["-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}"] if ninja else []
    run(cmake, "-S", source, "-B", build, *generator, "-DCMAKE_BUILD_TYPE=Debug", *options)


def build_and_run(build: Path) -> str:
    run(tool("cmake") or "", "--build", build, "--parallel", "2")
    return run(build / "consumer")


@pytest.fixture(scope="module")
def subdirectory(pytestconfig: pytest.Config) -> Path:
    """The consumer, configured with the core as a subdirectory and without Python."""
    build = pytestconfig.cache.mkdir("cpp_consumer")
    configure(CONSUMER, build, f"-DRCS_SOURCE={ROOT}", "-DRCS_INSTALL=ON", *WITHOUT_PYTHON)
    return build


@pytest.mark.slow
def test_a_program_adds_the_core_as_a_subdirectory_without_python(subdirectory: Path) -> None:
    assert build_and_run(subdirectory) == ANSWER


@pytest.mark.slow
def test_a_program_finds_the_installed_core_and_the_mujoco_of_python(subdirectory: Path, tmp_path: Path) -> None:
    build_and_run(subdirectory)
    run(tool("cmake") or "", "--install", subdirectory, "--prefix", tmp_path / "installed")
    configure(
        CONSUMER,
        tmp_path / "build",
        f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}",
        f"-DPython_EXECUTABLE={sys.executable}",
    )
    assert build_and_run(tmp_path / "build") == ANSWER


def test_a_missing_mujoco_is_named_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(pytest.fail.Exception, match="Set MUJOCO_DIR to the folder of a release"):
        configure(ROOT, tmp_path, "-DRCS_BUILD_PYTHON=OFF", "-DCMAKE_DISABLE_FIND_PACKAGE_Python=ON")
