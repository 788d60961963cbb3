"""Fakes that tests of input devices share: absent devices of the kernel, and a person at a scripted device."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

import rcs
from rcs.teleop import HandReading, LeadOptions, Operator
from tests.teleop.scripted_device import Led, ScriptedDevice

READ = Path(__file__).parent / "read_device.py"


def escaped(data: bytes) -> bytes:
    """Return bytes as umockdev's scripts have them: control characters as ^ and a letter, ^ itself as ^`."""
    return b"".join(
        b"^`" if byte == 0x5E else bytes([0x5E, byte + 64]) if byte < 32 else bytes([byte]) for byte in data
    )


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a certificate and a code of the test alone."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))


@pytest.fixture
def read_mocked(tmp_path: Path) -> Callable[..., list[dict[str, Any]]]:
    """Read a device in a process for which umockdev plays the kernel."""
    if shutil.which("umockdev-run") is None:
        pytest.skip("There is no umockdev-run on the path; tools/system_packages inputs installs it.")

    def read(
        device: str, *, seconds: float, description: str = "", inputs: dict[str, list[tuple[int, bytes]]] | None = None,
        address: str = "",
    ) -> list[dict[str, Any]]:  # fmt: skip
        given = inputs or {}
        (tmp_path / "devices").write_text(description)
        options = ["-d", str(tmp_path / "devices")]
        for number, (node, pieces) in enumerate(given.items()):
            lines = [b"w 0 go", *(b"r %d %s" % (delay, escaped(piece)) for delay, piece in pieces)]
            (tmp_path / f"script{number}").write_bytes(b"\n".join(lines) + b"\n")
            options += ["-s", f"{node}={tmp_path / f'script{number}'}"]
        module, _, name = device.partition(":")
        found = subprocess.run(
            ["umockdev-run", *options, "--", sys.executable, str(READ), module, name, address, str(seconds), *given],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert found.stdout, found.stderr
        return [json.loads(line) for line in found.stdout.splitlines()]

    return read


@pytest.fixture
def lead() -> Iterator[Callable[..., Led]]:
    """Make an environment and an operator at a script; both are closed at the end."""
    made: list[Led] = []

    def make(
        script: Callable[[float], HandReading | Mapping[str, HandReading] | None],
        *,
        robot: Any = "fr3",
        options: LeadOptions | None = None,
        hands: tuple[str, ...] = ("right",),
        has_clutch: bool = True,
        rate: float = 72.0,
        robots: Mapping[str, str] | None = None,
        **setup: Any,
    ) -> Led:
        usual: dict[str, Any] = {"binary_gripper": False, "max_episode_steps": None}
        env = rcs.make("Free", robot=robot, **{**usual, **setup})
        world = env.simulation.world

        def clock() -> float:
            return float(world.time)

        device = ScriptedDevice(script, clock=clock, rate=rate, hands=hands, has_clutch=has_clutch)
        operator = Operator(env, device, options=options, robots=robots, clock=clock, has_thread=False)
        led = Led(env, device, operator, None if len(env.robots) == 1 else next(reversed(env.robots)))
        made.append(led)
        led.observation, led.info = env.reset(seed=0)
        operator.reset(led.observation, led.info)
        return led

    yield make
    for led in made:
        led.operator.close()
        led.env.close()
