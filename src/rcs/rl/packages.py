"""The packages of the extra `rl`, imported when they are first used."""

from __future__ import annotations

from typing import Any

from rcs.errors import InvalidSetup
from rcs.extras import package_of


def package(name: str) -> Any:
    """Import and return a package of the extra `rl`, or a module of it.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    return package_of("rl", name, "Training, and running what was trained, need")


def require_device(name: str) -> None:
    """Refuse a device that torch cannot compute on here, for Stable-Baselines3 would take the CPU in its place.

    Args:
        name: As torch names it, such as `cuda`.

    Raises:
        MissingDependency: Torch is not installed.
        InvalidSetup: Torch does not know the device, or it is not here.
    """
    torch = package("torch")
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError) as err:  # the second where torch was built without it
        here = ", ".join(("cpu", *(other for other in ("cuda", "mps") if getattr(torch, other).is_available())))
        raise InvalidSetup(f"device is {name!r}, on which torch cannot compute here; valid is {here}.") from err
