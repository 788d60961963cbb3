"""Packages of the extras."""

from __future__ import annotations

import math

import pytest

from rcs.errors import MissingDependency
from rcs.extras import package_of


def test_what_is_there_is_imported() -> None:
    assert package_of("rl", "math", "Nothing needs") is math


def test_what_is_missing_is_told_with_its_extra() -> None:
    with pytest.raises(MissingDependency, match=r"^Flying needs no_such_wings: .*\[air\]"):
        package_of("air", "no_such_wings.feathers", "Flying needs")
