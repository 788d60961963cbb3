"""How chunks of actions are executed: what is asked when, and what is done with an answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, get_args

from rcs.errors import InvalidSetup

Mode = Literal["open_loop", "receding", "ensemble", "rtc"]
"""`open_loop`: execute some rows, hold, ask. `receding`: ask while the rest of the chunk is executed, and change over
when the answer is there. `ensemble`: ask all the time, and execute the mean of all chunks that speak of now (ACT).
`rtc`: as `receding`, but blend over from the chunk in flight (real-time chunking)."""


@dataclass(frozen=True, kw_only=True)
class Execution:
    """How chunks are executed. In all modes actions are picked by time: an answer that is late skips and never lags."""

    mode: Mode = "receding"
    """What is asked when, and what is done with an answer."""
    rows: int | None = None
    """Rows of a chunk that pass, by time, before the next one is asked for. None for all of them in `open_loop`, and
    half of them otherwise; `ensemble` asks as often as it is answered."""
    latency: float = 0.0
    """How much later than asked an answer becomes known, in simulated time [s]. Only where time is simulated, which
    stands still while the policy computes; in real time, answers take as long as they take."""
    valid_for: float | None = None
    """Time to live of an action: how old the observation that it answers may be [s]. Later, the robot holds. None for
    as long as the chunk has rows."""
    decay: float = 0.01
    """ACT's m: the weight of the i-th oldest chunk is exp(-m·i). 0 weighs all alike; more trusts the older ones."""
    on_loss: Literal["reconnect", "end"] = "reconnect"
    """After an error of the policy or its connection, the robot holds; then, connect again and go on, or end the
    episode."""
    retry: float = 1.0
    """How long to hold after an error before the policy is asked again [s]."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidSetup: One is wrong.
        """
        for name, options in (("mode", get_args(Mode)), ("on_loss", ("reconnect", "end"))):
            if getattr(self, name) not in options:
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; valid: {', '.join(map(repr, options))}.")
        if self.rows is not None and (not isinstance(self.rows, int) or isinstance(self.rows, bool) or self.rows < 1):
            raise InvalidSetup(f"rows is {self.rows!r}; valid is a whole number from 1, or None.")
        for own in fields(self):
            value = getattr(self, own.name)
            if own.name not in ("latency", "valid_for", "decay", "retry") or value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
                raise InvalidSetup(f"{own.name} is {value!r}; valid is a number from 0.")
