"""Arms, limits and clocks that the device tests share, and devices in C++ that are built outside of the project."""

from __future__ import annotations

import fcntl
import functools
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import mujoco
import pytest

from rcs.devices import ArmLimits

CPP_DEVICE = Path(__file__).parents[1] / "cpp_device"
CPP_DRIVER = Path(__file__).parents[2] / "core" / "examples" / "03_driver"


class HandClock:
    """A clock that tests move by hand [s]."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def limits() -> ArmLimits:
    """Limits of an arm with three joints."""
    return ArmLimits([-1.0, -2.0, -0.5], [1.0, 2.0, 1.5], [1.0, 2.0, 0.5])


@pytest.fixture(scope="session")
def wheel_python(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter that has the wheel of this project, and of this environment's packages all others."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    # It compiles what is not up to date in build/, which all processes of a run share.
    with (pytestconfig.cache.mkdir("wheel") / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _run(*pip, "wheel", "--no-build-isolation", "--no-deps", "--wheel-dir", folder, pytestconfig.rootpath)
    _run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    (packages,) = (folder / "venv").glob("lib/python*/site-packages")
    # Paths in a .pth file: that of this environment, without what makes an editable installation, and of rcs-data.
    others = (sysconfig.get_path("purelib"), str(pytestconfig.rootpath / "packages/rcs-data/src"))
    (packages / "others.pth").write_text("\n".join(others))
    (packages / "mujoco").symlink_to(Path(mujoco.__file__).parent)  # where the extension looks for it
    (wheel,) = folder.glob("*.whl")
    _run(*pip, "install", "--no-deps", "--target", packages, wheel)
    return folder / "venv" / "bin" / "python"


@pytest.fixture(scope="session")
def cpp_devices(wheel_python: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the extension modules of `tests/cpp_device`."""
    return _built(CPP_DEVICE, wheel_python, tmp_path_factory.mktemp("cpp_device"))


@pytest.fixture(scope="session")
def cpp_driver(wheel_python: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the extension module of the example of a driver, with its Python beside it."""
    built = _built(CPP_DRIVER, wheel_python, tmp_path_factory.mktemp("cpp_driver"))
    return Path(shutil.copy(CPP_DRIVER / "my_driver.py", built)).parent


def _built(source: Path, wheel_python: Path, folder: Path) -> Path:
    """Return the folder of extension modules that were built from a copy of their source against the wheel alone."""
    if "RCS_SANITIZED_CORE" in os.environ:
        pytest.skip("devices in C++ are built against the wheel, whose extension no sanitizer watches")
    cmake = _tool("cmake")
    if cmake is None or not (shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")):
        pytest.skip("building an arm in C++ needs cmake and a C++ compiler")
    shutil.copytree(source, folder / "source")
    ninja = _tool("ninja")
    generator = ["-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}"] if ninja else []
    options = ["-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={wheel_python}"]
    _run(cmake, "-S", folder / "source", "-B", folder / "build", *generator, *options)
    _run(cmake, "--build", folder / "build", "--parallel", "2")
    return folder / "build"


def _run(*command: str | Path) -> None:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=600, check=False)
    if done.returncode:
        pytest.fail(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}", pytrace=False)


@pytest.fixture(scope="session")
def import_device(cpp_devices: Path) -> Callable[[str], ModuleType]:
    """Return a function that imports one of these modules."""

    @functools.cache
    def load(name: str) -> ModuleType:
        path = cpp_devices / f"{name}{sysconfig.get_config_var('EXT_SUFFIX')}"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def ramp_arm(import_device: Callable[[str], ModuleType]) -> ModuleType:
    return import_device("ramp_arm")


@pytest.fixture(scope="session")
def blocking_devices(import_device: Callable[[str], ModuleType]) -> ModuleType:
    return import_device("blocking_devices")


def _tool(name: str) -> str | None:
    """Return the path of a program next to this Python, else of one on the path."""
    return shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
