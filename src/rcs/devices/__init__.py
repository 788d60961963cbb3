"""Devices behind one interface each, implementable in C++ or in Python, and how to find them by name."""

# A module with devices in C++ shares its types, which must be there before it.
from rcs_data.lazy import load_on_use

from rcs import _core  # noqa: F401  # pyright: ignore[reportUnusedImport]

load_on_use(__name__)
