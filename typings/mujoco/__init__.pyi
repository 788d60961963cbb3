# MuJoCo 4.0 ships without types for its extension modules; this says so, instead of an error at every use.
from typing import Any

def __getattr__(name: str) -> Any: ...
