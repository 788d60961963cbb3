"""Arguments of edits as the history stores them: Python's numbers, since JSON does not know NumPy's."""

from __future__ import annotations

import numpy as np

from rcs_data.errors import InvalidSetup


def number(value: object, name: str) -> float:
    """Return a number of Python or NumPy as one of Python, whole ones as int; `name` begins the message.

    Raises:
        InvalidSetup: It is not a number.
    """
    if isinstance(value, float | np.floating):
        return float(value)
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return int(value)
    raise InvalidSetup(f"{name} is {value!r:.80}; it must be a number.")


def whole_number(value: object, name: str) -> int:
    """Return a whole number of Python or NumPy as one of Python; `name` begins the message.

    Raises:
        InvalidSetup: It is not a whole number.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return int(value)
    raise InvalidSetup(f"{name} is {value!r:.80}; it must be a whole number.")
