"""Arms, limits and clocks that the device tests share, and devices in C++ that are built outside of the project."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest

from rcs.devices import ArmLimits

CPP_DEVICE = Path(__file__).parents[1] / "cpp_device"


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
def cpp_devices(pytestconfig: pytest.Config) -> Path:
    """The folder of the extension modules of `tests/cpp_device`, built in pytest's cache."""
    cmake = _tool("cmake")
    if cmake is None or not (shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")):
        pytest.skip("building an arm in C++ needs cmake and a C++ compiler")
    build = pytestconfig.cache.mkdir(f"cpp_device-{sys.version_info.major}{sys.version_info.minor}")
    ninja = _tool("ninja")
    generator = ["-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}"] if ninja else []
    configure = [
        *(cmake, "-S", str(CPP_DEVICE), "-B", str(build), *generator),
        *("-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={sys.executable}"),
    ]
    for command in (configure, [cmake, "--build", str(build), "--parallel", "2"]):
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        if done.returncode:
            pytest.fail(f"{' '.join(command)}\n{done.stdout}{done.stderr}", pytrace=False)
    return build


@pytest.fixture(scope="session")
def ramp_arm(cpp_devices: Path) -> ModuleType:
    return _load(cpp_devices, "ramp_arm")


@pytest.fixture(scope="session")
def blocking_devices(cpp_devices: Path) -> ModuleType:
    return _load(cpp_devices, "blocking_devices")


def _load(folder: Path, name: str) -> ModuleType:
    path = folder / f"{name}{sysconfig.get_config_var('EXT_SUFFIX')}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _tool(name: str) -> str | None:
    """Return the path of a program next to this Python, else of one on the path."""
    return shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
