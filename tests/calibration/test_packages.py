"""A package of the extra that is not installed is named, and so is the extra."""

from __future__ import annotations

import pytest

from rcs.calibration.packages import package
from rcs.errors import MissingDependency


def test_a_missing_package_names_the_extra() -> None:
    with pytest.raises(MissingDependency, match=r"no_such_package: pip install 'robot-control-stack\[calibration\]'"):
        package("no_such_package.part")
