"""Policies by name, as `vlagents serve` makes them."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

from vlagents.errors import InvalidInput
from vlagents.policies.settings import Settings
from vlagents.policy import Policy

GROUP = "vlagents.policies"
"""Entry points of packages that add a policy: a function of the checkpoint."""

BUILT_IN: dict[str, str] = {
    "act": "vlagents.policies.lerobot:act",
    "diffusion": "vlagents.policies.lerobot:diffusion",
    "lerobot": "vlagents.policies.lerobot:LerobotPolicy",
    "octo": "vlagents.policies.octo:OctoPolicy",
    "openpi": "vlagents.policies.openpi:OpenpiPolicy",
    "openvla": "vlagents.policies.openvla:OpenvlaPolicy",
    "openvla_oft": "vlagents.policies.openvla_oft:OpenvlaOftPolicy",
    "random": "vlagents.policies.catalogue:random_policy",
    "replay": "vlagents.policies.replay:ReplayPolicy",
    "scripted": "vlagents.policies.scripted:ScriptedPolicy.load",
    "smolvla": "vlagents.policies.lerobot:smolvla",
    "vjepa2_ac": "vlagents.policies.vjepa2_ac:Vjepa2AcPolicy",
}


def names() -> list[str]:
    """Return the names of all policies that are installed."""
    return sorted({*BUILT_IN, *(point.name for point in entry_points(group=GROUP))})


def load(name: str, checkpoint: str = "", settings: str | Path = "") -> Policy:
    """Return a policy.

    Args:
        name: One of `names()`.
        checkpoint: Folder, file, or whatever else the policy is made of.
        settings: A file that says how its inputs are called; empty for `vlagents.json` in the checkpoint's folder.

    Raises:
        InvalidInput: There is no such policy, or it cannot be made of that.
        MissingStack: What it stands on is not installed.
    """
    if name in BUILT_IN:
        return _made(name, _found(BUILT_IN[name]), checkpoint, settings)
    for point in entry_points(group=GROUP):
        if point.name == name:
            return _made(name, point.load(), checkpoint, settings)
    near = difflib.get_close_matches(name, names(), 1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise InvalidInput(f"There is no policy {name!r}; there are {', '.join(names())}.{hint}")


def hash_of(path: str | Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files by their names and contents."""
    digest = hashlib.sha256()
    path = Path(path)
    for file in [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file()):
        digest.update(f"{file.relative_to(path)}\0".encode())
        with open(file, "rb") as opened:
            while part := opened.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()


def _found(place: str) -> Callable[..., Policy]:
    module, _, path = place.partition(":")
    found = importlib.import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    return found  # type: ignore[return-value]


def _made(name: str, make: Callable[..., Policy], checkpoint: str, settings: str | Path) -> Policy:
    if not settings:
        return make(checkpoint)
    if "settings" not in inspect.signature(make).parameters:
        raise InvalidInput(f"The policy {name!r} has no settings; {str(settings)!r} cannot be used.")
    return make(checkpoint, settings=Settings.read(checkpoint, settings))


def random_policy(checkpoint: str) -> Policy:
    """Return a policy by chance, of as many numbers as the checkpoint says.

    Raises:
        InvalidInput: It says no number.
    """
    from vlagents.policies.random import RandomPolicy

    if checkpoint and not checkpoint.isdecimal():
        raise InvalidInput(f"checkpoint is {checkpoint!r}; of 'random' it is the number of values of an action.")
    return RandomPolicy(size=int(checkpoint or 7))
