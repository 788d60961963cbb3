"""Checks the labels of episodes: verdicts and instructions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rcs_data.check.episode_rows import EpisodePlace
from rcs_data.check.report import Finding, listed
from rcs_data.files.layout import EPISODE_FILE, EPISODES_FOLDER

# Fewer episodes than this may all fail by chance.
_FEW = 3


def check_labels(place: EpisodePlace, about: dict[str, Any]) -> Iterator[Finding]:
    """Yield findings about the labels of one episode, given the contents of its `episode.json`."""

    def warning(kind: str, message: str) -> Finding:
        return place.finding("warning", kind, message, file=EPISODE_FILE)

    outcome: Any = about.get("outcome")
    failure = outcome.get("failure") if isinstance(outcome, dict) else None
    if about.get("success") is True and failure:
        yield warning("contradiction", f"is marked as a success, but its outcome says that it failed: {failure!r}")
    if not str(about.get("instruction") or "").strip():
        yield warning("no_instruction", "no instruction; set one with `rcs-data relabel`")
    if about.get("length") == 1:
        yield warning("no_action", "has one row, and so no steps")


def check_verdicts(verdicts: dict[str, bool | None]) -> Iterator[Finding]:
    """Yield findings about the verdicts of all episodes together, given `success` of each by id."""

    def warning(kind: str, message: str) -> Finding:
        return Finding(severity="warning", kind=kind, episode=None, file=EPISODES_FOLDER, message=message)

    unknown = [name for name, success in verdicts.items() if success is None]
    if unknown and len(unknown) == len(verdicts):
        yield warning("no_verdict", "no episode has a verdict; a filter by success keeps none")
    elif unknown:
        yield warning("no_verdict", f"{len(unknown)} of {len(verdicts)} episodes have no verdict: {listed(unknown)}")
    if len(verdicts) >= _FEW and all(success is False for success in verdicts.values()):
        yield warning("all_failed", f"all {len(verdicts)} episodes failed")
