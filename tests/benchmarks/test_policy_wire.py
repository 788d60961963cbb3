from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest


def test_only_the_wanted_ways_are_made(program: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    policy_wire = program("policy_wire")
    for name in ("served", "openpi_way"):
        monkeypatch.delattr(policy_wire, name)
    images = {"left": np.zeros((2, 2, 3), np.uint8)}
    with ExitStack() as opened:
        assert list(policy_wire.ways(images, opened, policy_wire.Options(only=("copy",)))) == ["copy"]


def test_an_environment_whose_installation_has_failed_is_made_anew(
    tmp_path: Path, program: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy_wire = program("policy_wire")
    python = tmp_path / "build" / "interop" / "openpi" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.touch()
    monkeypatch.setattr(policy_wire, "ROOT", tmp_path)
    monkeypatch.setattr(policy_wire.subprocess, "run", lambda *_, **__: CompletedProcess([], 1))
    with ExitStack() as opened:
        assert "could not be made" in policy_wire.openpi_way(opened, policy_wire.Options())
