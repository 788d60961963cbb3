"""Checks a whole dataset: its description, every episode, and other files in its folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rcs_data.check.bytes import EpisodeBytes
from rcs_data.check.doubts import check_images, check_labels, check_motion, check_times, check_verdicts
from rcs_data.check.episode_rows import EpisodePlace, is_joints
from rcs_data.check.folder import MOST_LOOKS, check_beside, check_folder, check_index, stamps
from rcs_data.check.report import CheckReport, Finding
from rcs_data.errors import CorruptEpisode
from rcs_data.files.info import MERGED, DatasetInfo
from rcs_data.files.layout import (
    EPISODE_FILE,
    EPISODES_FOLDER,
    FORMER_FOLDER,
    folder_names,
    has_dataset,
    present_folder,
)
from rcs_data.files.output import OnProgress
from rcs_data.index.entry import Entry
from rcs_data.index.history import history

Depth = Literal["bytes", "rows", "frames"]
"""How far a check looks: that every byte is what was written; what the rows say, too; that every image decodes, too."""


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
    before = stamps(root)
    contents, findings = check_folder(root)
    if contents is None:
        return CheckReport(path=root, episodes=0, rows=0, frames=0, findings=tuple(findings))
    info = contents.info
    entries = [entry for _, entry in sorted(contents.entries.items())]
    one = partial(_check_episode, root, info, _is_resampled(root, info), depth)
    rows = frames = 0
    found: list[tuple[Entry, list[Finding]]] = []
    with ThreadPoolExecutor(workers or os.cpu_count() or 1, thread_name_prefix="check episodes") as pool:
        for entry, (its_rows, its_frames, its_findings) in zip(entries, pool.map(one, entries), strict=True):
            rows, frames = rows + its_rows, frames + its_frames
            found.append((entry, its_findings))
            if on_progress is not None:
                on_progress(len(found), len(entries))
    former = [finding for name in folder_names(root, FORMER_FOLDER) for finding in _check_former(root, name, info)]
    for _ in range(MOST_LOOKS):
        now = stamps(root)
        if now == before or not (former or any(its_findings for _, its_findings in found)):
            break
        # An edit may have moved what was being read, or removed it.
        before, present = now, (check_index(root)[0] or contents).entries.values()
        found = [(entry, one(entry)[2]) for entry, its_findings in found if its_findings and entry in present]
        former = [finding for finding in former if (root / finding.file).parent.is_dir()]
    findings += [finding for _, its_findings in found for finding in its_findings]
    findings += check_verdicts({entry.id: entry.success for entry in entries})
    findings += former
    return CheckReport(
        path=root,
        episodes=len(entries),
        rows=rows,
        frames=frames,
        findings=tuple(findings),
        notes=tuple(
            f"{feature.key!r} is not compared with limits: the dataset has none for it."
            for feature in info.features
            if is_joints(feature) and feature.limits is None
        ),
    )


def _check_episode(
    root: Path, info: DatasetInfo, is_resampled: bool, depth: Depth, entry: Entry
) -> tuple[int, int, list[Finding]]:
    """Return how many rows and decoded images an episode has, and what is wrong with it."""
    place = EpisodePlace(root, present_folder(root / EPISODES_FOLDER / entry.folder), entry.id)
    if not place.folder.is_dir():
        return 0, 0, []  # reported with the folder
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
    return int(about.get("length", 0)), bytes_.frames, findings


def _check_former(root: Path, name: str, info: DatasetInfo) -> Iterator[Finding]:
    """Yield damage of an episode that only undo can bring back."""
    place = EpisodePlace(root, root / FORMER_FOLDER / name, name)
    for finding in EpisodeBytes(place, info, depth="bytes").findings():
        yield replace(finding, kind="former", message=f"{finding.message}; undo would bring back a damaged episode")


def _check_entry(place: EpisodePlace, entry: Entry, about: dict[str, Any]) -> Iterator[Finding]:
    """Yield a finding for each field in which the index differs from `episode.json`."""
    for name in ("id", "length", "success", "seed", "content_hash"):
        if about[name] != getattr(entry, name):
            message = f"{name} is {about[name]!r}, and {getattr(entry, name)!r} in the index"
            yield place.finding("damage", "other_episode", message, file=EPISODE_FILE)


def _is_resampled(root: Path, info: DatasetInfo) -> bool:
    was_edited = False
    with suppress(CorruptEpisode):  # reported with the folder
        was_edited = any(edit.command == "resample" for edit in history(root))
    return was_edited or "imported" in info.setup or not {"mix", MERGED}.isdisjoint(info.origin)
