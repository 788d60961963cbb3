"""Pages of the site that no file holds: the start page is the README, and the reference comes from the docstrings.

A hook of mkdocs. The reference has a page per public package with every name that its `__init__.pyi` exports. A name
that several packages export is described once, on the first of these pages.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGES = (
    "rcs", "rcs.envs", "rcs.envs.layers", "rcs.tasks", "rcs.agents", "rcs.teleop", "rcs.rollout", "rcs.rl",
    "rcs.devices", "rcs.hardware", "rcs.virtual", "rcs.calibration", "rcs.policy", "rcs.setups", "rcs.robots",
    "rcs.kinematics", "rcs.planning", "rcs.sim", "rcs.spatial", "rcs.testing", "rcs.errors", "rcs_data",
    "rcs_data.check", "rcs_data.edit", "rcs_data.convert", "rcs_data.ledger", "rcs_data.read.torch", "vlagents",
)  # fmt: skip

BEHIND_GUIDES = "---\nsearch: { boost: 0.1 }\n---\n\n"
"""How a page begins that the search of the site shows after those that people have written."""


def path_of(package: str) -> Path:
    """Return the folder of a package; with the suffix `.py` it is the file of a module."""
    folder = {"rcs": "src", "rcs_data": "packages/rcs-data/src", "vlagents": "packages/vlagents/src"}
    return ROOT / folder[package.partition(".")[0]] / package.replace(".", "/")


def homes_of(package: str) -> dict[str, str]:
    """Return where each public name of a package is defined: of a package what it exports, of a module what it has."""
    path = path_of(package)
    names: dict[str, str] = {}
    stub = path / "__init__.pyi"
    if stub.exists():
        for node in ast.parse(stub.read_text("utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.module != package:
                names |= {str(one.asname): f"{node.module}.{one.name}" for one in node.names if one.asname}
        return {name: home for name, home in names.items() if not name.startswith("_")}
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    for node in ast.parse(source.read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):  # a package exports its own names; a module exports names that have `as`
            own = path.is_dir() and str(node.module).startswith(package)
            names |= {one.name: f"{node.module}.{one.name}" for one in node.names if own or one.asname == one.name}
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            names[node.name] = f"{package}.{node.name}"
    return names


def summary_of(package: str) -> str:
    """Return the docstring of a package, which says what it is for."""
    path = path_of(package)
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.get_docstring(ast.parse(source.read_text("utf-8"))) or ""


def reference() -> dict[str, str]:
    """Return every page of the reference by its path."""
    pages: dict[str, str] = {}
    first: dict[str, str] = {}
    for package in PACKAGES:
        homes = homes_of(package)
        elsewhere = {name: home for name, home in homes.items() if home in first}
        parts = [f"{BEHIND_GUIDES}# {package}", summary_of(package)]
        if elsewhere:
            links = (f"- `{package}.{name}`: see [`{first[home]}.{name}`][{home}]" for name, home in elsewhere.items())
            parts.append("\n".join(links))
        for name, home in homes.items():
            if home not in first:
                first[home] = package
                parts.append(f'::: {home}\n    options:\n      heading: "{package}.{name}"\n      toc_label: "{name}"')
        pages[f"reference/{package}.md"] = "\n\n".join(parts) + "\n"
    return pages


def start_page() -> str:
    """Return the README with links that are right within `docs`; links to other files become their names."""

    def move(link: re.Match[str]) -> str:
        text, target = link[1], link[2]
        if "://" in target or target.startswith("#"):
            return link[0]
        return f"[{text}]({target.removeprefix('docs/')})" if target.startswith("docs/") else text

    return re.sub(r"\[([^\]]*)\]\(([^)]+)\)", move, (ROOT / "README.md").read_text("utf-8"))


def on_config(config: Any) -> Any:
    """Add the reference to the last group of the navigation."""
    group = next(iter(config.nav[-1].values()))
    group.append({"Python": [{package: f"reference/{package}.md"} for package in PACKAGES]})
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """Add the pages to those of `docs`."""
    from mkdocs.structure.files import File  # pyright: ignore[reportMissingImports]

    for path, text in {"index.md": start_page(), **reference()}.items():
        files.append(File.generated(config, path, content=text))
    return files
