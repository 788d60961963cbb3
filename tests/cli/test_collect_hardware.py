"""`rcs collect --hardware`: a person at a terminal stands by, and what makes no sense is refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

from rcs.agents import Agent
from rcs.envs import Action, Env, Observation
from rcs.hardware import Site


class Stay(Agent):
    """Stays for a few steps."""

    def __init__(self, env: Env) -> None:
        self._steps = 0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self._steps = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        self._steps += 1
        return {"joints": np.zeros(7), "gripper": np.ones(1)}

    def events(self):
        return ("stop",) if self._steps >= 5 else ()


@pytest.fixture
def collect(call: Callable[..., tuple[int, str]], answer: Callable[[str | None], None], tmp_path: Path) -> Any:
    """Return a function that runs `rcs collect` on fakes, with lines for its questions."""

    def run(*arguments: str, lines: str | None) -> tuple[int, str]:
        site = {"arms": {"fr3": "fake:a"}, "grippers": {"fr3": "fake:a"}, "cameras": {"wrist": "fake:b"}}
        Site(**site, arm_stale_after=60.0).write(tmp_path / "site.json")
        answer(lines)
        words = ["PickCuboid", "--hardware", tmp_path / "site.json", "--episodes", "2", "--agent", f"{__name__}:Stay"]
        return call("collect", *words, "--out", tmp_path / "data", "--no-report", *arguments)

    return run


@pytest.mark.parametrize(("words", "first"), [((), "y\n"), (("--yes",), "")])
def test_a_person_at_the_terminal_makes_a_dataset_with_the_cameras_of_the_site(
    words: tuple[str, ...], first: str, collect: Any, tmp_path: Path
) -> None:
    code, text = collect("--home-speed", "1", *words, lines=f"{first}\ny\n\nmaybe\nn\n")
    assert code == 0, text
    assert ("Is the way free?" in text) is bool(first)
    assert len(re.findall(r"Put the cuboid at x 0\.\d{3} m", text)) == 2
    assert "Episode 1 of 2: done" in text
    assert "Episode 2 of 2: not done" in text
    assert "1 of 2 = 50.0 %" in text
    data = Dataset.open(tmp_path / "data")
    assert [episode.success for episode in data.episodes] == [True, False]
    assert [feature.key for feature in data.info.features if feature.is_image] == ["observation/frames/wrist/rgb"]
    assert data.info.origin["platform"] == dict.fromkeys(("fr3", "fr3/franka_hand", "wrist"), "fake")


@pytest.mark.parametrize(
    ("words", "lines", "match"),
    [
        ((), None, "The input is no terminal"),
        ((), "n\n", "nobody agreed"),
        (("--workers", "2"), "y\n", "one process of this machine; workers is 2"),
        (("--ray", "auto"), "y\n", "ray is 'auto'"),
        (("--home-speed", "2"), "y\n", "'speed' is 2"),
    ],
)
def test_what_makes_no_sense_is_refused_and_nothing_is_recorded(
    words: tuple[str, ...], lines: str | None, match: str, collect: Any, tmp_path: Path
) -> None:
    code, text = collect(*words, lines=lines)
    assert code == 1
    assert match in " ".join(text.split())
    assert not (tmp_path / "data").exists() or not Dataset.open(tmp_path / "data").episodes
