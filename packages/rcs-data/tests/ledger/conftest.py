"""Conditions and rows of ledgers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import pytest
from rcs_data.ledger import Condition, Ledger, Row
from rcs_data.ledger.condition import key_of


class MakeCondition(Protocol):
    """Makes a condition."""

    def __call__(self, agent: str = "alpha", **others: Any) -> Condition: ...


class MakeRow(Protocol):
    """Makes the row of an episode of a condition."""

    def __call__(self, condition: Condition, seed: int, success: bool | None = True, **others: Any) -> Row: ...


def made_row(condition: Condition, seed: int, success: bool | None = True, **others: Any) -> Row:
    """Return the row of an episode."""
    usual: dict[str, Any] = {
        "key": key_of(condition.hash, seed), "condition": condition.hash, "seed": seed, "success": success,
        "agent": condition.agent, "weights": condition.weights, "trained": condition.trained, "task": condition.task,
        "robot": condition.robot, "is_real": condition.is_real, "failure": "timeout" if success is False else None,
        "message": None, "judge": "task", "steps": 9, "reward": 0.5, "latency_p50": None, "latency_p99": None,
        "seconds": 0.1, "ended": "2026-11-26T12:00:00+00:00",
    }  # fmt: skip
    return Row(**{**usual, **others})


def condition_of(agent: str = "alpha", **others: Any) -> Condition:
    """Return a condition."""
    return replace(Condition(agent=agent, task="Pick", robot="fr3", setup={"frequency": 30.0}), **others)


@pytest.fixture(scope="session")
def make_row() -> MakeRow:
    """Make a row."""
    return made_row


@pytest.fixture(scope="session")
def make_condition() -> MakeCondition:
    """Make a condition."""
    return condition_of


@pytest.fixture
def filled(tmp_path: Any) -> Ledger:
    """A ledger in which `alpha` wins 8 of 8 seeds, `beta` 1 of them, and `gamma` 7."""
    ledger = Ledger.open(tmp_path / "ledger")
    for agent, wins in (("alpha", 8), ("beta", 1), ("gamma", 7)):
        condition = condition_of(agent)
        ledger.register(condition, f"runs/{agent}")
        for seed in range(8):
            assert ledger.add(made_row(condition, seed, seed < wins))
    return ledger
