"""Serves robot policies from their own Python environment, for any robot and any learning framework."""

import importlib
from typing import TYPE_CHECKING, Any

from vlagents.chunk import Chunk
from vlagents.errors import (
    AddressTaken,
    BadMessage,
    ConnectionLost,
    DeadlineExceeded,
    InvalidInput,
    Mismatch,
    MissingStack,
    PolicyFailed,
    Unauthorized,
    VlagentsError,
)
from vlagents.jpeg import Jpeg
from vlagents.metadata import ImageSpec, Metadata, Offer, PartSpec, differences
from vlagents.observation import Observation
from vlagents.policy import Policy

if TYPE_CHECKING:
    from vlagents.client import Client
    from vlagents.remote import connect
    from vlagents.server import Server

__version__ = "0.1.0"

__all__ = [
    "AddressTaken",
    "BadMessage",
    "Chunk",
    "Client",
    "ConnectionLost",
    "DeadlineExceeded",
    "ImageSpec",
    "InvalidInput",
    "Jpeg",
    "Metadata",
    "Mismatch",
    "MissingStack",
    "Observation",
    "Offer",
    "PartSpec",
    "Policy",
    "PolicyFailed",
    "Server",
    "Unauthorized",
    "VlagentsError",
    "connect",
    "differences",
]

_LAZY = {"Client": "client", "Server": "server", "connect": "remote"}
"""Modules of names that are imported when they are first used."""


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        hint = "Use Server(policy), or the command `vlagents serve`. " if name == "serve" else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}. {hint}Public names: {', '.join(__all__)}")
    return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
