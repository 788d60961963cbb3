"""Serves robot policies from their own Python environment. Nothing here knows a robot or a learning framework."""

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

__version__ = "0.1.0"

__all__ = [
    "AddressTaken",
    "BadMessage",
    "Chunk",
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
    "Unauthorized",
    "VlagentsError",
    "differences",
]
