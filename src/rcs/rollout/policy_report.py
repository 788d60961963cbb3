"""The page about an evaluation of a policy: success rate, execution, and every episode."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcs_data.durable import disk_errors, write_file
from rcs_data.view.html import Html, element, figure, film, header, page, table

from rcs.policy import ServedPolicy
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import Evaluation, Summary

if TYPE_CHECKING:
    from vlagents import Metadata

REPORT = "report.html"


def write_policy_report(evaluation: Evaluation, summary: Summary, metadata: Metadata) -> Path:
    """Write `evaluation.json` and `report.html` into the folder of an evaluation; return the page's path.

    Args:
        evaluation: The evaluation; its agent is a `ServedPolicy`.
        summary: Its results.
        metadata: Metadata of the policy.

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
    title = f"{metadata.name}: {setup.task} on {setup.robot_label}"
    low, high = (100 * bound for bound in summary.interval)
    rate = 100 * summary.successes / summary.judged if summary.judged else None
    success = "not judged" if rate is None else f"{rate:.1f} %"
    about = {
        "Policy": metadata.name,
        "Address": evaluation.agent_name,
        "Checkpoint": metadata.checkpoint or "unknown",
        "Hash": metadata.checkpoint_hash or "unknown",
        "Action": ", ".join(f"{part.name} {part.meaning}" for part in metadata.action),
        "Rows of a chunk": f"{metadata.horizon}" + (f" at {metadata.rate:g} Hz" if metadata.rate else ""),
        "Loop": f"{setup.frequency:g} Hz, {'in real time' if setup.stepping == 'realtime' else 'in simulated time'}",
        "Execution": ", ".join(f"{name} {value}" for name, value in execution.items() if value is not None),
        "Cameras": ", ".join(setup.cameras.names) or "none",
        "Seed": f"{evaluation.seed}, in the range from {evaluation.first_seed}",
    }
    numbers = [attempt.number for attempt in sorted(summary.attempts, key=lambda attempt: attempt.number)]
    rows = [
        (number, result.seed, _verdict(result.success), _failure(result), result.steps, f"{result.reward:.2f}")
        for number, result in zip(numbers, summary.results, strict=True)
    ]
    films = [
        number for number in numbers if number < evaluation.videos and (evaluation.out / f"{number:06d}.mp4").is_file()
    ]
    failures = ", ".join(f"{name} {count}" for name, count in summary.failures.most_common()) or "none"
    heads = ("episode", "seed", "verdict", "failure", "steps", "reward")
    result = element(
        "p",
        f"Success in {summary.successes} of {summary.judged} judged episodes: ",
        element("b", success),
        f" (95 % Wilson interval {low:.1f} to {high:.1f} %). Failures: {failures}.",
    )
    main = element(
        "main",
        element("section", result, None if rate is None else _bar(rate, low, high)),
        table(about.items()),
        element("div", *(figure(film(f"{number:06d}.mp4"), f"episode {number}") for number in films), class_="films"),
        table(rows, heads),
        class_="sheet",
    )
    return page(title, header(title), main)


def _bar(rate: float, low: float, high: float) -> Html:
    """Return a rate within its interval [%]."""
    interval = element("i", style=f"left:{low:.2f}%;width:{high - low:.2f}%")
    return element("div", interval, element("b", style=f"left:{rate:.2f}%"), class_="bar")


def _failure(result: EpisodeResult) -> str:
    return ": ".join(part for part in (result.failure, result.message) if part is not None)


def _verdict(success: bool | None) -> str:
    return "not judged" if success is None else "success" if success else "failure"
