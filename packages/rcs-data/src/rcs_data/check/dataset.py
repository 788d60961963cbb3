"""Checks a whole dataset: its description, every episode, and other files in its folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcs_data.check.bytes import EpisodeBytes
from rcs_data.check.descriptions import check_head
from rcs_data.check.episode_rows import EpisodePlace, is_joints
from rcs_data.check.generations import check_former, check_leftovers, former_folders, known_damage
from rcs_data.check.images import check_images
from rcs_data.check.labels import check_labels, check_verdicts
from rcs_data.check.motion import check_motion
from rcs_data.check.report import CheckReport, Finding, counted
from rcs_data.check.stored_timing import check_timing
from rcs_data.check.times import check_times
from rcs_data.head import Head
from rcs_data.info import MERGED, DatasetInfo
from rcs_data.layout import complete_ids, episode_folder, generation_folder
from rcs_data.output import OnProgress


def check(
    path: str | Path,
    *,
    decode_frames: bool = True,
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> CheckReport:
    """Check every episode of a dataset for damage and for doubtful training data.

    Args:
        path: The dataset's folder.
        decode_frames: Whether to decode each image too, which takes most of the time.
        workers: Threads; None for one per core. Decoding and hashing release the GIL.
        on_progress: Called with the number of episodes done and in all.

    Raises:
        DatasetError: There is no dataset, or its layout is newer than this code.
    """
    root = Path(path)
    head, findings = check_head(root)
    if head is None:
        return CheckReport(path=root, episodes=0, rows=0, frames=0, findings=tuple(findings))
    findings += check_leftovers(root, head)
    base = generation_folder(root, head.generation)
    ids = complete_ids(base)
    how = _How(info=head.info, is_resampled=_is_resampled(head), decode_frames=decode_frames)
    done: list[_Checked] = []
    with ThreadPoolExecutor(workers or os.cpu_count() or 1, thread_name_prefix="check episodes") as pool:
        places = [EpisodePlace(root, episode_folder(base, name)) for name in ids]
        for checked in pool.map(lambda place: _check_episode(place, how), places):
            done.append(checked)
            if on_progress is not None:
                on_progress(len(done), len(ids))
    verdicts = {name: checked.success for name, checked in zip(ids, done, strict=True) if checked.has_verdict}
    findings += check_verdicts(verdicts)
    findings += [finding for checked in done for finding in checked.findings]
    findings += check_former(root, head)
    return CheckReport(
        path=root,
        episodes=len(ids),
        rows=sum(checked.rows for checked in done),
        frames=sum(checked.frames for checked in done),
        findings=tuple(findings),
        notes=(*_unlimited(head.info), *_known(root, head)),
    )


@dataclass(frozen=True, kw_only=True)
class _How:
    """Arguments of the check of every episode."""

    info: DatasetInfo
    is_resampled: bool
    decode_frames: bool


@dataclass(frozen=True, kw_only=True)
class _Checked:
    """Result of the check of one episode."""

    rows: int
    frames: int
    findings: tuple[Finding, ...]
    success: bool | None
    has_verdict: bool


def _check_episode(place: EpisodePlace, how: _How) -> _Checked:
    bytes_ = EpisodeBytes(place, how.info, decode_frames=how.decode_frames)
    findings = list(bytes_.findings())
    about: dict[str, Any] = bytes_.rows.about
    if not any(finding.severity == "damage" for finding in findings):  # damaged rows are not checked further
        rows = bytes_.rows
        findings += check_labels(place, about)
        findings += check_times(place, rows, is_resampled=how.is_resampled)
        findings += check_images(place, rows)
        findings += check_motion(place, rows)
        findings += check_timing(place, about, bytes_.timing)
    return _Checked(
        rows=int(about.get("length", 0)),
        frames=bytes_.frames,
        findings=tuple(findings),
        success=about.get("success"),
        has_verdict=bool(about),
    )


def _is_resampled(head: Head) -> bool:
    was_edited = any(edit.command == "resample" for edit in head.history)
    return was_edited or "imported" in head.info.setup or not {"mix", MERGED}.isdisjoint(head.info.origin)


def _unlimited(info: DatasetInfo) -> Iterator[str]:
    for feature in info.features:
        if is_joints(feature) and feature.limits is None:
            yield f"{feature.key!r} is not compared with limits: the dataset has none for it."


def _known(root: Path, head: Head) -> Iterator[str]:
    folders = {str(folder.relative_to(root)) for folder in former_folders(root, head)}
    count = len(folders & known_damage(head))
    if count:
        yield (
            f"{counted(count, 'damaged folder')} of former generations, known from a repair: an undo can bring the "
            "damage back; `rcs data prune` removes it."
        )
