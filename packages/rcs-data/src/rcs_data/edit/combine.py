"""Merges several datasets into one and splits one into several; each inverts the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.info import MERGED, DatasetInfo, differences, feature_differences, shared_setup
from rcs_data.files.layout import check_name, name_of
from rcs_data.files.output import OnProgress, new_output, refuse_existing
from rcs_data.options import require_whole
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.record.writer import DatasetWriter

# Fields that may differ between merged datasets.
_OWN = ("setup", "instruction", "jpeg_quality", "jpeg_subsampling", "origin")
# The facts that the episodes of a part share, and each episode with the arguments of its copy.
_Kept = tuple[DatasetInfo, list[tuple[EpisodeRecord, dict[str, Any]]]]


def merge(sources: Sequence[str | Path], out: str | Path, *, on_progress: OnProgress | None = None) -> Dataset:
    """Merge datasets of the same features and rate into a new one, and return it.

    Each episode records its origin (`EpisodeRecord.source`). Ids stay the same unless two sources share one; then every
    id is prefixed with its source's name.

    Raises:
        InvalidSetup: No sources are given.
        DatasetError: The sources do not fit each other (the message lists how), or `out` is not empty.
        CorruptEpisode: A source is damaged.
    """
    if not sources:
        raise InvalidSetup("There are no datasets to merge; give at least one.")
    datasets = [Dataset(path) for path in sources]
    names = source_names(datasets)
    require_fit(names, [dataset.info for dataset in datasets], "`mix` fits rates, sizes and names of cameras")
    info = _merged_info(names, datasets)
    parts = [(name, dataset, dataset.episodes) for name, dataset in zip(names, datasets, strict=True)]
    with new_output(out) as partial, DatasetWriter.open(partial, info) as made:
        for _, episode, about in gathered(parts, on_progress):
            made.copy(episode, **about)
    return Dataset(out)


def gathered(
    parts: Sequence[tuple[str, Dataset, Sequence[EpisodeRecord]]], on_progress: OnProgress | None
) -> Iterator[tuple[str, EpisodeRecord, dict[str, Any]]]:
    """Yield the episodes of named datasets, each with that name and what its copy has: its new id and its source."""
    ids = [episode.id for _, _, episodes in parts for episode in episodes]
    is_unique = len(set(ids)) == len(ids)
    done = 0
    for name, dataset, episodes in parts:
        digest = dataset.digest()
        for episode in episodes:
            source = {
                "dataset": name,
                "digest": digest,
                "episode": episode.id,
                "content_hash": episode.content_hash,
                "source": episode.source,
            }
            yield name, episode, {"episode_id": episode.id if is_unique else f"{name}.{episode.id}", "source": source}
            done += 1
            if on_progress is not None:
                on_progress(done, len(ids))


def split(
    path: str | Path,
    out: str | Path,
    *,
    parts: Mapping[str, float] | None = None,
    seed: int = 0,
) -> dict[str, Dataset]:
    """Split a dataset into several, in `out/<part>`, and return them by name.

    Args:
        path: The dataset, which is not changed.
        out: Where the parts go.
        parts: The share of each part, such as {"train": 0.9, "val": 0.1}; episodes are drawn by the seed. None splits a
            merged dataset into its sources, whose episodes get their former ids back.
        seed: Seed of the draw.

    Raises:
        InvalidSetup: The shares do not sum up to 1, the seed is not valid, or the dataset was not merged.
        DatasetError: A part's folder is not empty.
        CorruptEpisode: The dataset is damaged.
    """
    dataset = Dataset(path)
    if parts is None:
        chosen, what = _by_source(dataset), "a dataset"
    else:
        named = _drawn(dataset, parts, seed)
        chosen = {name: (dataset.info, [(dataset[i], {}) for i in ids]) for name, ids in named.items()}
        what = "a part"
    for name in chosen:
        check_name(name, what)
        refuse_existing(Path(out) / name)
    made: dict[str, Dataset] = {}
    for name, (info, kept) in chosen.items():
        with new_output(Path(out) / name) as partial, DatasetWriter.open(partial, info) as part:
            for episode, about in kept:
                part.copy(episode, **about)
        made[name] = Dataset(Path(out) / name)
    return made


def source_names(datasets: Sequence[Dataset]) -> list[str]:
    """Return a name for each dataset: that of its folder, numbered where two are equal."""
    names: list[str] = []
    for dataset in datasets:
        stem = name = name_of(dataset.path)
        number = 2
        while name in names:
            name = f"{stem}-{number}"
            number += 1
        names.append(name)
    return names


def require_fit(names: Sequence[str], infos: Sequence[DatasetInfo], hint: str) -> None:
    """Refuse datasets whose features or rates differ from those of the first.

    Args:
        names: What they are called in the message.
        infos: The facts that the episodes of each share.
        hint: What to do, for the message.

    Raises:
        DatasetError: One differs; the message lists how, and has the hint.
    """
    for name, info in list(zip(names, infos, strict=True))[1:]:
        if lines := feature_differences(infos[0], info, names=(names[0], name)):
            text = "\n  ".join(lines)
            raise DatasetError(f"{names[0]} and {name} do not fit each other; {hint}. Differences:\n  {text}")


def _merged_info(names: Sequence[str], datasets: Sequence[Dataset]) -> DatasetInfo:
    first = datasets[0].info
    if all(not differences(first, dataset.info) for dataset in datasets[1:]):
        return first
    setup = shared_setup([dataset.info.setup for dataset in datasets])
    return replace(first, setup=setup, origin={MERGED: own_parts(names, datasets)})


def own_parts(names: Sequence[str], datasets: Sequence[Dataset]) -> dict[str, dict[str, Any]]:
    """Return for each dataset, by name, what it does not share with the others it is merged with."""
    infos = zip(names, (dataset.info for dataset in datasets), strict=True)
    return {name: {field: getattr(info, field) for field in _OWN} for name, info in infos}


def _drawn(dataset: Dataset, parts: Mapping[str, float], seed: int) -> dict[str, list[str]]:
    total = sum(parts.values())
    if not parts or min(parts.values()) < 0 or not abs(total - 1) <= 1e-6:  # NaN compares false
        raise InvalidSetup(f"The shares {dict(parts)} sum up to {total:g}; they must not be negative and sum up to 1.")
    seed = require_whole("The seed", seed)
    ids = [episode.id for episode in dataset.episodes]
    order = np.random.default_rng(seed).permutation(len(ids))
    ends = np.rint(np.cumsum(list(parts.values())) * len(ids)).astype(int)
    starts = [0, *ends[:-1]]
    return {
        name: sorted(ids[i] for i in order[start:end]) for name, start, end in zip(parts, starts, ends, strict=True)
    }


def _by_source(dataset: Dataset) -> dict[str, _Kept]:
    """Return what each source of a merged dataset shared, and its episodes with their former ids and sources."""
    strangers = [episode.id for episode in dataset.episodes if episode.source is None]
    if strangers or not dataset.episodes:
        raise InvalidSetup(
            f"Episodes {', '.join(strangers[:5]) or '(none)'} of {dataset.path} were not merged from another dataset; "
            "give the parts' shares."
        )
    parts: dict[str, dict[str, Any]] = dataset.info.origin.get(MERGED, {})
    found: dict[str, _Kept] = {}
    for episode in dataset.episodes:
        source = episode.source
        assert source is not None
        name = source["dataset"]
        if name not in found:
            former = {field: value for field, value in parts.get(name, {}).items() if field in _OWN}
            found[name] = replace(dataset.info, **former), []
        found[name][1].append((episode, {"episode_id": source["episode"], "source": source["source"]}))
    return found
