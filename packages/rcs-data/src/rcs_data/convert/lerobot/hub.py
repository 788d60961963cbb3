"""Pulls LeRobot datasets from the Hugging Face Hub, whole or in part, and pushes exports to it.

Needs the extra `hub`. The server, the token and the cache are those of `huggingface_hub`: HF_ENDPOINT, HF_TOKEN,
HF_HOME.
"""

from __future__ import annotations

import glob
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from rcs_data.convert.lerobot.import_ import is_lerobot
from rcs_data.convert.lerobot.mapping import feature_mapping
from rcs_data.convert.lerobot.source import LeRobotSource
from rcs_data.convert.options import ImportOptions, selected_numbers
from rcs_data.errors import DatasetError, InvalidSetup, RcsError, package_of

# LeRobot looks for datasets of this tag; the Hub's viewer needs the paths.
_CARD = """---
tags: [LeRobot]
task_categories: [robotics]
configs:
- config_name: default
  data_files: data/*/*.parquet
---

A LeRobotDataset of the robot {robot}; `meta/info.json` has its version, its rate, and how many episodes there are.
"""
# The folders that make up a LeRobot dataset; what else a repository has is its owner's.
_OURS = ["data/*", "meta/*", "videos/*"]
# Says whose files a pulled folder has; no push uploads it.
_PULLED = Path(".cache", "rcs-repository")
_load = partial(package_of, "huggingface_hub", "hub", "The Hub needs huggingface_hub")


def pull(
    repo: str,
    out: str | Path,
    *,
    revision: str | None = None,
    episodes: Sequence[str] | None = None,
    cameras: Sequence[str] | None = None,
) -> Path:
    """Download a LeRobot dataset; called again after an error, it goes on where it was.

    Args:
        repo: Its name on the Hub, such as "lerobot/pusht".
        out: The folder to make or to complete.
        revision: A branch, tag or commit; None for the newest.
        episodes: Numbers and ranges, as for an import; None for all. In v3.0, a file has many episodes, and files are
            downloaded as a whole.
        cameras: Cameras, as for an import; None for all.

    Raises:
        MissingDependency: huggingface_hub is not installed.
        DatasetError: The Hub refuses or cannot be reached, the repository has no LeRobot dataset, or the folder has
            another one.
        InvalidSetup: An episode or camera is unknown.
        CorruptEpisode: The description of the dataset is damaged.
    """
    hub, root = _load(), Path(out)

    def download(patterns: list[str] | None) -> None:
        with _hub_errors(f"pull {repo}"):
            hub.snapshot_download(
                repo, repo_type="dataset", revision=revision, local_dir=str(root), allow_patterns=patterns
            )

    kept = root / _PULLED
    known = kept.read_text("utf-8") if kept.is_file() else "another source"
    if known != repo and is_lerobot(root):
        raise DatasetError(f"{root} has a LeRobot dataset of {known}; choose another folder for {repo}.")
    with _hub_errors(f"pull {repo}"):
        hub.HfApi().repo_info(repo, repo_type="dataset", revision=revision)  # else a folder is returned as it is
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(repo, "utf-8")
    download(["meta/*"])
    if not is_lerobot(root):
        raise DatasetError(f"{repo} has no meta/info.json, so it is not a LeRobot dataset.")
    if episodes is None and cameras is None:
        download(None)
        return root
    source = LeRobotSource(root)
    chosen = selected_numbers(episodes, source.lengths)
    options = ImportOptions(cameras=None if cameras is None else tuple(cameras))
    wanted = _files(source, feature_mapping(source, options).cameras, chosen)
    download([*(glob.escape(str(path)) for path in wanted), "README.md"])
    return root


def push(path: str | Path, repo: str, *, private: bool = False) -> str:
    """Upload a LeRobot dataset, such as an export, and return its address.

    Files that are there already are skipped, and those of a former dataset are removed. A `README.md` that the
    repository has stays, unless the folder has one.

    Args:
        path: Its folder.
        repo: Its name on the Hub; it is made if it does not exist.
        private: Whether a new one can be seen only by its owners.

    Raises:
        MissingDependency: huggingface_hub is not installed.
        InvalidSetup: The folder is not a LeRobot dataset, or lacks a part of it.
        DatasetError: The Hub refuses or cannot be reached.
        CorruptEpisode: The description of the dataset is damaged.
    """
    hub, root = _load(), Path(path)
    if not is_lerobot(root):
        raise InvalidSetup(
            f"{root} is not a LeRobot dataset: meta/info.json is missing. Export one with "
            f"`rcs-data export DATASET --format lerobot-v3 --out EXPORT`."
        )
    source = LeRobotSource(root)
    missing = [path for path in _files(source, source.features, [*source.lengths]) if not (root / path).is_file()]
    if missing:
        raise InvalidSetup(
            f"{root} lacks {len(missing)} of its files, such as {missing[0]}, and the Hub would lose them; pull or "
            "export the whole dataset first."
        )
    where: dict[str, Any] = {"repo_id": repo, "repo_type": "dataset"}
    with _hub_errors(f"push to {repo}"):
        api = hub.HfApi()
        address = str(api.create_repo(**where, private=private, exist_ok=True))
        api.upload_folder(
            **where,
            folder_path=str(root),
            ignore_patterns=[".cache/*"],
            delete_patterns=_OURS,
            commit_message=f"LeRobotDataset {source.version}, {len(source.lengths)} episodes",
        )
        if not api.file_exists(repo, "README.md", repo_type="dataset"):
            card = _CARD.format(robot=source.info.get("robot_type") or "unknown")
            api.upload_file(**where, path_or_fileobj=card.encode(), path_in_repo="README.md")
        # LeRobot reads the revision with the tag of its version, so the tag must move.
        if any(tag.name == source.version for tag in api.list_repo_refs(**where).tags):
            api.delete_tag(**where, tag=source.version)
        api.create_tag(**where, tag=source.version)
    return address


def _files(source: LeRobotSource, columns: Iterable[str], episodes: Sequence[int]) -> list[Path]:
    """Return the files with the rows of some episodes, and the videos of some columns, relative to the folder."""
    names = [name for name in columns if source.is_video(name)]
    videos = [source.video(name, index)[0].relative_to(source.root) for name in names for index in episodes]
    return [*dict.fromkeys([*source.files(episodes), *videos])]


@contextmanager
def _hub_errors(doing: str) -> Generator[None]:
    try:
        yield
    except RcsError:
        raise
    # Its errors have no class in common, nor have those of the HTTP clients that its versions use.
    except Exception as err:
        text = " ".join(str(err).split())
        raise DatasetError(f"Cannot {doing}: {type(err).__name__}: {text}") from err
