"""Tables of verbs: descriptions are read from source files, and a verb's module is imported when it is used."""

from __future__ import annotations

import ast
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any

Table = dict[str, str]
"""Verbs by name. Each is the `module:Name` of a dataclass with `run()`, or of a table of more verbs."""

_REFERENCE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


def load(reference: str) -> Any:
    """Import and return `module:Name`."""
    return EntryPoint(name="", value=reference, group="").load()


def summary(reference: str) -> str:
    """Return the first sentence of the docstring of `module:Class`, or of the module if it is not a class.

    It is read from the source, since an import might import the simulator; only what the source does not mention is
    imported. Empty without a docstring.
    """
    place, _, name = reference.partition(":")
    source = _source(place)
    if source is not None and name in source.read_text("utf-8"):
        tree = ast.parse(source.read_bytes())
        node = next((node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name), tree)
        text = ast.get_docstring(node)
    else:
        text = load(reference).__doc__
    words = " ".join((text or "").strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) ", words)[0]


def _source(module: str) -> Path | None:
    """Return the file of a module; its package is not imported either. None where it cannot be told."""
    top, *rest = module.split(".")
    spec = find_spec(top)
    if spec is None or not rest:
        origin = None if spec is None else spec.origin
        return Path(origin) if origin is not None and origin.endswith(".py") else None
    places = [Path(folder, *rest) for folder in spec.submodule_search_locations or ()]
    files = [file for place in places for file in (place.with_suffix(".py"), place / "__init__.py")]
    return next((file for file in files if file.is_file()), None)


def overview(program: str, table: Table, more: str = "") -> str:
    """Return the help of a command that has verbs, with a line or two for each, and more words at the end."""
    width = min(shutil.get_terminal_size().columns, 120)
    indent = max(map(len, table)) + 4
    lines = [f"usage: {program} COMMAND …", ""]
    for verb, reference in table.items():
        start = f"  {verb}".ljust(indent)
        lines.append(textwrap.fill(summary(reference), width, initial_indent=start, subsequent_indent=" " * indent))
    return "\n".join([*lines, "", f"`{program} COMMAND --help` describes a command and its options.{more}"])


def let_current_folder_be_imported(arguments: Sequence[str]) -> None:
    """If an argument is a `module:Class`, make modules of the current folder importable, as `python -m` does.

    The folder comes last on the path, so that no file in it shadows an installed module. Worker processes get the same
    path.
    """
    if any(_REFERENCE.fullmatch(argument.rpartition("=")[2]) for argument in arguments) and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
