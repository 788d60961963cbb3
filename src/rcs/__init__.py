"""The Robot Control Stack: one Gymnasium API for a simulated or a real robot.

Importing it registers the ids of `gymnasium.make` (gymnasium 1.4 no longer looks for plugins by itself) and does
nothing else: the names below are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from rcs.setups import ids

if TYPE_CHECKING:
    from rcs.envs.setup import Setup
    from rcs.setups.make import make, make_vec
    from rcs.sim.randomisation import Randomisation
    from rcs.spatial import Pose

    __version__: str

__all__ = ["Pose", "Randomisation", "Setup", "__version__", "make", "make_vec"]

_HOME_OF = {
    "make": "rcs.setups.make",
    "make_vec": "rcs.setups.make",
    "Setup": "rcs.envs.setup",
    "Randomisation": "rcs.sim.randomisation",
    "Pose": "rcs.spatial",
}


def __getattr__(name: str) -> Any:
    """Load a public name from the module that defines it.

    Raises:
        AttributeError: There is no such name.
    """
    if name == "__version__":
        from importlib.metadata import version

        value = version("robot-control-stack")  # pyproject.toml is the only place that says it
    elif name in _HOME_OF:
        value = getattr(importlib.import_module(_HOME_OF[name]), name)
    else:
        raise AttributeError(f"module 'rcs' has no attribute {name!r}; public names are {', '.join(__all__)}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, loaded or not."""
    return sorted(__all__)


ids.register()
