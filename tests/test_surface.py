"""The public surface: what packages export, and that documents and examples need nothing else."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pickle
import pkgutil
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rcs_data
import vlagents
from rcs_data.lazy import LazyPackage
from rcs_data.options import accepted

import rcs
from rcs.envs.setup import Setup

ROOT = Path(__file__).parents[1]
PACKAGES = [
    name
    for root in (rcs, rcs_data)
    for name in (
        root.__name__,
        *(found.name for found in pkgutil.walk_packages(root.__path__, f"{root.__name__}.") if found.ispkg),
    )
]
LAZY = [name for name in PACKAGES if isinstance(importlib.import_module(name), LazyPackage)]
MODULES = ["rcs.errors", "rcs_data.errors", "rcs_data.read.torch"]  # errors are no package; torch is an extra
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def is_ours(module: str) -> bool:
    return module.partition(".")[0] in ("rcs", "rcs_data")


def programs() -> Iterator[tuple[str, str]]:
    """Give every example and every Python snippet of the documents, by where it is."""
    for path in sorted((ROOT / "examples").rglob("*.py")):
        yield str(path.relative_to(ROOT)), path.read_text()
    for path in DOCUMENTS:
        for number, snippet in enumerate(re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)):
            yield f"{path.relative_to(ROOT)}, snippet {number}", snippet


def imports(program: str) -> Iterator[tuple[str, str | None]]:
    """Give the modules of ours that a program imports, and the names that it imports from them."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom) and is_ours(node.module or ""):
            yield from ((str(node.module), alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (
                (alias.name, None) for alias in node.names if alias.name.partition(".")[0] in ("rcs", "rcs_data")
            )


@pytest.mark.parametrize(("where", "program"), list(programs()), ids=lambda text: text if len(text) < 60 else "")
def test_documents_and_examples_import_public_names_only(where: str, program: str) -> None:
    for module, name in imports(program):
        assert module in PACKAGES + MODULES, f"{where} imports {module}, which is no package"
        if name is not None:
            assert name in public(module), f"{where} imports {name} from {module}, which has {public(module)}"


CHANGING = {
    "Caller", "FrameLog", "Guest", "Judgement", "LoopStatistics", "Memory", "Planner", "Program", "Progress",
    "Reference", "Registers", "Scene", "Servo", "Session", "SpeedJoints", "SpeedTcp", "Step", "Stop", "Summary",
    "TrainingProgress",
}  # fmt: skip
"""Dataclasses that change after they were made; all others but the programs of the command line are frozen."""
POSITIONAL = {
    "Bend", "Call", "Finding", "Metadata", "Observation", "Part", "Phase", "RobotFit", "Samples", "Sightings",
}  # fmt: skip
"""Dataclasses of five fields or more that are not given by name alone: of a wire, or in the order of a formula."""


def dataclasses_of(path: Path) -> Iterator[tuple[str, int, dict[str, object]]]:
    """Give each public dataclass of a source file: its name, its number of fields and its options."""
    for node in ast.walk(ast.parse(path.read_text())):
        for mark in getattr(node, "decorator_list", []):
            if (
                isinstance(node, ast.ClassDef)
                and node.name[0] != "_"
                and re.match(r"(dataclasses\.)?dataclass\b(?!_)", ast.unparse(mark))
            ):
                options = {one.arg: ast.literal_eval(one.value) for one in getattr(mark, "keywords", [])}
                yield node.name, sum(isinstance(line, ast.AnnAssign) for line in node.body), options


def test_records_are_frozen_and_take_their_fields_by_name() -> None:
    changing: set[str] = set()
    for path in [*(ROOT / "src").rglob("*.py"), *(ROOT / "packages").glob("*/src/**/*.py")]:
        for name, fields, options in dataclasses_of(path):
            is_program = "cli" in path.parts and not options.get("frozen")
            if not options.get("frozen") and not is_program:
                changing.add(name)
            if (is_program or fields > 4) and name not in CHANGING | POSITIONAL:
                assert options.get("kw_only"), f"{name} of {path}: kw_only"
    assert changing == CHANGING, "freeze it, or add it there"


def test_examples_reach_below_no_public_name() -> None:
    for path in (ROOT / "examples").rglob("*.py"):
        assert not re.search(r"\b(?:rcs|env|world)\.(?:_\w|core\b)", path.read_text()), path


DOCUMENTED = [
    path
    for folder in ("src", "packages", "tools", "benchmarks", "examples", "tests")
    for pattern in ("*.py", "*.pyi")
    for path in sorted((ROOT / folder).rglob(pattern))
]


def documentation(program: str) -> Iterator[tuple[int, str]]:
    """Give every docstring of a program, also of attributes, with the number of its line."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def test_every_docstring_begins_with_a_noun_or_an_imperative() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.split(maxsplit=3)[:3]}"
        for path in DOCUMENTED
        for line, text in documentation(path.read_text("utf-8"))
        if text.split(maxsplit=1)[:1] in (["What"], ["Of"])
    ]
    assert not found, "\n".join(found)


def test_no_program_beside_the_packages_hides_a_module_of_python() -> None:
    found = [path for folder in ("benchmarks", "examples", "tools") for path in (ROOT / folder).rglob("*.py")]
    assert found
    assert [path for path in found if path.stem in sys.stdlib_module_names] == []


def test_every_package_that_exports_names_is_there_after_the_import_of_the_first() -> None:
    found = [name.rpartition(".")[2] for name in LAZY if name.count(".") == 1 and name.startswith("rcs.")]
    assert [name for name in found if name not in public("rcs")] == []


def public(module: str) -> list[str]:
    found = importlib.import_module(module)
    return list(getattr(found, "__all__", [name for name in vars(found) if not name.startswith("_")]))


@pytest.mark.parametrize("package", LAZY)
def test_every_name_that_a_package_lists_is_there(package: str) -> None:
    module = importlib.import_module(package)
    assert dir(module) == sorted(module.__all__)
    assert [name for name in module.__all__ if getattr(module, name, None) is None] == []
    assert [name for name in module.__all__ if name.startswith("_") and name != "__version__"] == []


@pytest.mark.parametrize("package", LAZY)
def test_a_package_is_pickled_as_its_name(package: str) -> None:
    module = importlib.import_module(package)
    assert pickle.loads(pickle.dumps(module)) is module


def test_a_name_means_the_same_in_every_package() -> None:
    homes: dict[str, set[int]] = {}
    for package in LAZY:
        for name in public(package):
            homes.setdefault(name, set()).add(id(getattr(importlib.import_module(package), name)))
    assert [name for name, meanings in homes.items() if len(meanings) > 1] == []


def test_a_public_function_is_not_hidden_by_the_module_of_its_name() -> None:
    importlib.import_module("rcs.rollout.collect")
    from rcs.rollout import collect

    assert inspect.isfunction(collect)
    assert inspect.isfunction(importlib.import_module("rcs.rollout").collect)


@pytest.mark.parametrize("make", [rcs.make, rcs.make_vec])
def test_the_signature_of_make_shows_every_option_with_its_default_and_type(make: object) -> None:
    shown = inspect.signature(make).parameters  # pyright: ignore[reportArgumentType]
    for own in dataclasses.fields(Setup):  # pyright: ignore[reportArgumentType]
        if own.name not in ("task", "layers", "gates"):  # `make` takes classes and objects, too
            assert shown[own.name].default == getattr(Setup(), own.name)
            assert shown[own.name].annotation == accepted(own)
    assert "options" not in shown


def test_a_mistyped_option_gets_the_nearest_one() -> None:
    with pytest.raises(rcs.errors.InvalidSetup, match=r"no option of Setup named 'contrl'. Did you mean 'control'"):
        rcs.make(contrl="joints")  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize(
    ("tried", "words"),
    [
        ("rcs.list()", "`rcs list`"),
        ("rcs.data", r"rcs\.Dataset"),
        ("rcs.Recorder", r"rcs\.record\(env"),
        ("rcs.calibrate", "Did you mean 'calibration'"),
        ("rcs.planning.plan", r"Planner\("),
        ("rcs.agents.expert_for", r"agent_for\(env\)"),
        ("rcs_data.open('x')", r"Dataset\(path\)"),
        ("rcs_data.load", r"Dataset\(path\)"),
        ("rcs_data.Dataset('x')", "There is no dataset in .*/x"),
        ("rcs_data.export", r"rcs_data\.convert"),
        ("vlagents.serve", r"Server\(policy\)"),
        ("rcs.make('pick_cuboid')", "Did you mean 'PickCuboid'"),
        ("rcs.make('PickCuboid', max_steps=100)", "Use max_episode_steps"),
        ("rcs.make('PickCuboid', lift_height=0.05)", r"task_options=\{'lift_height': 0\.05\}"),
        ("rcs.make('Free', hardware='192.168.0.1')", "'franka:192"),
        ("rcs.make('Free', hardware=True)", "'driver:address'"),
        ("env.model", r"env\.simulation\.world\.model"),
        ("env.scenario", r"env\.simulation"),
        ("env.task", r"env\.simulation\.task"),
        ("env.world", r"env\.simulation\.world"),
        ("env.robot", r"env\.setup\.robot"),
        ("env.expert()", r"rcs\.agents\.agent_for\(env\)"),
        ("env.observation", r"env\.reset and env\.step"),
        ("env.step(np.zeros(8))", r"rcs\.rl\.FlatEnv"),
        ("env.step({'joints': np.zeros(7)})", r"missing \['gripper'\]"),
    ],
)
def test_a_word_that_is_tried_gets_the_one_that_is_used_here(env: rcs.Env, tried: str, words: str) -> None:
    with pytest.raises((AttributeError, rcs.errors.RcsError, rcs_data.errors.InvalidSetup), match=words):
        eval(tried, {"rcs": rcs, "rcs_data": rcs_data, "vlagents": vlagents, "np": np, "env": env})


def test_forms_that_are_tried_first_work(env: rcs.Env) -> None:
    assert env.reset(42)[0].keys() == env.reset(seed=42)[0].keys()
    env.step({"joints": [0.0] * 7, "gripper": 1.0})
    for cameras in (True, "wrist", ["wrist"]):
        rcs.make("PickCuboid", cameras=cameras).close()
    rcs.make_vec("PickCuboid", 2).close()
    assert rcs.kinematics.kinematics_of("fr3").forward(np.array(rcs.robots.FR3.home)).translation[2] > 0.4
    for module in (rcs.calibration, rcs.policy):
        assert inspect.ismodule(module)
    assert len({rcs.Env, rcs.VecEnv, rcs.Dataset, vlagents.Client, vlagents.Server, vlagents.connect}) == 6


@pytest.fixture(scope="module")
def env() -> Iterator[rcs.Env]:
    with rcs.make("PickCuboid") as env:
        env.reset(seed=0)
        yield env
