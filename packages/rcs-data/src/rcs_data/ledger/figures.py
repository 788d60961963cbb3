"""Figures of success rates with their intervals, as SVG and PNG and on a page; drawn by Matplotlib, an extra."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rcs_data.errors import package_of
from rcs_data.files.durable import disk_errors, write_file
from rcs_data.ledger.groups import Group, domains_in_words, groups_of
from rcs_data.ledger.ledger import Ledger
from rcs_data.view.html import Html, element, header, page, table

FIGURES_FOLDER = "figures"
_DPI = 200
_INSIDE, _COLOURS = 4, 10
"""Most series whose legend has room inside, and that have a colour each of the usual ones."""


def write_figures(ledger: Ledger, by: str) -> Path:
    """Write `figures/by-<key>.svg`, `.png` and `.html` into a ledger's folder, and return the page's path.

    Args:
        ledger: The ledger.
        by: Key that rates are grouped by; see `groups_of`. Numbers become lines, everything else bars.

    Raises:
        MissingDependency: Matplotlib is not installed.
        InvalidSetup: No condition has such a value.
        DatasetError: The disk fails.
    """
    groups = groups_of(ledger, by)
    judged = [one for one in groups if one.verdicts.judged]
    folder = ledger.folder / FIGURES_FOLDER
    drawn = {kind: _drawn(judged, by, kind) for kind in ("svg", "png")}
    path = folder / f"by-{by.replace('/', '-')}.html"
    with disk_errors("write the figures", folder):
        folder.mkdir(exist_ok=True)
        for kind, data in drawn.items():
            write_file(path.with_suffix(f".{kind}"), data)
        write_file(path, _page(ledger, groups, by, drawn["svg"]).encode())
    return path


def _drawn(groups: Sequence[Group], by: str, kind: str) -> bytes:
    """Return the figure as a file; the same figures are the same bytes."""
    mpl, figures = (
        package_of(name, "figures", "Figures need Matplotlib") for name in ("matplotlib", "matplotlib.figure")
    )
    is_curve = all(isinstance(one.value, int | float) for one in groups)
    series = list(dict.fromkeys(one.series for one in groups))
    values = list(dict.fromkeys(one.value for one in groups))
    file: Any = io.BytesIO()
    style: dict[str, Any] = {"svg.hashsalt": "rcs", "font.size": 9, "svg.fonttype": "none"}
    if len(series) > _COLOURS:
        style["axes.prop_cycle"] = mpl.cycler(color=mpl.colormaps["tab20"].colors)
    with mpl.rc_context(style):
        width = 5.0 if is_curve else max(2.5, 0.5 + 0.45 * len(values) * max(len(series), 1))
        has_room = len(series) <= _INSIDE
        figure = figures.Figure(figsize=(min(width, 12.0) + (0.0 if has_room else 3.0), 3.0), layout="constrained")
        axes: Any = figure.add_subplot()
        for number, name in enumerate(series):
            own = [one for one in groups if one.series == name]
            (_draw_line if is_curve else _draw_bars)(axes, own, values, number, len(series))
        if not is_curve:
            axes.set_xticks(range(len(values)), [str(value) for value in values])
        axes.set(ylim=(0, 100), ylabel="success [%]", xlabel=by)
        axes.spines[["top", "right"]].set_visible(False)
        if len(series) > 1:
            (axes.legend if has_room else figure.legend)(
                frameon=False, fontsize=8, loc="best" if has_room else "outside right upper"
            )
        figure.savefig(file, format=kind, dpi=_DPI, metadata={"Date": None} if kind == "svg" else {"Software": None})
    return file.getvalue()


def _draw_line(axes: Any, groups: Sequence[Group], values: Sequence[Any], number: int, count: int) -> None:
    x = [one.value for one in groups]
    heights, (below, above) = [_percent(one) for one in groups], _around(groups)
    if len(groups) > 1:
        low, high = np.subtract(heights, below), np.add(heights, above)
        axes.fill_between(x, low, high, color=f"C{number}", alpha=0.2, linewidth=0)
    else:
        axes.errorbar(x, heights, (below, above), fmt="none", ecolor=f"C{number}", elinewidth=0.8, capsize=2)
    axes.plot(x, heights, "o-", color=f"C{number}", markersize=3, label=_label(groups[0], count))


def _draw_bars(axes: Any, groups: Sequence[Group], values: Sequence[Any], number: int, count: int) -> None:
    width = 0.8 / count
    x = [values.index(one.value) + (number - (count - 1) / 2) * width for one in groups]
    heights, (below, above) = [_percent(one) for one in groups], _around(groups)
    axes.bar(x, heights, 0.9 * width, color=f"C{number}", alpha=0.8, label=_label(groups[0], count))
    axes.errorbar(x, heights, (below, above), fmt="none", ecolor="black", elinewidth=0.8, capsize=2)
    for place, one in zip(x, groups, strict=True):
        axes.annotate(f"n={one.verdicts.judged}", (place, 1), ha="center", va="bottom", fontsize=6, rotation=90)


def _around(groups: Sequence[Group]) -> tuple[list[float], list[float]]:
    """Return how far intervals reach below and above their rates [%]."""
    reach = [(one.verdicts.interval, _percent(one)) for one in groups]
    below = [max(rate - 100 * low, 0.0) for (low, _), rate in reach]
    return below, [max(100 * high - rate, 0.0) for (_, high), rate in reach]


def _label(group: Group, count: int) -> str:
    """Return the words of the legend for a series."""
    return group.series or ("others" if count > 1 else "")


def _page(ledger: Ledger, groups: Sequence[Group], by: str, svg: bytes) -> str:
    drawing = Html(svg.decode().partition("<svg")[2].join(("<svg", "")))  # without the declaration of a file
    text = domains_in_words(ledger)
    rows = [(one.series or "all", str(one.value), str(one.verdicts), one.verdicts.not_judged) for one in groups]
    heads = ("series", by, "success", "not judged")
    words = "Bars and lines are success rates of judged episodes, with 95 % Wilson intervals."
    section = element("section", element("p", words), text and element("p", text), element("figure", drawing))
    title = f"{ledger.folder.resolve().name}: success by {by}"
    return page(title, header(title), element("main", section, table(rows, heads), class_="sheet"))


def _percent(group: Group) -> float:
    return math.nan if group.verdicts.rate is None else 100 * group.verdicts.rate
