"""`rcs doctor` without a site: what draws here, and which extras are installed."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from rcs.cli.doctor import missing

ROOT = Path(__file__).parents[2]


def test_doctor_tells_which_backend_draws_and_why_and_all_extras(call: Any) -> None:
    code, told = call("doctor")
    assert "GL egl" in told
    assert "GL osmesa" in told
    assert (code == 0) == ("chosen" in told)
    for extra in importlib.metadata.metadata("robot-control-stack").get_all("Provides-Extra") or ():
        assert f"extra {extra}" in told


def test_doctor_looks_into_the_extras_of_packages(call: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = tomllib.loads((ROOT / "packages/rcs-data/pyproject.toml").read_text())["project"]["optional-dependencies"]
    monkeypatch.setenv("COLUMNS", "200")
    told = [line.split() for line in call("doctor")[1].splitlines()]
    for extra in ("hdf5", "rlds", "hub"):
        (package,) = (re.split("[>=<]", line)[0] for line in parts[extra])
        is_there = bool(list(importlib.metadata.Distribution.discover(name=package)))
        (words,) = (line[2:] for line in told if line[:2] == ["extra", extra])
        assert words[:3] == (["installed"] if is_there else ["not", "installed", f"({package}):"])


def test_what_an_extra_lacks_is_found_behind_other_extras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs = {
        "whole": ['part[deep,here]>=2; extra == "all"', 'other; python_version < "3" and extra == "all"'],
        "part": ["missing-one>=1 ; extra == 'deep'", "whole; extra == 'here'", "missing-two; extra == 'unasked'"],
    }
    for name, lines in needs.items():
        folder = tmp_path / f"{name}-2.0.dist-info"
        folder.mkdir()
        described = "".join(f"Requires-Dist: {line}\n" for line in lines)
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.0\n{described}")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert missing("whole", "all") == ["missing-one"]
    assert missing("part", "here") == []


def test_a_missing_gl_library_is_told_with_its_remedy(call: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from rcs.cli import doctor

    class Probe:
        def __init__(self, name: str, detail: str) -> None:
            self.name, self.ok, self.detail = name, False, detail

    monkeypatch.setattr(
        doctor, "probe_gl", lambda: [Probe("egl", "no libEGL.so.1"), Probe("osmesa", "apt-get install libosmesa6")]
    )
    code, told = call("doctor")
    assert code == 1
    assert "apt-get install libosmesa6" in told
