"""PyTorch and torchvision as policies import them, with stand-ins for both."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from vlagents import InvalidInput
from vlagents.errors import MissingStack
from vlagents.policies import stack
from vlagents.policies.stack import declare_missing_operators, device, import_stack


class Library:
    """Keeps what is declared."""

    declared: list[str] = []

    def __init__(self, name: str, kind: str) -> None:
        assert (name, kind) == ("torchvision", "DEF")

    def define(self, what: str) -> None:
        self.declared.append(what.partition("(")[0])


def torch(cuda: str | None = None, has_gpu: bool = False) -> Any:
    def zeros(count: int, device: Any) -> None:
        if device.type not in ("cpu", "cuda"[: 4 * has_gpu]):
            raise RuntimeError("there is none")

    def as_device(name: str) -> Any:
        return SimpleNamespace(type=name.partition(":")[0])

    return SimpleNamespace(
        version=SimpleNamespace(cuda=cuda), library=SimpleNamespace(Library=Library), device=as_device, zeros=zeros,
        cuda=SimpleNamespace(is_available=lambda: has_gpu), bfloat16="bfloat16", float32="float32",
    )  # fmt: skip


@pytest.fixture(autouse=True)
def _undeclared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stack, "_declared", [])
    monkeypatch.setattr(Library, "declared", [])


def test_packages_come_in_order_and_a_missing_one_names_the_recipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", torch(cuda="12"))
    monkeypatch.setitem(sys.modules, "timm", ModuleType("timm"))
    found = import_stack("openvla", "torch", "timm")
    assert [found[0].version.cuda, found[1].__name__] == ["12", "timm"]
    with pytest.raises(MissingStack, match="vlagents recipe openvla"):
        import_stack("openvla", "no_such_package")


@pytest.mark.parametrize(
    ("cuda", "library", "is_declared"),
    [
        (None, None, True),
        (None, b"no library", True),
        ("12", None, False),
        (None, "missing", False),
        (None, "empty", False),
    ],
)
def test_operators_are_declared_where_torchvisions_library_does_not_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cuda: str | None, library: Any, is_declared: bool
) -> None:
    spec = importlib.machinery.ModuleSpec("torchvision", None, is_package=True)
    spec.submodule_search_locations = [] if library == "empty" else [str(tmp_path)]
    if isinstance(library, bytes):
        (tmp_path / "_C.so").write_bytes(library)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if library == "missing" else spec)
    for _ in range(2):  # once is enough
        declare_missing_operators(torch(cuda))
    assert Library.declared == (["nms", "qnms"] if is_declared else [])


def test_a_library_that_loads_needs_no_declaration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = importlib.machinery.ModuleSpec("torchvision", None, is_package=True)
    spec.submodule_search_locations = [str(tmp_path)]
    (tmp_path / "_C.so").write_bytes(b"")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec)
    monkeypatch.setattr(stack.ctypes, "CDLL", lambda path: None)
    declare_missing_operators(torch())
    assert not Library.declared


def test_a_model_runs_on_the_gpu_there_is_and_elsewhere_only_if_it_exists() -> None:
    assert device(torch(), "").type == "cpu"
    assert device(torch(has_gpu=True), "").type == "cuda"
    assert device(torch(has_gpu=True), "cpu").type == "cpu"
    with pytest.raises(InvalidInput, match="'cuda:1', which cannot be used"):
        device(torch(), "cuda:1")
