"""The condition that episodes of an evaluation share: everything that their results may depend on, besides the seed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import field
from typing import Any

from rcs_data.files.json_file import leaves
from rcs_data.options import Natural, Record

_DIGITS = 16
"""Digits of a hash: two of a million conditions share them with a probability of 3e-8."""
BLIND = "blind"
"""Tag of the two conditions of a blind comparison, drawn anew for each comparison."""


class Condition(Record):
    """The facts that episodes of an evaluation share. A change of any field is another condition."""

    agent: str
    """Name of the agent, such as `pick@40000`."""
    weights: str | None = None
    """SHA-256 of its weights; None if it has none, or does not say which."""
    trained: Natural | None = None
    """Steps that its training had made; None if that is not known."""
    data: str | None = None
    """Hash of the data that it was trained on; None if that is not known."""
    policy: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Description that a served policy gives of itself."""
    execution: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """How the chunks of a policy are executed, and the instruction that it receives."""
    task: str
    """Name of the task."""
    robot: str
    """Name of the robot."""
    setup: Mapping[str, Any]
    """The environment, with all its arguments."""
    platform: Mapping[str, str] = field(default_factory=dict[str, str])
    """Drivers of what is real, by the robot's name; empty for simulation alone."""
    tags: Mapping[str, str] = field(default_factory=dict[str, str])
    """Words of the user, such as `{"mix": "half real"}`."""
    code: Mapping[str, str] = field(default_factory=dict[str, str])
    """SHA-256 of the source of modules that take part, of files, and of what a site says of real devices, by name."""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    """Versions of the software."""

    @property
    def hash(self) -> str:
        """The first 16 hexadecimal digits of the SHA-256 of all fields."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]

    @property
    def is_real(self) -> bool:
        """True if anything in it is real."""
        return bool(self.platform)

    def differences(self, other: Condition) -> dict[str, tuple[Any, Any]]:
        """Return the values that differ from another condition's, by `field` or `field.key`, down to the last level."""
        ours, theirs = leaves(self.to_json()), leaves(other.to_json())
        names = [*ours, *(name for name in theirs if name not in ours)]
        return {name: (ours.get(name), theirs.get(name)) for name in names if ours.get(name) != theirs.get(name)}


def key_of(condition: str, seed: int) -> str:
    """Return the key of an episode, which is also the name of its film.

    Args:
        condition: The hash of its condition.
        seed: Its seed.
    """
    return f"{condition}-{seed}"


def named(key: str, repeat: int) -> str:
    """Return the name of an episode: its key, and the number of the repetition if it is one."""
    return f"{key}.{repeat}" if repeat else key
