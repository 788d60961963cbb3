"""Arguments for the fuzzer: right ones, nearly right ones, and whatever else a call may be given."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable
from typing import Any

import numpy as np

CAPS = {
    "copies": 40,
    "threads": 6,
    "iterations": 60,
    "restarts": 40,
    "max_substeps": 1000,
    "period_numerator": 2000,
    "joint_count": 2000,
    "max_width": 1000,
    "max_height": 1000,
}
"""Who asks for a billion copies or a year of simulated time gets them, if the machine lasts; the fuzzer asks not."""

HOSTILE: tuple[Callable[[random.Random], Any], ...] = (
    lambda r: None,
    lambda r: r.choice([True, False, np.True_]),
    lambda r: r.choice([0, 1, -1, 2, 3, 7, -(2**31), 2**31 - 1, 2**31, 2**32 + 1, 2**63 - 1, 2**64, -(2**63) - 1]),
    lambda r: r.choice([0.0, -0.0, 0.5, -1.0, 1e-320, 1e9, 1e300, -1e300, math.nan, math.inf, -math.inf]),
    lambda r: r.choice(["", "x", "qpos", "body_mass", "geom_rgba", "a\0b", "\ud800", "ä" * 1000]),
    lambda r: r.choice([b"", b"abc", bytearray(8), memoryview(b"12345678")]),
    lambda r: r.choice([[], [[]], (), {}, set(), [1, [2]], ["a"], [None], [math.nan] * 7, list(range(7)), range(3)]),
    lambda r: r.choice([object(), object, int, len, NotImplemented, ..., Exception("x"), 3 + 4j]),
    lambda r: r.choice([np.float32(1), np.int64(2), np.uint8(255), np.str_("a")]),
    # NumPy offers their bytes without strides, which nanobind 3.1 would read all the same.
    lambda r: r.choice([np.datetime64("2020"), np.timedelta64(3), np.array(["2020"], "datetime64[s]")]),
    lambda r: np.zeros(r.choice([(), (0,), (1,), (3,), (7,), (2, 7), (0, 7), (1, 2, 3), (4, 4), (3, 0)])),
    lambda r: np.full(r.choice([1, 3, 7]), r.choice([math.nan, math.inf, -math.inf, 1e300, 1e-320])),
    lambda r: r.choice([np.array([2, 0], np.int32), np.array([0, 0], np.int32), np.array([-1, 99], np.int32)]),
    lambda r: np.array([r.random() < 0.5 for _ in range(r.choice([0, 1, 3, 5]))]),
    lambda r: np.array([2**32 + 1, -(2**40)]),
    lambda r: np.array([0.9, 1.9]),
    lambda r: np.ma.array([1.0, 2.0, 3.0], mask=[True, False, True]),
    lambda r: np.array([None, "x"], object),
)


def hostile(r: random.Random) -> Any:
    """Return anything."""
    return r.choice(HOSTILE)(r)


def near(r: random.Random, good: Any) -> Any:
    """Return something that is almost the right value."""
    if isinstance(good, np.ndarray):
        try:
            return _near_array(r, good)
        except (TypeError, ValueError, IndexError):  # it was no right value itself
            return hostile(r)
    if isinstance(good, list | tuple):
        items = list(good)
        change = r.randrange(5)
        if change == 0 and items:
            items.pop()
        elif change == 1:
            items.append(items[0] if items else 0)
        elif change == 2 and items:
            items[r.randrange(len(items))] = hostile(r)
        elif change == 3:
            return np.array(items, object) if items else np.zeros(0)
        else:
            return tuple(items)
        return items
    if isinstance(good, bool | str) or good is None:
        return r.choice([good, not good, str(good), int(bool(good)), np.bool_(bool(good))])
    if isinstance(good, int | float):
        return r.choice(
            [
                good + 1,
                good - 1,
                -good,
                float(good),
                str(good),
                np.float32(good),
                good * 1e9,
                math.nan,
                math.inf,
                [good],
            ]
        )
    return hostile(r)


def _near_array(r: random.Random, good: np.ndarray[Any, Any]) -> Any:
    array = good.copy()
    match r.randrange(11):
        case 0:
            return array.astype(
                r.choice([np.float32, np.float16, np.int64, np.int32, np.uint8, np.bool_, object, complex])
            )
        case 1:
            return array[:-1] if array.ndim else array
        case 2:
            return np.concatenate([array, array]) if array.ndim else array[None]
        case 3:
            return array[None] if r.random() < 0.5 else array[..., None]
        case 4:
            return array.T[::-1] if array.ndim else array
        case 5:
            return np.asfortranarray(np.repeat(array, 2, axis=0)[::2]) if array.ndim else array
        case 6:
            array.flags.writeable = False
            return array
        case 7 if array.size and array.dtype.kind == "f":
            array.flat[r.randrange(array.size)] = r.choice([math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-320])
            return array
        case 8 if array.size and array.dtype.kind in "iu":
            info = np.iinfo(array.dtype)
            array.flat[r.randrange(array.size)] = r.choice([info.min, info.max, array.flat[0], 99])
            return array
        case 9:
            return array.tolist()
        case _:
            return array[:0]


def cap(name: str, value: Any) -> Any:
    """Return the value, or a smaller one where a large one is a wish and no mistake."""
    limit = CAPS.get(name)
    if limit is None or isinstance(value, bool) or not isinstance(value, int | float) or not value > limit:
        return value
    return limit if not math.isfinite(value) else type(value)(int(value) % (limit + 1))


def array_of(r: random.Random, annotation: str) -> np.ndarray[Any, Any]:
    """Return an array that fits an annotation of the stubs."""
    dtype = re.search(r"\b(float64|float32|uint8|uint16|int32|int64)", annotation)
    shape = re.search(r"shape=\(([^)]*)\)", annotation)
    sizes = [part.strip() for part in shape[1].split(",") if part.strip()] if shape else ["*"]
    dims = [r.choice([1, 2, 3, 6, 7]) if size in ("None", "*") else int(size) for size in sizes]
    values = np.array([r.uniform(-1, 1) for _ in range(math.prod(dims))]).reshape(dims)
    kind = np.dtype(dtype[1] if dtype else "float64")
    return values.astype(kind) if kind.kind == "f" else np.abs(values * 3).astype(kind)
