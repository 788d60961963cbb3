"""A simulator behind a `Server`: calls to open it with a mapping, to begin episodes and to make steps."""

from __future__ import annotations

import hashlib
import sys
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput, MissingSimulator, SimulatorTaken
from vlagents.lookup import find, prepared, unknown
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.simulators.interface import Moment, Simulator, SimulatorMapping
from vlagents.wire.calls import observation_to_values

BUILT_IN = {
    "libero": "vlagents.simulators.libero:LiberoSimulator",
    "maniskill": "vlagents.simulators.maniskill:ManiskillSimulator",
    "metaworld": "vlagents.simulators.metaworld:MetaworldSimulator",
}
"""Class of each simulator; a module is imported when it is used, in the simulator's own Python."""


class ServedSimulator(Policy):
    """Answers the calls of a `SimulatorClient`; it is served as a policy is, and is none.

    The simulator works in one thread, because contexts of OpenGL belong to one. It has one client at a time: whoever
    opened it last.
    """

    def __init__(self, make: Callable[[], Simulator]) -> None:
        """Make a simulator, in its thread."""
        self._thread = ThreadPoolExecutor(1, "vlagents simulator")
        self._simulator = self._thread.submit(make).result()
        facts = self._simulator.facts
        self.facts = replace(facts, versions={**facts.versions, "sources": _sources(self._simulator)})
        """The facts that the simulator states about itself, and the hash of its sources among the versions."""
        self._mapping = self.facts.mapping
        self._opened = self._steps = 0
        self._is_closed = False
        self.calls = {"facts": self._facts, "open": self._open, "begin": self._begin, "advance": self._advance}

    def metadata(self) -> Metadata:
        """Return the simulator's name."""
        return Metadata(name=self.facts.name, action=())

    def infer(self, observation: Observation) -> Chunk:
        """Refuse: a simulator gives no actions.

        Raises:
            InvalidInput: Always.
        """
        raise InvalidInput(
            f"{self.facts.name} is a simulator, not a policy; `rcs run --simulator` runs policies in it."
        )

    def close(self) -> None:
        """Close the simulator and end its thread."""
        if not self._is_closed:
            self._is_closed = True
            self._thread.submit(self._simulator.close).result()
            self._thread.shutdown()

    def _facts(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {"facts": self.facts.to_dict()}

    def _open(self, values: Mapping[str, Any]) -> dict[str, Any]:
        mapping = SimulatorMapping.from_dict(values.get("mapping"))
        mapping.check(self.facts)
        self._mapping, self._opened = mapping, self._opened + 1
        return {"opened": self._opened}

    def _begin(self, values: Mapping[str, Any]) -> dict[str, Any]:
        self._require_owner(values)
        seed = values.get("seed")
        if not isinstance(seed, int) or not 0 <= seed < 1 << 64:
            raise InvalidInput(f"seed is {seed!r:.40}; valid is a whole number from 0.")
        mapping, self._steps = self._mapping, 0
        start = seed % self.facts.starts if mapping.start == "stored" else None
        moment = self._call(lambda: self._simulator.reset(seed % (1 << 31), start))
        for _ in range(mapping.wait):
            moment = self._call(lambda: self._simulator.step(np.array(mapping.wait_action)))
        return self._values(moment)

    def _advance(self, values: Mapping[str, Any]) -> dict[str, Any]:
        self._require_owner(values)
        action = self._mapping.action_of(np.asarray(values.get("action"), np.float64), self.facts)
        self._steps += 1
        return self._values(self._call(lambda: self._simulator.step(action)))

    def _require_owner(self, values: Mapping[str, Any]) -> None:
        if values.get("opened") != self._opened:
            raise SimulatorTaken("Another client has opened this simulator since; a simulator serves one at a time.")

    def _call(self, act: Callable[[], Moment]) -> Moment:
        return self._thread.submit(act).result()

    def _values(self, moment: Moment) -> dict[str, Any]:
        seen = self._mapping.observation(moment.observation)
        return {
            "observation": observation_to_values(seen) | {"time": self._steps / self.facts.rate},
            "reward": float(moment.reward),
            "success": moment.success,
            "is_over": bool(moment.is_over) or self._steps >= self._mapping.steps,
        }


def load(name: str, options: Mapping[str, str] | None = None) -> ServedSimulator:
    """Return a simulator to serve.

    Args:
        name: `simulator:task`, such as `libero:libero_spatial/0`, or `module:Class:task` for one of your own.
        options: More arguments by name, as JSON, or as text where they are no JSON or are annotated `str`.

    Raises:
        InvalidInput: There is no such simulator, task or option; the message lists those that there are.
        MissingSimulator: It is not installed in this Python.
    """
    head, _, task = name.rpartition(":")
    place = BUILT_IN.get(head, head)
    if ":" not in place or not task:
        raise unknown("simulator", name, [f"{known}:TASK" for known in BUILT_IN])
    make = find("simulator", place, "module:Class:task")
    try:
        return ServedSimulator(prepared("simulator", head, make, [task], options or {}))
    except ModuleNotFoundError as error:
        raise MissingSimulator(head, str(error.name)) from error


def _sources(simulator: Simulator) -> str:
    """Return 16 digits of the SHA-256 of a simulator's module and of those here; new ones for a module without file."""
    own = getattr(sys.modules[type(simulator).__module__], "__file__", None)
    if own is None:
        return uuid.uuid4().hex[:16]
    digest = hashlib.sha256()
    for path in (Path(own), *sorted(Path(__file__).parent.glob("*.py"))):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]
