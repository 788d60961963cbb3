"""Line plots as small SVG texts, without a plotting library."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_WIDTH, _HEIGHT = 520, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 8, 8, 24
# More points than this are not visible at this width.
_POINTS = 130


def line_plot(
    x: NDArray[np.float64], lines: NDArray[np.float64], names: Sequence[str], *, x_label: str, y_label: str
) -> str:
    """Return an SVG of one or more lines over a common axis, with ticks, and a legend where there are several lines.

    The colours are the style sheet's variables `--line-0` to `--line-7`.

    Args:
        x: Shape (points,), ascending.
        lines: Shape (points, len(names)); values that are not finite make gaps.
        names: Name of each line.
        x_label: Name and unit of the x axis.
        y_label: Name and unit of the y axis.
    """
    stride = max(1, math.ceil(len(x) / _POINTS))
    shown = sorted({*range(0, len(x), stride), len(x) - 1})
    x, lines = x[shown], lines[shown]
    x_ticks, y_ticks = _ticks(x), _ticks(lines)
    x_low, x_high = float(x.min()), max(float(x.max()), float(x.min()) + 1e-9)
    y_low, y_high = y_ticks[0], y_ticks[-1]
    across = _LEFT + (x - x_low) / (x_high - x_low) * (_WIDTH - _LEFT - _RIGHT)
    down = _TOP + (y_high - lines) / (y_high - y_low) * (_HEIGHT - _TOP - _BOTTOM)
    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{html.escape(y_label)}">']
    for tick in y_ticks:
        y = _TOP + (y_high - tick) / (y_high - y_low) * (_HEIGHT - _TOP - _BOTTOM)
        parts.append(f'<path class="grid" d="M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 3.5:.1f}" text-anchor="end">{_number(tick, y_ticks)}</text>')
    for tick in (tick for tick in x_ticks if x_low <= tick <= x_high):
        place = _LEFT + (tick - x_low) / (x_high - x_low) * (_WIDTH - _LEFT - _RIGHT)
        label = _number(tick, x_ticks)
        parts += [f'<text x="{place:.1f}" y="{_HEIGHT - 9}" text-anchor="middle">{label}</text>']
    for i in range(lines.shape[1]):
        parts.append(f'<path class="line" style="stroke:var(--line-{i % 8})" d="{_path(across, down[:, i])}"/>')
    parts.append("</svg>")
    caption = f"<figcaption>{html.escape(y_label)} over {html.escape(x_label)}"
    if len(names) > 1:
        keys = (f'<i style="background:var(--line-{i % 8})"></i>{html.escape(n)}' for i, n in enumerate(names))
        caption += f'<span class="keys">{" ".join(keys)}</span>'
    return f"<figure>{''.join(parts)}{caption}</figcaption></figure>"


def _path(across: NDArray[np.float64], down: NDArray[np.float64]) -> str:
    parts: list[str] = []
    pen = "M"
    for x, y in zip(across, down, strict=True):
        if math.isfinite(y):
            parts.append(f"{pen}{x:.0f} {y:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(parts)


def _ticks(values: NDArray[Any]) -> list[float]:
    """Return 3 to 6 round numbers that enclose the values."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if high - low < 1e-6:
        low, high = low - 0.5, high + 0.5
    rough = (high - low) / 4
    unit = 10 ** math.floor(math.log10(rough))
    step = next(unit * factor for factor in (1, 2, 2.5, 5, 10) if unit * factor >= rough)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [i * step for i in range(first, last + 1)]


def _number(tick: float, ticks: Sequence[float]) -> str:
    step = ticks[1] - ticks[0]
    places = max(0, -math.floor(math.log10(step) + 1e-9))
    if abs(step * 10**places - round(step * 10**places)) > 1e-6:
        places += 1
    return f"{tick:.{places}f}".replace("-", "\N{MINUS SIGN}")
