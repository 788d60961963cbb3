from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from vlagents.wire.shared import is_supported

SCRIPT = Path(__file__).parents[1] / "tools" / "fuzz_wire.py"


@pytest.mark.skipif(not is_supported(), reason="needs memory without a name, which this system has not")
@pytest.mark.parametrize("wire", ["shared", "tcp", "websocket", "gr00t"])
def test_damaged_frames_do_no_harm(wire: str) -> None:
    spec = importlib.util.spec_from_file_location("fuzz_wire", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    found = script.fuzz(wire, frames=1000, seed=3)
    assert (found["crashes"], found["canary"]) == (0, False)
    assert found["served"] > 1
    assert found["connections"] > 100
    assert found["mb_grown"] < 20.0
