"""Policies by name, as `vlagents serve` makes them."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
import json
import os
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

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
    "random": "vlagents.policies.catalogue:random_policy",
    "replay": "vlagents.policies.replay:ReplayPolicy",
    "scripted": "vlagents.policies.scripted:ScriptedPolicy.load",
    "smolvla": "vlagents.policies.lerobot:smolvla",
    "vjepa2_ac": "vlagents.policies.vjepa2_ac:Vjepa2AcPolicy",
}


def names() -> list[str]:
    """Return the names of all policies that are installed."""
    return sorted({*BUILT_IN, *(point.name for point in entry_points(group=GROUP))})


def load(
    name: str, checkpoint: str = "", settings: str | Path = "", options: Mapping[str, str] | None = None
) -> Policy:
    """Return a policy.

    Args:
        name: One of `names()`, or `module:Class`, which is looked for in the current folder, too.
        checkpoint: Folder, file, or whatever else the policy is made of.
        settings: A file that says how its inputs are called; empty for `vlagents.json` in the checkpoint's folder.
        options: More arguments by name, as JSON, or as text where they are none or are annotated `str`.

    Raises:
        InvalidInput: There is no such policy, or it cannot be made of that.
        MissingStack: What it stands on is not installed.
    """
    options = options or {}
    if ":" in name:
        return _made(name, _own(name), [checkpoint] if checkpoint else [], settings, options)
    if name in BUILT_IN:
        return _made(name, _found(BUILT_IN[name]), [checkpoint], settings, options)
    for point in entry_points(group=GROUP):
        if point.name == name:
            return _made(name, point.load(), [checkpoint], settings, options)
    near = difflib.get_close_matches(name, names(), 1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise InvalidInput(f"There is no policy {name!r}; there are {', '.join(names())}, and module:Class.{hint}")


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


def _own(name: str) -> Callable[..., Policy]:
    """Return what is called `module:Class`."""
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        return _found(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InvalidInput(f"There is no policy {name!r}; valid is module:Class. {error}.") from error


def _made(
    name: str, make: Callable[..., Policy], checkpoint: list[str], settings: str | Path, options: Mapping[str, str]
) -> Policy:
    known = inspect.signature(make).parameters
    if settings and "settings" not in known:
        raise InvalidInput(f"The policy {name!r} has no settings; {str(settings)!r} cannot be used.")
    if unknown := [option for option in options if option not in known]:
        valid = ", ".join(f"--{option}" for option in known if option != "settings") or "none"
        raise InvalidInput(f"The policy {name!r} has no option --{unknown[0]}; valid: {valid}.")
    given: dict[str, Any] = {option: _value(text, known[option].annotation) for option, text in options.items()}
    if settings:
        given["settings"] = Settings.read(checkpoint[0] if checkpoint else "", settings)
    try:
        inspect.signature(make).bind(*checkpoint, **given)
    except TypeError as error:
        raise InvalidInput(f"The policy {name!r} cannot be made: {error}.") from error
    made = make(*checkpoint, **given)
    if not isinstance(made, Policy):
        raise InvalidInput(f"{name!r} made {type(made).__name__}; valid is a vlagents.Policy.")
    return made


def _value(text: str, annotation: object) -> Any:
    if annotation in (str, "str"):
        return text
    try:
        return json.loads(text)
    except ValueError:
        return text


def random_policy(checkpoint: str) -> Policy:
    """Return a policy by chance, of as many numbers as the checkpoint says.

    Raises:
        InvalidInput: It says no number.
    """
    from vlagents.policies.random import RandomPolicy

    if checkpoint and not checkpoint.isdecimal():
        raise InvalidInput(f"checkpoint is {checkpoint!r}; of 'random' it is the number of values of an action.")
    return RandomPolicy(size=int(checkpoint or 7))
