"""Mutants of the source, and whether the tests that mirror a mutated file notice.

    python tools/mutants.py [--count 60] [--seed 0] [--only src/rcs/envs ...]

Draws random changes of one expression each: a number, a comparison, True or False, a condition, an operator. Runs the
tests of the mutated file: the mirrored one and all that import the module by its name, without those that are slow. A
mutant is killed when they fail. Prints a line per mutant, and a last line of JSON. The source is restored at the end,
also after Ctrl-C.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
SOURCES = {
    "src/rcs": "tests",
    "packages/rcs-data/src/rcs_data": "packages/rcs-data/tests",
    "packages/vlagents/src/vlagents": "packages/vlagents/tests",
}
"""Folders of sources and of the tests that mirror them."""
MARKS = "not slow and not cluster and not interop and not hardware"
TIME_LIMIT = 300.0
"""Longest run of a mutant's tests [s]; one that never ends counts as killed."""

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
    """Yield all expressions of a tree but those of annotations, literal types and docstrings."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "type_comment"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                continue
            if isinstance(child, ast.Subscript) and "Literal" in ast.dump(child.value):
                continue
            if isinstance(child, ast.AST):
                yield child
                yield from expressions(child)


def mutants_of(path: Path) -> list[Mutant]:
    """Return all mutants of a file."""
    source = path.read_bytes()
    text = source.decode()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutant] = []
    for node in expressions(ast.parse(text)):
        change = mutated(node)
        if change is None or not isinstance(node, ast.expr):
            continue
        before, start = ast.get_source_segment(text, node), starts[node.lineno - 1] + node.col_offset
        if before is not None and source[start : start + len(before.encode())] == before.encode():
            found.append(Mutant(path, node.lineno, change[0], before, ast.unparse(change[1]), start))
    return found


def tests_of(path: Path) -> list[str]:
    """Return the test files that mirror a source file or import its module."""
    folder = next(one for one in SOURCES if path.is_relative_to(ROOT / one))
    tests, below = ROOT / SOURCES[folder], path.relative_to(ROOT / folder)
    module = ".".join([Path(folder).name, *below.with_suffix("").parts]).removesuffix(".__init__")
    found = set((tests / below.parent).glob(f"test_{below.stem}*.py"))
    names = (f"from {module} import", f"import {module}\n", f'"{module}:')
    found |= {one for one in tests.rglob("test_*.py") if any(name in one.read_text() for name in names)}
    if not found:  # the tests of its folder
        found = set((tests / below.parent).glob("test_*.py"))
    return [str(one.relative_to(ROOT)) for one in sorted(found)]


def is_killed(mutant: Mutant, tests: list[str]) -> bool:
    """Return True if tests fail with a mutant in place."""
    source = mutant.path.read_bytes()
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", MARKS, *tests]
    try:
        mutant.path.write_bytes(mutant.apply(source))
        done = subprocess.run(command, cwd=ROOT, capture_output=True, timeout=TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return True
    finally:
        mutant.path.write_bytes(source)
    return done.returncode not in (0, 5)  # 5: there are no tests


def main() -> None:
    """Draw, run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60, help="mutants")
    parser.add_argument("--seed", type=int, default=0, help="same seed and same source, same mutants")
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
    results: dict[str, Any] = {"mutants": 0, "killed": 0, "survived": []}
    for mutant in drawn.sample(every, min(given.count, len(every))):
        tests, begin = tests_of(mutant.path), time.monotonic()
        killed = is_killed(mutant, tests)
        change = f"{' '.join(mutant.before.split())} -> {mutant.after}"
        name = f"{mutant.path.relative_to(ROOT)}:{mutant.line} {mutant.kind}: {change}"
        print(f"{'killed' if killed else 'SURVIVED':8} {time.monotonic() - begin:5.0f} s {name}", flush=True)
        results["mutants"] += 1
        results["killed"] += killed
        if not killed:
            results["survived"].append(name)
    results["share"] = round(results["killed"] / max(results["mutants"], 1), 3)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
