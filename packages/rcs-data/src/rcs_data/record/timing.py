"""The timing report of an episode: measured rate, gaps, and images that were repeated, late or missing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.files.flags import FrameFlag, companion
from rcs_data.files.info import DatasetInfo

# A period this many times the nominal one means that at least one step is missing.
_GAP = 1.5


class TimingMeter:
    """Makes the timing report of one episode from its rows, in order."""

    def __init__(self, info: DatasetInfo) -> None:
        """Start with no rows."""
        self._frequency = info.frequency
        self._times: dict[str, list[NDArray[np.float64]]] = {f.key: [] for f in info.features if f.is_time}
        self._flags: dict[str, list[NDArray[np.uint8]]] = {f.key: [] for f in info.features if f.is_flags}
        self._images = {f.key: _Repeats() for f in info.features if f.is_image}
        self._captures = {key: companion(key, info.features, "time") for key in self._images}
        self._flags_of = {key: companion(key, info.features, "flags") for key in self._images}
        self._rows = 0

    def add(self, table: pa.Table) -> None:
        """Take the next rows."""
        self._rows += table.num_rows
        # Copies: a view would keep all that was read with it, images and all. Times that were not measured are NaN.
        for key, parts in [*self._times.items(), *self._flags.items()]:
            parts.append(table.column(key).to_numpy().copy())
        for key, repeats in self._images.items():
            repeats.add(table.column(key))

    def report(self) -> dict[str, Any]:
        """Return the report as JSON values; None for what was not measured."""
        times = {key: np.concatenate([np.empty(0), *parts]) for key, parts in self._times.items()}
        cameras: dict[str, Any] = {}
        for key, repeats in self._images.items():
            capture, flags = self._captures[key], self._flags_of[key]
            cameras[key] = {
                "new_images": repeats.new,
                "repeated_images": repeats.count,
                "repeated_captures": None if capture is None else _repeated(times[capture]),
                "longest_freeze": repeats.longest,
                **({} if flags is None else _counts(self._flags[flags])),
            }
        return {"rows": self._rows, "period": self._period(times), "cameras": cameras, "devices": _devices(times)}

    def _period(self, times: dict[str, NDArray[np.float64]]) -> dict[str, Any] | None:
        if "time/monotonic" in times:
            stamps = times["time/monotonic"]
            periods = np.diff(stamps[np.isfinite(stamps)])
        elif "time/period" in times:
            periods = times["time/period"][np.isfinite(times["time/period"])]
        else:
            return None
        if not len(periods):
            return None
        wanted = 1 / self._frequency
        jitter = np.abs(periods - wanted)
        gaps = periods[periods > _GAP * wanted]
        return {
            "expected": wanted,
            "mean": float(periods.mean()),
            "p50": float(np.percentile(periods, 50)),
            "p99": float(np.percentile(periods, 99)),
            "max": float(periods.max()),
            "jitter_p50": float(np.percentile(jitter, 50)),
            "jitter_p99": float(np.percentile(jitter, 99)),
            "jitter_max": float(jitter.max()),
            "gaps": len(gaps),
            "missed_steps": int(np.sum(np.rint(gaps / wanted) - 1)),
            "backwards": int(np.sum(periods <= 0)),
        }


def _devices(times: dict[str, NDArray[np.float64]]) -> dict[str, Any]:
    """Return how each device measured, by its key: rate [1/s], ages at the end of steps [s], repeats, gaps, clock."""
    rows = times.get("time/monotonic")
    found: dict[str, Any] = {}
    for key, taken in times.items():
        name = key.removeprefix("time/")
        is_measured = np.isfinite(taken)
        is_of_loop = name in ("monotonic", "period", "command")
        if rows is None or is_of_loop or name.startswith("device/") or not is_measured.any():
            continue
        if not key.startswith("time/"):  # the simulation's own
            continue
        moments, first = np.unique(taken[is_measured], return_index=True)
        between = np.diff(moments)
        # A device that is faster than the loop has something new in each row, though rows skip some.
        has_waited = np.diff(np.flatnonzero(is_measured)[first]) > 1
        ages = (rows - taken)[is_measured & np.isfinite(rows)]
        found[name] = {
            "rate": float(1 / between.mean()) if len(between) else None,
            "age_p50": float(np.percentile(ages, 50)) if len(ages) else None,
            "age_p99": float(np.percentile(ages, 99)) if len(ages) else None,
            "age_max": float(ages.max()) if len(ages) else None,
            "repeats": _repeated(taken),
            "gaps": int(np.sum((between > _GAP * np.median(between)) & has_waited)) if len(between) else 0,
            "clock": _clock(times.get(f"time/device/{name}"), taken),
        }
    return found


def _clock(device: NDArray[np.float64] | None, host: NDArray[np.float64]) -> dict[str, float] | None:
    """Return the device's clock: what to add to its first time for the host's [s], and how much slower it is [1]."""
    if device is None:
        return None
    is_known = np.isfinite(device) & np.isfinite(host)
    own, other = device[is_known], host[is_known]
    if len(own) < 2 or np.ptp(own) <= 0:
        return None
    slope, offset = np.polyfit(own - own[0], other - own, 1)
    return {"offset": float(offset), "drift": float(slope)}


class _Repeats:
    """Counts new images that equal the one before byte for byte."""

    def __init__(self) -> None:
        self.new = 0
        self.count = 0
        self.longest = 0
        self._last: pa.Scalar | None = None
        self._run = 0

    def add(self, images: pa.ChunkedArray) -> None:
        for image in images:
            if not image.is_valid:
                continue
            self.new += 1
            data = image.as_buffer()
            if self._last is not None and data.equals(self._last):
                self.count += 1
                self._run += 1
                self.longest = max(self.longest, self._run)
            else:
                self._run = 0
            self._last = data


def _counts(flags: list[NDArray[np.uint8]]) -> dict[str, int]:
    """Count the rows with each flag: {"repeated": …, "stale": …, "missing": …, "dropped": …}."""
    whole = np.concatenate([np.empty(0, np.uint8), *flags])
    return {str(flag.name).lower(): int(np.count_nonzero(whole & flag)) for flag in FrameFlag}


def _repeated(captures: NDArray[np.float64]) -> int:
    return int(np.sum(np.diff(captures) == 0))  # a NaN equals nothing
