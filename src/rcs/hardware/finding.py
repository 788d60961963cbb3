"""Findings of an examination of a lab, with their remedies."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

Status = Literal["ok", "warning", "fault"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was examined."""

    part: str
    """Name of the part: that of a device in the site, `network` and an address, or `machine`."""
    status: Status
    """`fault` for what prevents work, `warning` for what may disturb it."""
    message: str
    """The finding, with figures."""
    remedy: str = ""
    """How to mend it; empty if nothing is wrong."""


def as_json(findings: Sequence[Finding]) -> str:
    """Return findings as JSON: a list of objects with the fields of `Finding`."""
    return json.dumps([asdict(one) for one in findings], indent=2)


def as_page(title: str, findings: Sequence[Finding]) -> str:
    """Return a page of findings, the worst first, which needs no other file."""
    order = ("fault", "warning", "ok")
    rows = [
        f'<tr class="{one.status}"><td>{one.status}</td><td>{html.escape(one.part)}</td>'
        f"<td>{html.escape(one.message)}</td><td>{html.escape(one.remedy)}</td></tr>"
        for one in sorted(findings, key=lambda one: order.index(one.status))
    ]
    counts = ", ".join(f"{sum(one.status == status for one in findings)} {status}" for status in order)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title><style>'
        "body{font:16px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:70rem;padding:0 1rem;color:#222;"
        "background:#fff}"
        "table{border-collapse:collapse;width:100%}td,th{padding:.4rem .6rem;text-align:left;vertical-align:top;"
        "border-bottom:1px solid #ddd}.fault td:first-child{color:#b00020;font-weight:600}"
        ".warning td:first-child{color:#8a5a00;font-weight:600}.ok td:first-child{color:#1b6e3c}"
        "@media(prefers-color-scheme:dark){body{color:#ddd;background:#161616}td,th{border-color:#444}"
        ".fault td:first-child{color:#ff8a95}.warning td:first-child{color:#f0c060}.ok td:first-child{color:#7bd39a}}"
        f"</style></head><body><h1>{html.escape(title)}</h1><p>{counts}</p><table><thead><tr><th>status</th><th>part</th>"
        f"<th>finding</th><th>remedy</th></tr></thead><tbody>{''.join(rows)}</tbody></table></body></html>\n"
    )
