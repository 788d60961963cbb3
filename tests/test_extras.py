"""Packages of the extras."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rcs.errors import MissingDependency
from rcs.extras import package_of


def test_what_is_there_is_imported() -> None:
    assert package_of("rl", "math", "Nothing needs") is math


def test_what_is_missing_is_told_with_its_extra() -> None:
    with pytest.raises(MissingDependency, match=r"^Flying needs no_such_wings: .*\[air\]"):
        package_of("air", "no_such_wings.feathers", "Flying needs")


def test_a_package_that_lacks_a_library_says_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = "libwind.so.0: cannot open shared object file"
    (tmp_path / "broken_wings.py").write_text(f"raise ImportError({words!r})\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingDependency, match=f"Flying needs broken_wings, which is installed .* load: {words}"):
        package_of("air", "broken_wings", "Flying needs")
