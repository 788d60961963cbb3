"""Packages as policies import them: the error names the recipe, and torchvision works beside a torch for the CPU."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import logging
from pathlib import Path
from typing import Any

from vlagents.errors import InvalidInput, MissingStack

_log = logging.getLogger(__name__)
_declared: list[Any] = []
"""Holds what was declared: it ends with the object that declared it."""


def import_stack(policy: str, *packages: str) -> list[Any]:
    """Return packages that a policy needs.

    Args:
        policy: Its name, which is that of its recipe.
        packages: Names of modules; those that stand on torch come after it.

    Raises:
        MissingStack: One is not installed.
    """
    found = []
    for package in packages:
        try:
            found.append(importlib.import_module(package))
        except ImportError as error:  # a package of the same name may be another project's, and lack the module
            raise MissingStack(policy, error.name or package) from error
        if package == "torch":
            declare_missing_operators(found[-1])
    return found


def declare_missing_operators(torch: Any) -> None:
    """Declare torchvision's operators where its library cannot be loaded.

    The index's torchvision is linked with CUDA, so with a torch for the CPU its library does not load; then importing
    any of its Python fails at `torchvision::nms`, which it describes without having it. Transforms need none of them.
    """
    if _declared or torch.version.cuda is not None:
        return
    spec = importlib.util.find_spec("torchvision")
    if spec is None or not spec.submodule_search_locations:
        return
    library = next(Path(spec.submodule_search_locations[0]).glob("_C*.so"), None)
    try:
        if library is not None:
            ctypes.CDLL(str(library))
            return
    except OSError:
        _log.info("torchvision's operators for boxes do not load beside this torch; no policy here uses them")
    operators = torch.library.Library("torchvision", "DEF")
    for name in ("nms", "qnms"):
        operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    _declared.append(operators)


def device(torch: Any, wanted: str) -> Any:
    """Return where a model runs: what is wanted, else a GPU if there is one.

    Raises:
        InvalidInput: There is no such device.
    """
    name = wanted or ("cuda" if torch.cuda.is_available() else "cpu")
    try:
        found = torch.device(name)
        torch.zeros(1, device=found)
    except (RuntimeError, AssertionError) as error:
        raise InvalidInput(f"device of the settings is {name!r}, which cannot be used here: {error}") from error
    return found
