"""Devices behind one interface each, implementable in C++ or in Python, and how to find them by name."""

from rcs.lazy import load_on_use

load_on_use(__name__)
