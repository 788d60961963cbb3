"""`rcs home` moves the arms of a site after a question, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.devices.fakes import FakeArm
from rcs.hardware import FakeDriver, Site
from rcs.robots.description import ArmDescription
from rcs.robots.fr3 import FR3

HOME = np.array(FR3.home)
made: list[FakeArm] = []


class Elsewhere(FakeDriver):
    """Makes arms that stand somewhere else than at home."""

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        arm = super().arm(address, about, options)
        arm.body.values = arm.body.target = np.array(about.home) - 0.1
        made.append(arm)
        return arm


@pytest.fixture
def go_home(call: Callable[..., tuple[int, str]], answer: Callable[[str | None], None], tmp_path: Path) -> Any:
    """Return a function that runs `rcs home` on a site of arms that stand elsewhere, with lines for its question."""

    def run(*arguments: str, arms: tuple[str, ...] = ("fr3",), lines: str | None = None) -> tuple[int, str]:
        made.clear()
        driver = f"{__name__}:Elsewhere"
        site = Site(arms={name: f"{driver}:{name}" for name in arms}, cameras={"wrist": "fake"}, arm_stale_after=60.0)
        site.write(tmp_path / "site.json")
        answer(lines)
        return call("home", "--site", tmp_path / "site.json", "--end-effector", "none", *arguments)

    return run


@pytest.mark.parametrize(
    ("arms", "words", "lines"),
    [(("fr3",), ("--yes",), None), (("fr3",), (), "y\n"), (("left", "right"), ("--yes",), None)],
)
def test_all_arms_go_home_when_somebody_agrees(
    arms: tuple[str, ...], words: tuple[str, ...], lines: str | None, go_home: Any
) -> None:
    code, text = go_home("--speed", "1", *words, arms=arms, lines=lines)
    assert code == 0, text
    assert f"At home: {', '.join(arms)}" in text
    assert ("Is the way free? [y]es, [n]o:" in text) is (lines is not None)
    assert len(made) == len(arms)
    for arm in made:
        np.testing.assert_allclose(arm.body.values, HOME, atol=1e-6)
        assert not arm.is_open


@pytest.mark.parametrize(
    ("words", "lines", "code", "match"),
    [
        ((), "n\n", 1, "nobody agreed"),
        ((), "\n", 1, "nobody agreed"),
        ((), "", 1, "The input has ended"),
        ((), None, 1, "give --yes"),
        (("--yes", "--speed", "2"), None, 1, "'speed' is 2"),
        (("--yes", "--robot", "ur5e"), None, 1, "'fr3'"),
    ],
)
def test_without_leave_nothing_moves(
    words: tuple[str, ...], lines: str | None, code: int, match: str, go_home: Any
) -> None:
    found, text = go_home(*words, lines=lines)
    assert found == code
    assert match in " ".join(text.split())
    for arm in made:
        np.testing.assert_array_equal(arm.body.values, HOME - 0.1)


def test_a_site_whose_arms_are_of_no_robot_asks_which(go_home: Any) -> None:
    code, text = go_home("--yes", arms=("left", "middle"))
    assert code == 1
    assert "are those of no robot that is known; name one with --robot" in " ".join(text.split())
