"""Charts of numbers over steps, as SVG in a page; with `CHARTS_SCRIPT` they show the numbers under the pointer."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

from rcs_data.view.html import Html, element, figure

CHARTS_SCRIPT = "charts.js"
"""The file in `WEB` that shows the numbers under the pointer."""

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
    """A text for each point; its number when not given."""
    colour: int = 0
    """The number of a colour of the style, from 0."""


def chart(
    title: str,
    series: Sequence[Series],
    *,
    most: int,
    span: tuple[float, float] | None = None,
    width: int = 460,
) -> Html:
    """Return a chart as a `figure`.

    Args:
        title: Name of the quantity that is shown, with its unit.
        series: Lines, at least one, none without points.
        most: Steps at the right end, at least 1.
        span: Lower and upper end of the vertical axis; None for those of the figures.
        width: Width of the drawing, in its own units; its height is 190.
    """
    low, high = span if span is not None else _span(series)
    inner, tall = width - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def place(x: float, y: float) -> tuple[float, float]:
        shown = min(max(y, low), high)
        return round(_LEFT + inner * x / most, 1), round(_TOP + tall * (high - shown) / (high - low), 1)

    def points(x: Sequence[float], y: Sequence[float]) -> list[str]:
        return [",".join(map(str, place(*point))) for point in zip(x, y, strict=True)]

    parts: list[Html] = []
    shown = ticks(low, high)
    for value, label in zip(shown, labels(shown), strict=True):
        _, y = place(0, value)
        parts.append(element("line", class_="rule", x1=_LEFT, x2=width - _RIGHT, y1=y, y2=y))
        parts.append(element("text", label, x=_LEFT - 6, y=y + 4, text_anchor="end"))
    counted = [value for value in ticks(0, most) if value == int(value)]
    parts += [
        element("text", label, x=place(x, low)[0], y=_HEIGHT - 6, text_anchor="middle")
        for x, label in zip(counted, labels(counted), strict=True)
    ]
    for one in series:
        paint = f"var(--line-{one.colour % _COLOURS})"
        if one.low:
            band = points(one.x, one.high) + points(one.x, one.low)[::-1]
            parts.append(element("polygon", class_="band", style=f"fill:{paint}", points=" ".join(band)))
        if len(one.x) == 1:
            x, y = place(one.x[0], one.y[0])
            parts.append(element("circle", cx=x, cy=y, r=3, style=f"fill:{paint}"))
        else:
            line = " ".join(points(one.x, one.y))
            parts.append(element("polyline", class_="line", style=f"stroke:{paint}", points=line))
    parts.append(element("line", class_="here", x1=0, x2=0, y1=_TOP, y2=_HEIGHT - _BOTTOM, hidden=True))
    about = {
        "left": _LEFT, "width": inner, "size": width, "most": most,
        "series": [
            {"name": one.name, "x": list(one.x), "told": list(one.told) or [short(y) for y in one.y]} for one in series
        ],
    }  # fmt: skip
    keys = [
        element("span", element("i", style=f"background:var(--line-{one.colour % _COLOURS})"), one.name, class_="key")
        for one in (series if len(series) > 1 else ())
    ]
    drawing = element("svg", *parts, viewBox=f"0 0 {width} {_HEIGHT}", role="img", aria_label=title)
    caption = (element("b", title), *keys, element("span", class_="readout"))
    return figure(drawing, *caption, is_below=False, class_="plot", data_about=json.dumps(about))


def ticks(low: float, high: float) -> list[float]:
    """Return round numbers in a range: about four."""
    rough = (high - low) / 4
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * factor for factor in (1, 2, 2.5, 5, 10) if unit * factor >= 0.999 * rough)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]


def labels(values: Sequence[float]) -> list[str]:
    """Return numbers as `short` does, with as many digits as distinguish each from the next."""
    found: list[str] = []
    for digits in range(3, 18):
        found = [short(value, digits) for value in values]
        if len(set(found)) == len(found):
            break
    return found


def short(value: float, digits: int = 3) -> str:
    """Return a number in a few characters, such as 250k, 1.5M or 0.031, with so many digits at least."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e4, "k")):
        if abs(value) >= size:
            return f"{value / (1e3 if letter == 'k' else size):.{digits + 1}g}{letter}".replace("-", "−")
    decimals = f"{value:.{digits - 3}f}" if abs(value) >= 1000 else f"{value:.{digits}g}"
    return decimals.replace("-", "−")


def _span(series: Sequence[Series]) -> tuple[float, float]:
    values = [y for one in series for y in (*one.y, *one.low, *one.high)]
    low, high = min(values), max(values)
    if low >= 0 and low < 0.5 * high:
        low = 0.0
    margin = 0.05 * (high - low) or 0.5 * abs(high) or 1.0
    return (low if low == 0.0 else low - margin), high + margin
