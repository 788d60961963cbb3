"""Environments: ports to devices, layers over them, a task, and one clock that lets time pass."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
