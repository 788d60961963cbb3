"""Meta-World's own scripted policies, served from its environment: `vlagents serve sawyer:make --checkpoint TASK`."""

from __future__ import annotations

import importlib
from typing import Any

from vlagents import Metadata, PartSpec
from vlagents.policies.scripted import ScriptedPolicy


def make(task: str) -> ScriptedPolicy:
    """Return the policy of a task, such as `pick-place`, which takes and gives what the simulator has."""
    name = f"Sawyer{task.title().replace('-', '')}V3Policy"
    script: Any = getattr(importlib.import_module("metaworld.policies"), name)()
    state, action = (PartSpec("observation", 39),), (PartSpec("raw", 4),)
    metadata = Metadata(name=name, state=state, action=action, rate=80.0)
    return ScriptedPolicy(lambda seen, _: script.get_action(seen.state["observation"]), metadata)
