"""An agent that stays, its evaluations, and a process that claims an episode of one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rcs
from rcs.agents import Agent
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary

SETUP = rcs.Setup(task="PickCuboid", max_episode_steps=4)
"""Episodes that end before anything is picked."""


class Stay(Agent):
    """Keeps every joint and every gripper where it is."""

    def __init__(self, env: Any) -> None:
        self._action = env.action_space.sample()
        self._action["joints"][:] = 0.0
        self._action["gripper"][:] = 1.0

    def reset(self, observation: Any, info: Any) -> None:
        """Nothing to forget."""

    def act(self, observation: Any, info: Any) -> Any:
        return self._action


def run(**options: Any) -> Summary:
    summary = Summary()
    for _ in evaluate(Evaluation(**{"setup": SETUP, "agent": Stay, "episodes": 3, **options}), summary):
        pass
    return summary


CLAIM = """
import sys
from rcs_data.ledger import Ledger
ledger = Ledger(sys.argv[1])
print(ledger.claim(sys.argv[2]), flush=True)
sys.stdin.read()
"""


@contextmanager
def claimed(folder: Path, key: str) -> Generator[subprocess.Popen[str]]:
    """Have another process claim an episode of a ledger until the end of the block, and yield that process."""
    words = [sys.executable, "-c", CLAIM, str(folder), key]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "True\n"
        yield other
