"""Checks a whole dataset: its description, every episode, and other files in its folder."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from rcs_data.check.bytes import EpisodeBytes
from rcs_data.check.episode_rows import EpisodePlace, is_joints
from rcs_data.check.folder import check_beside, check_folder, check_index
from rcs_data.check.images import check_images
from rcs_data.check.labels import check_labels, check_verdicts
from rcs_data.check.motion import check_motion
from rcs_data.check.report import CheckReport, Finding
from rcs_data.check.times import check_times, check_timing
from rcs_data.index import Entry, State
from rcs_data.info import MERGED, DatasetInfo
from rcs_data.layout import EPISODE_FILE, episode_folder, has_dataset
from rcs_data.output import OnProgress

Depth = Literal["bytes", "rows", "frames"]
"""How far a check looks: that every byte is what was written; what the rows say, too; that every image decodes, too."""

_Found = list[tuple[Entry, list[Finding]]]


def check(
    path: str | Path,
    *,
    depth: Depth = "frames",
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> CheckReport:
    """Check every episode of a dataset for damage and for doubtful training data.

    The dataset may be written and edited meanwhile. The check reads the episodes that were there when it began, and
    says nothing of those that an edit has removed since.

    Args:
        path: The dataset's folder.
        depth: How far to look; decoding images takes most of the time.
        workers: Threads; None for one per core. Decoding and hashing release the GIL.
        on_progress: Called with the number of episodes done and in all.

    Raises:
        DatasetError: There is no dataset, or its layout is of another version.
    """
    root = Path(path)
    if not has_dataset(root) and (left := check_beside(root)):
        return CheckReport(path=root, episodes=0, rows=0, frames=0, findings=tuple(left))
    state, findings = check_folder(root)
    if state is None:
        return CheckReport(path=root, episodes=0, rows=0, frames=0, findings=tuple(findings))
    entries = [entry for _, entry in sorted(state.episodes.items())]
    is_resampled = _is_resampled(state)
    rows = frames = 0
    found: _Found = []
    with ThreadPoolExecutor(workers or os.cpu_count() or 1, thread_name_prefix="check episodes") as pool:
        results = pool.map(lambda entry: _check_episode(root, entry, state.info, is_resampled, depth), entries)
        for number, (its_rows, its_frames, its_findings) in enumerate(results):
            rows, frames = rows + its_rows, frames + its_frames
            found.append((entries[number], its_findings))
            if on_progress is not None:
                on_progress(number + 1, len(entries))
    former: _Found = [(entry, list(_check_former(root, entry, state.info))) for entry in state.former_entries()]
    now = state
    if any(its_findings for _, its_findings in (*found, *former)):
        now = check_index(root)[0] or state  # an edit may have removed what was just read
    findings += _of_those_left(found, now.episodes.values())
    findings += check_verdicts({entry.id: entry.success for entry in entries})
    # `prune` removes folders before the index forgets them.
    findings += _of_those_left(former, (e for e in now.former_entries() if episode_folder(root, e.folder).is_dir()))
    return CheckReport(
        path=root,
        episodes=len(entries),
        rows=rows,
        frames=frames,
        findings=tuple(findings),
        notes=tuple(_unlimited(state.info)),
    )


def _check_episode(
    root: Path, entry: Entry, info: DatasetInfo, is_resampled: bool, depth: Depth
) -> tuple[int, int, list[Finding]]:
    """Return how many rows and decoded images an episode has, and what is wrong with it."""
    place = EpisodePlace(root, episode_folder(root, entry.folder), entry.id)
    if not place.folder.is_dir():
        return 0, 0, []  # told with the folder
    bytes_ = EpisodeBytes(place, info, depth=depth)
    findings = list(bytes_.findings())
    about: dict[str, Any] = bytes_.rows.about
    if about:
        findings += _check_entry(place, entry, about)
    if not any(finding.severity == "damage" for finding in findings):  # damaged rows are not checked further
        rows = bytes_.rows
        findings += check_labels(place, {**about, "instruction": entry.instruction or info.instruction})
        if depth != "bytes":
            findings += check_times(place, rows, is_resampled=is_resampled)
            findings += check_images(place, rows)
            findings += check_motion(place, rows)
            findings += check_timing(place, about, bytes_.timing)
    return int(about.get("length", 0)), bytes_.frames, findings


def _check_former(root: Path, entry: Entry, info: DatasetInfo) -> Iterator[Finding]:
    """Yield damage of an episode that only undo can bring back."""
    place = EpisodePlace(root, episode_folder(root, entry.folder), entry.id)
    if place.folder.is_dir():  # or in quarantine
        for finding in EpisodeBytes(place, info, depth="bytes").findings():
            yield replace(finding, kind="former", message=f"{finding.message}; undo would bring back a damaged episode")


def _of_those_left(found: _Found, left: Iterable[Entry]) -> list[Finding]:
    folders = {entry.folder for entry in left}
    return [finding for entry, findings in found if entry.folder in folders for finding in findings]


def _check_entry(place: EpisodePlace, entry: Entry, about: dict[str, Any]) -> Iterator[Finding]:
    """Yield a finding for each field in which the index differs from `episode.json`."""
    for name in ("id", "length", "success", "seed", "content_hash"):
        if about[name] != getattr(entry, name):
            message = f"{name} is {about[name]!r}, and {getattr(entry, name)!r} in the index"
            yield place.finding("damage", "other_episode", message, file=EPISODE_FILE)


def _is_resampled(state: State) -> bool:
    was_edited = any(edit.command == "resample" for edit in state.history)
    return was_edited or "imported" in state.info.setup or not {"mix", MERGED}.isdisjoint(state.info.origin)


def _unlimited(info: DatasetInfo) -> Iterator[str]:
    for feature in info.features:
        if is_joints(feature) and feature.limits is None:
            yield f"{feature.key!r} is not compared with limits: the dataset has none for it."
