"""Has a Python under `make test-sanitize` load the sanitized extension; its children too, for they inherit the path."""

import importlib.machinery
import importlib.util
import os
import sys
from collections.abc import Sequence
from types import ModuleType


class SanitizedCore:
    """Finds `rcs._core` before the installed package does."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return where the sanitized extension is, and nothing for other modules."""
        if name != "rcs._core":
            return None
        return importlib.util.spec_from_file_location(name, os.environ["RCS_SANITIZED_CORE"])


if "RCS_SANITIZED_CORE" in os.environ:
    sys.meta_path.insert(0, SanitizedCore())
