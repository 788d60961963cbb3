"""`rcs home` moves the arms of a site after a question, and nothing else."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.cli.main import main
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


class Terminal(io.StringIO):
    """A person at a terminal."""

    def isatty(self) -> bool:
        return True


def call(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    *arguments: str,
    arms: tuple[str, ...] = ("fr3",),
    answer: str | None = None,
) -> tuple[int, str]:
    """Run `rcs home` on a site of arms that stand elsewhere, with an answer for its question; None for no terminal."""
    made.clear()
    driver = f"{__name__}:Elsewhere"
    site = Site(arms={name: f"{driver}:{name}" for name in arms}, cameras={"wrist": "fake"}, arm_stale_after=60.0)
    site.write(folder / "site.json")
    monkeypatch.setattr("sys.stdin", io.StringIO() if answer is None else Terminal(answer))
    with pytest.raises(SystemExit) as stopped:
        main(["home", "--site", str(folder / "site.json"), "--end-effector", "none", *arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out + captured.err


@pytest.mark.parametrize(
    ("arms", "words", "answer"),
    [(("fr3",), ("--yes",), None), (("fr3",), (), "y\n"), (("left", "right"), ("--yes",), None)],
)
def test_all_arms_go_home_when_somebody_agrees(
    arms: tuple[str, ...],
    words: tuple[str, ...],
    answer: str | None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    code, text = call(capsys, monkeypatch, tmp_path, "--speed", "1", *words, arms=arms, answer=answer)
    assert code == 0, text
    assert f"At home: {', '.join(arms)}" in text
    assert ("Is the way free? [y]es, [n]o:" in text) is (answer is not None)
    assert len(made) == len(arms)
    for arm in made:
        np.testing.assert_allclose(arm.body.values, HOME, atol=1e-6)
        assert not arm.is_open


@pytest.mark.parametrize(
    ("words", "answer", "code", "match"),
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
    words: tuple[str, ...],
    answer: str | None,
    code: int,
    match: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, text = call(capsys, monkeypatch, tmp_path, *words, answer=answer)
    assert found == code
    assert match in " ".join(text.split())
    for arm in made:
        np.testing.assert_array_equal(arm.body.values, HOME - 0.1)


def test_a_site_whose_arms_are_of_no_robot_asks_which(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, text = call(capsys, monkeypatch, tmp_path, "--yes", arms=("left", "middle"))
    assert code == 1
    assert "are those of no robot that is known; name one with --robot" in " ".join(text.split())
