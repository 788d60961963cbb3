"""The page about an evaluation of a policy: how often it succeeded, how it was executed, and every episode."""

from __future__ import annotations

import html
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcs_data.durable import disk_errors, write_file
from rcs_data.view.page import WEB

from rcs.policy import ServedPolicy
from rcs.rollout.evaluate import Evaluation, Summary

if TYPE_CHECKING:
    from vlagents import Metadata

REPORT = "report.html"
_STYLE = """
main { max-width: 60rem; margin: 0 auto; padding: 1rem; }
main table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; table-layout: auto; }
main td, main th { padding: 0.2rem 0.9rem 0.2rem 0; text-align: left; width: auto; overflow-wrap: normal; }
main td:first-child, main th:first-child { width: auto; }
.bar { position: relative; height: 0.9rem; background: #8884; border-radius: 0.45rem; margin: 0.6rem 0 1.2rem; }
.bar i { position: absolute; top: 0; bottom: 0; background: #2a78d688; border-radius: 0.45rem; }
.bar b { position: absolute; top: -0.2rem; bottom: -0.2rem; width: 3px; background: #2a78d6; }
"""


def write_policy_report(evaluation: Evaluation, summary: Summary, metadata: Metadata) -> Path:
    """Write `evaluation.json` and `report.html` into the folder of an evaluation; return the page's path.

    Args:
        evaluation: What was evaluated; its agent is a `ServedPolicy`.
        summary: How it went.
        metadata: Of the policy.

    Raises:
        DatasetError: The page cannot be written.
    """
    served = evaluation.agent
    execution = asdict(served.execution) if isinstance(served, ServedPolicy) else {}
    summary.write(evaluation, {"policy": metadata.to_dict(), "execution": execution})
    path = evaluation.out / REPORT
    with disk_errors("write the report", path):
        write_file(path, _page(evaluation, summary, metadata, execution).encode())
    return path


def _page(evaluation: Evaluation, summary: Summary, metadata: Metadata, execution: dict[str, Any]) -> str:
    setup = evaluation.setup
    title = f"{metadata.name}: {setup.task} on {setup.robot}"
    low, high = (100 * bound for bound in summary.interval)
    rate = 100 * summary.successes / summary.judged if summary.judged else None
    told = "not judged" if rate is None else f"{rate:.1f} %"
    bar = f'<i style="left:{low:.2f}%;width:{high - low:.2f}%"></i><b style="left:{rate or 0:.2f}%"></b>'
    bar = "" if rate is None else f'<div class="bar">{bar}</div>'
    about = {
        "Policy": metadata.name,
        "Address": evaluation.agent_name,
        "Checkpoint": metadata.checkpoint or "not told",
        "Hash": metadata.checkpoint_hash or "not told",
        "Action": ", ".join(f"{part.name} {part.meaning}" for part in metadata.action),
        "Rows of a chunk": f"{metadata.horizon}" + (f" at {metadata.rate:g} Hz" if metadata.rate else ""),
        "Loop": f"{setup.frequency:g} Hz, {'in real time' if setup.stepping == 'realtime' else 'in simulated time'}",
        "Execution": ", ".join(f"{name} {value}" for name, value in execution.items() if value is not None),
        "Cameras": ", ".join(setup.cameras) or "none",
        "Seed": f"{evaluation.seed}, in the range from {evaluation.first_seed}",
    }
    numbers = [attempt.number for attempt in sorted(summary.attempts, key=lambda attempt: attempt.number)]
    rows = [
        (number, result.seed, _verdict(result.success), result.failure or "", result.steps, f"{result.reward:.2f}")
        for number, result in zip(numbers, summary.results, strict=True)
    ]
    films = [number for number in numbers if (evaluation.out / f"{number:06d}.mp4").is_file()]
    failures = ", ".join(f"{name} {count}" for name, count in summary.failures.most_common()) or "none"
    style = (WEB / "viewer.css").read_text("utf-8") + _STYLE
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>\n{style}</style></head><body><main><h1>{html.escape(title)}</h1>"
        f"<p>Success in {summary.successes} of {summary.judged} judged episodes: <b>{told}</b> "
        f"(95 % Wilson interval {low:.1f} to {high:.1f} %). Failures: {html.escape(failures)}.</p>{bar}"
        f"{_table([('', '')], about.items())}"
        + "".join(f'<video controls width="320" src="{number:06d}.mp4"></video> ' for number in films)
        + _table([("episode", "seed", "verdict", "failure", "steps", "reward")], rows)
        + "</main></body></html>\n"
    )


def _verdict(success: bool | None) -> str:
    return "not judged" if success is None else "success" if success else "failure"


def _table(heads: Any, rows: Any) -> str:
    head = "".join("<tr>" + "".join(f"<th>{html.escape(str(cell))}</th>" for cell in row) + "</tr>" for row in heads)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>{head if any(any(row) for row in heads) else ''}{body}</table>"
