"""Mutants of the source, and whether the tests that mirror a mutated file notice.

    python tools/mutants.py [--count 60] [--seed 0] [--only src/rcs/envs ...]

Draws random changes of one expression each: a number, a comparison, True or False, a condition, an operator. Runs the
tests of the mutated file, but for those with the marks `slow`, `cluster` and `interop`: the mirrored ones, those that
mention most of what the module defines, those of its importers, and the laws of all dataclasses, of the motion of
episodes and of the reference pages. Install what the marks `extras` and `hardware` need first.

A mutant is killed when a test fails that passes without it. Counted apart, and no part of the share, are mutants whose
tests take longer than a limit, be they slow or endless, and those for which a test fails without them, too. Prints a
line per mutant, and a last line of JSON. The source is restored at the end, also after Ctrl-C.
"""

from __future__ import annotations

import argparse
import ast
import functools
import json
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

ROOT = Path(__file__).parents[1]
SOURCES = {
    "src/rcs": "tests",
    "packages/rcs-data/src/rcs_data": "packages/rcs-data/tests",
    "packages/vlagents/src/vlagents": "packages/vlagents/tests",
}
"""Folders of sources and of the tests that mirror them."""
MOST_TESTS = 8
"""Test files of a mutant; more would take minutes."""
SHOWN = ("envs", "robots", "setups", "sim", "tasks")
"""Folders of `src/rcs` whose figures are on the reference pages."""
PAGES = "tests/test_docs.py::test_pages_of_tasks_robots_and_options_are_what_the_code_says"
MOVING = ("agents", "envs", "kinematics", "robots", "setups", "sim", "spatial", "tasks")
"""Folders of `src/rcs` that decide how an episode goes on."""
MOTION = "tests/integration/test_same_motion.py"
RECORDS = "tests/test_surface.py::test_records_are_frozen_and_take_their_fields_by_name"
"""The law of all dataclasses."""

SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A change of one expression of a file."""

    path: Path
    line: int
    kind: str
    before: str
    after: str
    start: int
    """Offset in the file's bytes where the expression begins."""

    def apply(self, source: bytes) -> bytes:
        """Return the source with the change."""
        end = self.start + len(self.before.encode())
        return source[: self.start] + f"({self.after})".encode() + source[end:]


def mutated(node: ast.AST) -> tuple[str, ast.expr] | None:
    """Return the kind of change that an expression allows, and the changed expression; None if it allows none."""
    match node:
        case ast.Constant(value=bool(value)):
            return "flag", ast.Constant(not value)
        case ast.Constant(value=int(value)):
            return "number", ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            return "number", ast.Constant(1.0 if value == 0 else 2 * value)
        case ast.Compare(left=left, ops=[op], comparators=right) if type(op) in SWAPS:
            return "comparison", ast.Compare(left, [SWAPS[type(op)]()], right)  # type: ignore[list-item]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in SWAPS:
            return "operator", ast.BinOp(left, SWAPS[type(op)](), right)  # type: ignore[arg-type]
        case ast.BoolOp(op=op, values=values):
            return "operator", ast.BoolOp(SWAPS[type(op)](), values)  # type: ignore[arg-type]
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return "condition", operand
        case _:
            return None


def expressions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all expressions of a tree but annotations, literal types, docstrings and the word of `zip` to be strict."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "type_comment"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                continue
            if isinstance(child, ast.Subscript) and "Literal" in ast.dump(child.value):
                continue
            if isinstance(child, ast.keyword) and child.arg == "strict":
                continue
            if isinstance(child, ast.AST):
                yield child
                yield from expressions(child)


def mutants_of(path: Path) -> list[Mutant]:
    """Return all mutants of a file."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutant] = []
    for node in expressions(ast.parse(source)):
        change = mutated(node)
        if change is None or not isinstance(node, ast.expr):
            continue
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        before = source[start:end].decode()
        found.append(Mutant(path, node.lineno, change[0], before, ast.unparse(change[1]), start))
    return found


def tests_of(path: Path) -> list[str]:
    """Return the test files that mirror a source file, that mention what it defines, and those of its importers.

    Last come laws of the whole: of dataclasses, of an episode's motion, and of the reference pages.
    """
    found = [*mirrors(path), *mentions(path)]
    seen, modules = {path}, [path]
    while modules and len(set(found)) < MOST_TESTS:
        importers = [one for module in modules for one in importers_of(module) if one not in seen]
        found += [test for one in importers for test in mirrors(one)]
        found += [test for one in importers if not mirrors(one) for test in mentions(one)]
        seen |= set(importers)
        modules = list(dict.fromkeys(importers))
    if not found:  # found by its entry point: of tilburg_wire.py, test_tilburg.py
        found = sorted((ROOT / "tests").rglob(f"test_{path.stem.partition('_')[0]}*.py"))
    package, folder, *_ = module_of(path).split(".")
    whole = [RECORDS] if "dataclass(" in path.read_text() else []
    whole += [MOTION] if package == "rcs" and folder in MOVING else []
    whole += [PAGES] if package == "rcs" and folder in SHOWN else []
    return [str(one.relative_to(ROOT)) for one in list(dict.fromkeys(found))[:MOST_TESTS]] + whole


@functools.cache
def text_of(folder: str, pattern: str) -> dict[Path, str]:
    """Return the texts of all files below a folder."""
    return {one: one.read_text() for one in sorted((ROOT / folder).rglob(pattern))}


def module_of(path: Path) -> str:
    """Return the name of a source file's module."""
    folder = next(one for one in SOURCES if path.is_relative_to(ROOT / one))
    below = path.relative_to(ROOT / folder)
    return ".".join([Path(folder).name, *below.with_suffix("").parts]).removesuffix(".__init__")


