"""Recipes of environments: a shell script for each family of policies, beside its adapter.

A recipe is run as `vlagents recipe NAME | sh -s -- FOLDER`. It has names and versions, no addresses: what is on no
package index is a checkout on this machine, whose folder a variable names.
"""

from __future__ import annotations

import difflib
from pathlib import Path

from vlagents.errors import InvalidInput

_FOLDER = Path(__file__).parent
_ENDING = ".recipe.sh"

SHARED = {"act": "lerobot", "diffusion": "lerobot", "smolvla": "lerobot"}
"""Policies that live in another one's environment."""


def names() -> list[str]:
    """Return the families that have a recipe of their own."""
    return sorted(path.name[: -len(_ENDING)] for path in _FOLDER.glob(f"*{_ENDING}"))


def read(family: str) -> str:
    """Return a family's recipe, its own or the one it shares.

    Raises:
        InvalidInput: There is none.
    """
    family = SHARED.get(family, family)
    if family not in names():
        valid = sorted({*names(), *SHARED})
        near = difflib.get_close_matches(family, valid, 1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise InvalidInput(f"There is no recipe {family!r}; there are {', '.join(valid)}.{hint}")
    return (_FOLDER / f"{family}{_ENDING}").read_text(encoding="utf-8")
