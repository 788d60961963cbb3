"""Environments: ports to devices, layers over them, a task, and one clock that lets time pass."""
