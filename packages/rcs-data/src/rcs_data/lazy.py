"""Packages whose public names are loaded when they are first used."""

from __future__ import annotations

import ast
import difflib
import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any


class LazyPackage(ModuleType):
    """A package that exports what its `__init__.pyi` imports, each name from the module that defines it."""

    __all__: list[str]
    _homes: dict[str, tuple[str, str]]
    _words: dict[str, str]

    def __getattr__(self, name: str) -> Any:
        """Load a public name.

        Raises:
            AttributeError: There is no such name; the message has the nearest match, or the word that is used here.
        """
        if name not in self._homes:
            near = difflib.get_close_matches(name, self.__all__, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            hint = f" Use {self._words[name]}." if name in self._words else hint
            names = ", ".join(self.__all__) or "none"
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}.{hint} Public names: {names}.")
        module, its_name = self._homes[name]
        is_module = module == self.__name__
        value = (
            importlib.import_module(f"{module}.{its_name}")
            if is_module
            else getattr(importlib.import_module(module), its_name)
        )
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; a public name is not hidden by the module of the same name that defines it."""
        if not (isinstance(value, ModuleType) and self._homes.get(name, (self.__name__,))[0] != self.__name__):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        """Return the public names, loaded or not."""
        return sorted(self.__all__)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the package as its name: cloudpickle does so by itself for modules of the class `ModuleType` alone."""
        return importlib.import_module, (self.__name__,)


def load_on_use(package: str, **words: str) -> None:
    """Have a package load its public names on first use; called from its `__init__.py`.

    Args:
        package: Its `__name__`. The file `__init__.pyi` beside has a line `from module import name as name` for every
            public name, which type checkers read too.
        words: Hints on what to use in place of names that other libraries have.
    """
    module = sys.modules[package]
    stub = ast.parse(Path(str(module.__file__)).with_suffix(".pyi").read_text("utf-8"))
    homes = {
        alias.asname: (str(node.module), alias.name)
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname is not None
    }
    module.__dict__.update(__all__=sorted(homes), _homes=homes, _words=words)
    module.__class__ = LazyPackage