def mentions(path: Path) -> list[Path]:
    """Return the test files that import a source file or mention what it defines or what it is as a command."""
    module = module_of(path)
    names = [f"from {re.escape(module)} import", f"import {re.escape(module)}\n", f'"{re.escape(module)}:']
    names += [rf"\b{one}\b" for one in defined(path)]
    names += [f'"{path.stem}"'] if ".cli." in module else []
    pattern = re.compile("|".join(names))
    folders = dict.fromkeys(
        [SOURCES[next(one for one in SOURCES if path.is_relative_to(ROOT / one))], *SOURCES.values()]
    )
    counts = {
        one: len(set(pattern.findall(text)))
        for folder in folders
        for one, text in text_of(folder, "test_*.py").items()
        if ".cli." not in module or "cli" in one.parts or one.name == "test_cli.py"
    }
    return sorted((one for one, count in counts.items() if count), key=lambda one: -counts[one])


def importers_of(path: Path) -> list[Path]:
    """Return the source files that import one."""
    module = module_of(path)
    package, _, name = module.rpartition(".")
    words = re.compile(
        rf"from {re.escape(module)} import|from {re.escape(package)} import (?:.*\b)?{name}\b|\"{re.escape(module)}:"
    )
    return [one for folder in SOURCES for one, text in text_of(folder, "*.py").items() if words.search(text)]


def mirrors(path: Path) -> list[Path]:
    """Return the test files that mirror a source file, or where there are none, its folder."""
    folder = next(one for one in SOURCES if path.is_relative_to(ROOT / one))
    tests, below = ROOT / SOURCES[folder], path.relative_to(ROOT / folder)
    own = sorted((tests / below.parent).glob(f"test_{below.stem.rstrip('_')}*.py"))
    return own or sorted((tests / below.parent.parent).glob(f"test_{below.parent.name or below.stem}*.py"))


def defined(path: Path) -> list[str]:
    """Return the public classes and functions of a source file, but for those named like its verbs: run, main."""
    nodes = ast.parse(path.read_text()).body
    names = [node.name for node in nodes if isinstance(node, ast.ClassDef | ast.FunctionDef)]
    return [name for name in names if not name.startswith("_") and (not name.islower() or "_" in name)]


def run(tests: list[str], limit: float | None = None) -> subprocess.CompletedProcess[str]:
    """Run tests, up to the first that fails, for at most `limit` seconds."""
    marks = "not slow and not cluster and not interop"
    # With the settings of all tests, by which paths are those from here, for tests of a package, too.
    options = ["-c", "pyproject.toml", "-q", "-x", "-p", "no:cacheprovider", "-m", marks]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=limit, check=False)


Fate = Literal["killed", "survived", "too long", "unsound"]


def fate_of(mutant: Mutant, tests: list[str], limit: float) -> Fate:
    """Return what tests make of a mutant, in at most `limit` seconds."""
    source = mutant.path.read_bytes()
    try:
        mutant.path.write_bytes(mutant.apply(source))
        made = run(tests, limit) if tests else None
    except subprocess.TimeoutExpired:
        return "too long"
    finally:
        mutant.path.write_bytes(source)
    if made is None or made.returncode in (0, 5):  # 5: all tests have marks that are left out
        return "survived"
    failed = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", made.stdout, re.MULTILINE)
    return "unsound" if run(failed[:1] or tests).returncode else "killed"


def main() -> None:
    """Draw, run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60, help="mutants")
    parser.add_argument("--seed", type=int, default=0, help="same seed and same source, same mutants")
    parser.add_argument("--limit", type=float, default=300.0, help="longest run of a mutant's tests [s]")
    parser.add_argument(
        "--only", nargs="+", type=Path, default=[ROOT / one for one in SOURCES], help="files or folders"
    )
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the source is restored on the way out
    files = sorted(
        {file for one in given.only for file in ([one.resolve()] if one.is_file() else one.resolve().rglob("*.py"))}
    )
    drawn = random.Random(given.seed)
    every = [mutant for file in files for mutant in mutants_of(file)]
    fates: dict[Fate, list[str]] = {"killed": [], "survived": [], "too long": [], "unsound": []}
    for mutant in drawn.sample(every, min(given.count, len(every))):
        begin = time.monotonic()
        fate = fate_of(mutant, tests_of(mutant.path), given.limit)
        change = f"{' '.join(mutant.before.split())} -> {mutant.after}"
        name = f"{mutant.path.relative_to(ROOT)}:{mutant.line} {mutant.kind}: {change}"
        print(f"{fate:8} {time.monotonic() - begin:5.0f} s {name}", flush=True)
        fates[fate].append(name)
    killed, judged = len(fates["killed"]), len(fates["killed"]) + len(fates["survived"])
    results: dict[str, Any] = {"mutants": judged, "killed": killed, "share": round(killed / max(judged, 1), 3)}
    results |= {fate: names for fate, names in fates.items() if fate != "killed"}
    print(json.dumps(results))


if __name__ == "__main__":
    main()
