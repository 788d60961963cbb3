"""How well an episode was recorded: its measured rate, gaps, and images that came twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs.data.feature import Feature
from rcs.data.info import DatasetInfo

# A period this many times the wanted one means that at least one step is missing.
_GAP = 1.5


class QualityMeter:
    """Takes the rows of one episode, in order, and says how well they were recorded."""

    def __init__(self, info: DatasetInfo) -> None:
        """Start with no rows."""
        self._fps = info.fps
        self._times: dict[str, list[NDArray[np.float64]]] = {f.key: [] for f in info.features if f.is_time}
        self._images = {f.key: _Repeats() for f in info.features if f.encoding != "plain"}
        self._captures = {key: _capture_key(key, info.features) for key in self._images}
        self._rows = 0

    def add(self, table: pa.Table) -> None:
        """Take the next rows."""
        self._rows += table.num_rows
        for key, parts in self._times.items():
            parts.append(table.column(key).to_numpy())  # a time that was not measured is NaN
        for key, repeats in self._images.items():
            repeats.add(table.column(key))

    def report(self) -> dict[str, Any]:
        """Return the report as JSON values; what was not measured is None."""
        times = {key: np.concatenate([np.empty(0), *parts]) for key, parts in self._times.items()}
        cameras: dict[str, Any] = {}
        for key, repeats in self._images.items():
            capture = self._captures[key]
            cameras[key] = {
                "repeated_images": repeats.count,
                "repeated_captures": None if capture is None else _repeated(times[capture]),
                "longest_freeze": repeats.longest,
            }
        return {"rows": self._rows, "period": self._period(times), "cameras": cameras}

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
        wanted = 1 / self._fps
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


class _Repeats:
    """Counts images that are byte for byte the one before."""

    def __init__(self) -> None:
        self.count = 0
        self.longest = 0
        self._last: pa.Scalar | None = None
        self._run = 0

    def add(self, images: pa.ChunkedArray) -> None:
        for image in images:
            data = image.as_buffer()
            if self._last is not None and data.equals(self._last):
                self.count += 1
                self._run += 1
                self.longest = max(self.longest, self._run)
            else:
                self._run = 0
            self._last = data


def _capture_key(key: str, features: tuple[Feature, ...]) -> str | None:
    """Return the key of a camera's capture times: "time/frames/wrist" for "observation/frames/wrist/rgb"."""
    parts = key.split("/")
    camera = parts[parts.index("frames") + 1 : -1] if "frames" in parts else []
    name = f"time/frames/{'/'.join(camera)}"
    return name if any(feature.key == name for feature in features) else None


def _repeated(captures: NDArray[np.float64]) -> int:
    return int(np.sum(np.diff(captures) == 0))  # a NaN equals nothing
