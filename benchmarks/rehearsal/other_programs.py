"""Tell whether other programs used the cores while a benchmark ran."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

STAT = Path("/proc/stat")
MOST = 0.25
"""Share of the cores above which times and rates say little."""


def watch() -> Callable[[], bool]:
    """Return a function that says whether other programs have used more than `MOST` of the cores since this call.

    Children of this process count as other programs until they have ended.
    """
    began, before = time.monotonic(), used()
    return lambda: used() - before > MOST * (os.cpu_count() or 1) * (time.monotonic() - began)


def used() -> float:
    """Return the time for which the machine's cores have worked, or been withheld, for others than this process [s]."""
    user, nice, system, _, _, irq, softirq, steal = map(int, STAT.read_text("ascii").split()[1:9])
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK") - sum(os.times()[:4])
