"""Count the lines of the three packages by kind: code, docstrings, imports, blank.

    python tools/lines.py [ROOT]

One line per folder of `src/rcs` and per package, and a last line of JSON. `rcs` leaves out `hardware/` and `virtual/`.
"""

from __future__ import annotations

import ast
import json
import statistics
import sys
from collections import Counter
from pathlib import Path

DEVICES = ("hardware", "virtual")
"""Folders of `src/rcs` that count by themselves."""
LONGEST = 400
"""Lines of a file above which it should be split."""


def kinds(path: Path) -> Counter[str]:
    """Return how many lines of a file are what."""
    text = path.read_text()
    lines = text.splitlines()
    found: Counter[str] = Counter(lines=len(lines), blank=sum(not line.strip() for line in lines))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found["imports"] += (node.end_lineno or node.lineno) - node.lineno + 1
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found["docstrings"] += (node.end_lineno or node.lineno) - node.lineno + 1
            found["blank"] -= sum(not line.strip() for line in lines[node.lineno - 1 : node.end_lineno])
    found["code"] = found["lines"] - found["blank"] - found["imports"] - found["docstrings"]
    return found


def count(folder: Path, without: tuple[str, ...] = ()) -> dict[str, object]:
    """Return the figures of all Python files below a folder."""
    files = [one for one in sorted(folder.rglob("*.py")) if one.relative_to(folder).parts[0] not in without]
    each = {one: kinds(one) for one in files}
    total = sum(each.values(), Counter[str]())
    return {
        **{kind: total[kind] for kind in ("lines", "code", "docstrings", "imports", "blank")},
        "files": len(files),
        "median": statistics.median(one["lines"] for one in each.values()) if each else 0,
        "long": [f"{path.relative_to(folder)} {one['lines']}" for path, one in each.items() if one["lines"] > LONGEST],
    }


def main() -> None:
    """Count and print."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1])
    source = root / "src" / "rcs"
    for folder in sorted(one for one in source.iterdir() if one.is_dir() and any(one.rglob("*.py"))):
        print(f"{count(folder)['lines']:6} {folder.relative_to(root)}")
    found = {
        "rcs": count(source, DEVICES),
        **{name: count(source / name) for name in DEVICES},
        "rcs_data": count(root / "packages" / "rcs-data" / "src" / "rcs_data"),
        "vlagents": count(root / "packages" / "vlagents" / "src" / "vlagents"),
    }
    for name, figures in found.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in figures.items()))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
