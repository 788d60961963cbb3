"""Interfaces of devices, which may be implemented in C++ or Python, and their lookup by name."""

# A module with devices in C++ shares these types, which must be loaded first.
from rcs_data.lazy import load_on_use

from rcs import _core  # noqa: F401  # pyright: ignore[reportUnusedImport]

load_on_use(__name__)
