"""Policies by name, as `vlagents serve` makes them, and recipes of their environments."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from vlagents.errors import InvalidInput
from vlagents.lookup import find, prepared, unknown
from vlagents.policies.settings import Settings
from vlagents.policy import Policy

ENDING = ".recipe.sh"
GROUP = "vlagents.policies"
"""Entry points of packages that add a policy: a function of the checkpoint."""

BUILT_IN: dict[str, str] = {
    "act": "vlagents.policies.lerobot:LerobotPolicy",
    "diffusion": "vlagents.policies.lerobot:LerobotPolicy",
    "lerobot": "vlagents.policies.lerobot:LerobotPolicy",
    "octo": "vlagents.policies.octo:OctoPolicy",
    "openpi": "vlagents.policies.openpi:OpenpiPolicy",
    "openvla": "vlagents.policies.openvla:OpenvlaPolicy",
    "random": "vlagents.policies.random:RandomPolicy",
    "replay": "vlagents.policies.replay:ReplayPolicy",
    "smolvla": "vlagents.policies.lerobot:LerobotPolicy",
    "vjepa2_ac": "vlagents.policies.vjepa2_ac:Vjepa2AcPolicy",
}
"""Class of each policy of this package."""
FAMILIES = ("act", "diffusion", "smolvla")
"""Policies of LeRobot's class, which gets their name as its `family`."""


def names() -> list[str]:
    """Return the names of all policies that are installed."""
    return sorted({*BUILT_IN, *(point.name for point in entry_points(group=GROUP))})


def load(
    name: str, checkpoint: str = "", settings: str | Path = "", options: Mapping[str, str] | None = None
) -> Policy:
    """Return a policy.

    Args:
        name: One of `names()`, or `module:Class` or `module:function`, which may be in the current folder.
        checkpoint: Folder, file, or another first argument of the policy.
        settings: File with `Settings`; empty for `vlagents.json` in the checkpoint's folder.
        options: More arguments by name, as JSON, or as text where they are no JSON or are annotated `str`.

    Raises:
        InvalidInput: There is no such policy, or an argument is wrong.
        MissingStack: A package that it needs is not installed.
    """
    options = dict(options or {})
    if ":" in name:
        if os.getcwd() not in sys.path:
            sys.path.insert(0, os.getcwd())
        make = find("policy", name)
    elif name in BUILT_IN:
        make = find("policy", BUILT_IN[name])
        options |= {"family": name} if name in FAMILIES else {}
    else:
        points = {point.name: point for point in entry_points(group=GROUP)}
        if name not in points:
            raise unknown("policy", name, names())
        make = points[name].load()
    more: dict[str, Any] = {"settings": Settings.read(checkpoint, settings)} if settings else {}
    made = prepared("policy", name, make, [checkpoint] if checkpoint else [], options, **more)()
    if not isinstance(made, Policy):
        raise InvalidInput(f"{name!r} made {type(made).__name__}; valid is a vlagents.Policy.")
    return made


def hash_of(path: str | Path, settings: Settings | None = None, code: Path | None = None) -> str:
    """Return the SHA-256 of a file, or of a folder's files by their names and contents.

    Args:
        path: The file or folder.
        settings: Settings of a policy; where they are others than those of the folder, they count, but for the device.
        code: A file of Python that the policy is made of; it counts where it is outside of the folder.

    Raises:
        InvalidInput: The folder has settings that cannot be read.
    """
    digest = hashlib.sha256()
    path = Path(path)
    for file in [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file()):
        digest.update(f"{file.relative_to(path)}\0".encode())
        with open(file, "rb") as opened:
            while part := opened.read(1 << 20):
                digest.update(part)
    if settings is not None and (used := _material(settings)) != _material(Settings.read(path)):
        digest.update(f"settings\0{used}".encode())
    if code is not None and not code.resolve().is_relative_to(path.resolve()):
        digest.update(b"code\0" + code.read_bytes())
    return digest.hexdigest()


def _material(settings: Settings) -> str:
    """Return all settings on which actions may depend, as JSON."""
    return json.dumps({**settings.to_dict(), "device": ""}, sort_keys=True)


def recipes() -> list[str]:
    """Return the families that have a recipe: a shell script that makes their environment."""
    return sorted(path.name[: -len(ENDING)] for path in Path(__file__).parent.glob(f"*{ENDING}"))


def recipe(family: str) -> str:
    """Return a family's recipe.

    It is run as `vlagents recipe NAME | sh -s -- FOLDER`. It has names and versions, no addresses: a package that is on
    no index is a checkout on this machine, whose folder a variable names.

    Raises:
        InvalidInput: There is none.
    """
    family = "lerobot" if family in FAMILIES else family
    if family not in recipes():
        raise unknown("recipe", family, sorted([*recipes(), *FAMILIES]))
    return (Path(__file__).parent / f"{family}{ENDING}").read_text(encoding="utf-8")
