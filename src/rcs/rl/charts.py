"""Charts of figures over the steps of a training, as SVG in a page."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

_HEIGHT = 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 54, 18, 8, 22
_COLOURS = 8
"""So many colours of lines has the style that all pages share."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """A line of a chart."""

    name: str
    x: Sequence[int]
    """Steps."""
    y: Sequence[float]
    low: Sequence[float] = ()
    """Lower ends of intervals; empty for none."""
    high: Sequence[float] = ()
    """Upper ends of intervals."""
    told: Sequence[str] = ()
    """What is said of each point; its number when not given."""
    colour: int = 0
    """Of the style's lines, from 0."""


def chart(
    title: str, series: Sequence[Series], *, most: int, span: tuple[float, float] | None = None, width: int = 460
) -> str:
    """Return a chart as a `figure`.

    Args:
        title: What is shown, with its unit.
        series: Lines, at least one, none without points.
        most: Steps at the right end.
        span: Lower and upper end of the vertical axis; None for those of the figures.
        width: Of the drawing, in its own units; its height is 190.
    """
    low, high = span if span is not None else _span(series)
    inner, tall = width - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def place(x: float, y: float) -> str:
        shown = min(max(y, low), high)
        return f"{_LEFT + inner * x / most:.1f},{_TOP + tall * (high - shown) / (high - low):.1f}"

    parts: list[str] = []
    for value in ticks(low, high):
        y = place(0, value).split(",")[1]
        parts.append(f'<line class="rule" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{float(y) + 4:.1f}" text-anchor="end">{short(value)}</text>')
    for value in ticks(0, most):
        x = float(place(value, low).split(",")[0])
        parts.append(f'<text x="{x:.1f}" y="{_HEIGHT - 6}" text-anchor="middle">{short(value)}</text>')
    for one in series:
        paint = _paint(one)
        if one.low:
            there = [place(x, y) for x, y in zip(one.x, one.high, strict=True)]
            back = [place(x, y) for x, y in zip(one.x, one.low, strict=True)][::-1]
            parts.append(f'<polygon class="band" style="fill:{paint}" points="{" ".join(there + back)}"/>')
        points = [place(x, y) for x, y in zip(one.x, one.y, strict=True)]
        if len(points) == 1:
            x, y = points[0].split(",")
            parts.append(f'<circle cx="{x}" cy="{y}" r="3" style="fill:{paint}"/>')
        parts.append(f'<polyline class="line" style="stroke:{paint}" points="{" ".join(points)}"/>')
    parts.append(f'<line class="here" x1="0" x2="0" y1="{_TOP}" y2="{_HEIGHT - _BOTTOM}" hidden/>')
    about = {
        "left": _LEFT, "width": inner, "size": width, "most": most,
        "series": [
            {"name": one.name, "x": list(one.x), "told": list(one.told) or [short(y) for y in one.y]} for one in series
        ],
    }  # fmt: skip
    keys = [
        f'<span class="key"><i style="background:{_paint(one)}"></i>{html.escape(one.name)}</span>'
        for one in (series if len(series) > 1 else ())
    ]
    words = html.escape(title)
    return (
        f'<figure class="plot" data-about="{html.escape(json.dumps(about))}"><figcaption><b>{words}</b>{"".join(keys)}'
        f'<span class="readout"></span></figcaption><svg viewBox="0 0 {width} {_HEIGHT}" role="img" '
        f'aria-label="{words}">{"".join(parts)}</svg></figure>'
    )


def ticks(low: float, high: float, wanted: int = 4) -> list[float]:
    """Return round numbers in a range: about as many as wanted."""
    rough = (high - low) / wanted
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * factor for factor in (1, 2, 2.5, 5, 10) if unit * factor >= 0.999 * rough)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]


def short(value: float) -> str:
    """Return a number in a few characters, such as 250k, 1.5M or 0.031."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e4, "k")):
        if abs(value) >= size:
            return f"{value / (1e3 if letter == 'k' else size):.4g}{letter}".replace("-", "−")
    return f"{value:.3g}".replace("-", "−") if abs(value) < 1000 else f"{value:.0f}".replace("-", "−")


def _paint(series: Series) -> str:
    return f"var(--line-{series.colour % _COLOURS})"


def _span(series: Sequence[Series]) -> tuple[float, float]:
    values = [y for one in series for y in (*one.y, *one.low, *one.high)]
    low, high = min(values), max(values)
    if low >= 0 and low < 0.5 * high:
        low = 0.0
    margin = 0.05 * (high - low) or 0.5 * abs(high) or 1.0
    return (low if low == 0.0 else low - margin), high + margin
