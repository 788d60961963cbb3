"""The code in README and documents runs as it is written, and pages that are made from the code are current."""

from __future__ import annotations

import importlib.util
import re
import shlex
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from msgspec.structs import replace
from rcs_data.ledger import Ledger

from rcs.cli.main import main

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)]*)?\)")
PYTHON, SHELL, NOT_RUN = "python", "sh", {"text", "toml", "json", "xml"}
NEED_EXTRAS = ("docs/calibration.md", "docs/planning.md")
SLOW = ("README.md", "docs/data.md", "docs/guide.md", "docs/layout.md")  # they collect and export datasets
MOST_LINES_OF_README = 150
OWN_ROBOT = ROOT / "examples" / "06_own_robot" / "src"  # the package that docs/extend/robot.md shows pieces of


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def snippets(path: Path) -> list[tuple[str, str]]:
    return FENCE.findall(path.read_text("utf-8"))


def tool(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_python(program: str, page: ModuleType) -> None:
    if "torch" in program and importlib.util.find_spec("torch") is None:
        return  # `make test-extras` runs this one
    exec(compile(program, page.__name__, "exec"), vars(page))


def run_shell(program: str) -> None:
    for line in program.splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["rcs"]:
            with pytest.raises(SystemExit) as end:
                main(words[1:])
            assert end.value.code == 0, line


def to_run(path: Path) -> object:
    marks = [pytest.mark.extras] * (name_of(path) in NEED_EXTRAS) + [pytest.mark.slow] * (name_of(path) in SLOW)
    return pytest.param(path, marks=marks, id=name_of(path))


@pytest.mark.gl
@pytest.mark.parametrize("path", [to_run(path) for path in PAGES])
def test_what_a_page_shows_runs_in_order(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(OWN_ROBOT)
    page = ModuleType(f"page_{path.stem}")  # found by its name, as a task of one's own must be
    monkeypatch.setitem(sys.modules, page.__name__, page)
    for language, program in snippets(path):
        if language == PYTHON:
            run_python(program, page)
        elif language == SHELL:
            run_shell(program)


def test_other_readers_of_a_ledger_count_last_answers_and_no_repetitions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_shell("rcs eval PickCuboid --episodes 2 --max-episode-steps 2 --workers 1 --out evaluation")
    with Ledger("evaluation") as ledger:
        one, other = ledger.rows.values()
        assert (one.success, other.success) == (False, False)
        assert ledger.add(replace(one, success=True, corrections=1))
        assert ledger.add(replace(other, success=True, repeat=1))
    page = ModuleType("page")
    for _, program in snippets(ROOT / "docs" / "evaluation.md"):
        if "ledger.jsonl" in program:
            run_python(program, page)
    found = vars(page)
    assert found["rows"]["success"].tolist() == [False, True]
    assert [rate[1:] for rate in found["rates"].fetchall()] == [("PickExpert", None, 0.5, 2)]


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_every_snippet_says_what_it_is(path: Path) -> None:
    assert {language for language, _ in snippets(path)} <= {PYTHON, SHELL, *NOT_RUN}


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_links_and_pictures_lead_to_files(path: Path) -> None:
    targets = [target for target, _ in LINK.findall(path.read_text("utf-8")) if "://" not in target]
    assert [target for target in targets if not (path.parent / target).exists()] == []


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) < MOST_LINES_OF_README


def test_pages_of_tasks_robots_and_options_are_what_the_code_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "tools")
    made: dict[Path, str] = tool("reference_pages").pages()
    stale = [name_of(path) for path, text in made.items() if path.read_text("utf-8") != text]
    assert stale == [], "run: python tools/reference_pages.py"


def test_every_extra_is_explained_where_one_installs() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    _, _, table = (ROOT / "docs" / "start.md").read_text("utf-8").partition("| extra | for |\n")
    assert sorted(re.findall(r"^\| `(\w+)` \|", table.partition("\n\n")[0], re.MULTILINE)) == sorted(extras)


def test_the_glossary_defines_each_word_once_in_alphabetical_order() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text("utf-8")
    words = [word.lower() for word in re.findall(r"^\| \*\*(.+?)\*\* \|", text, re.MULTILINE)]
    assert words == sorted(set(words)) and len(words) > 40


def test_the_search_of_the_site_shows_what_people_wrote_before_the_reference() -> None:
    site: Any = tool("site_pages")
    for page in site.reference().values():
        boost = re.match(r"---\nsearch: \{ boost: ([\d.]+) \}\n---\n\n# ", page)
        assert boost is not None and float(boost[1]) < 0.5


def test_every_package_that_exports_names_has_a_page_in_the_reference() -> None:
    site: Any = tool("site_pages")
    sources = [ROOT / "src", *(ROOT / "packages").glob("*/src")]
    stubs = [(source, stub.parent) for source in sources for stub in source.rglob("__init__.pyi")]
    exporting = [".".join(package.relative_to(source).parts) for source, package in stubs]
    assert exporting and [package for package in exporting if package not in site.PACKAGES] == []


def test_every_public_name_has_a_place_in_the_reference() -> None:
    site: Any = tool("site_pages")
    text = "\n".join(site.reference().values())
    missing = [f"{package}.{name}" for package in site.PACKAGES for name in site.homes_of(package)
               if f"{package}.{name}" not in text]  # fmt: skip
    assert missing == []


def test_examples_of_docstrings_are_shown_as_code() -> None:
    sources = [file for folder in ("src", "packages") for file in (ROOT / folder).rglob("*.py")]
    wrong = [name_of(file) for file in sources if re.search(r"^ *Example:$", file.read_text("utf-8"), re.MULTILINE)]
    assert wrong == [], "Examples:, with an s, is the section of code; another heading would be a quotation"
