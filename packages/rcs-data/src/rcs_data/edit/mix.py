"""Mixes datasets into a new one, by numbers of episodes or by shares, and harmonises their features."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rcs_data.edit.combine import gathered, own_parts, require_fit, source_names
from rcs_data.edit.images import cameras_of, renamed, resized, with_names, with_size
from rcs_data.edit.rate import at_rate, resampled
from rcs_data.errors import InvalidSetup
from rcs_data.files.info import MERGED, DatasetInfo, shared_setup
from rcs_data.files.output import OnProgress, new_output
from rcs_data.options import Natural, Positive, Record, Whole, converted, require_whole
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.record.writer import DatasetWriter


def _path(given: str | Path) -> Path:
    return Path(given) if isinstance(given, str) else given


class Part(Record):
    """The part that a mix takes from one dataset.

    Raises:
        InvalidSetup: A field does not make sense, or both a number and a share are given.
    """

    path: Path = converted(converter=_path)
    """Folder of the dataset."""
    episodes: Natural | None = None
    """Number of episodes, drawn by the seed; None for all, or for the share."""
    share: Positive | None = None
    """Weight relative to the other parts; requires a total."""

    def __post_init__(self) -> None:
        """Check every field."""
        super().__post_init__()
        if self.episodes is not None and self.share is not None:
            raise InvalidSetup(f"{self.path}: give a number of episodes or a share, not both.")


class Harmonise(Record):
    """How to harmonise the features of different datasets; by default they must be the same.

    Raises:
        InvalidSetup: A field does not make sense.
    """

    common: bool = False
    """Whether to leave out features that are not in every dataset instead of refusing."""
    drop: tuple[str, ...] = ()
    """Features to leave out: their keys, or prefixes of keys, such as "observation/frames/side"."""
    rename: Mapping[str, Mapping[str, str]] = field(default_factory=dict[str, Mapping[str, str]])
    """New names of cameras, by dataset: {"real": {"front": "side"}}."""
    size: tuple[Whole, Whole] | None = None
    """Width and height of all frames [px]; None to keep them."""
    frequency: Positive | None = None
    """Control rate of all episodes [Hz]; None to keep it."""


def mix(
    parts: Sequence[Part],
    out: str | Path,
    *,
    seed: int = 0,
    total: int | None = None,
    mapping: Harmonise | None = None,
    on_progress: OnProgress | None = None,
) -> Dataset:
    """Mix datasets into a new one and return it. Every episode records its origin.

    Args:
        parts: The parts to take.
        out: The new dataset.
        seed: Seed of the draw of episodes.
        total: Episodes in all, if the parts have shares.
        mapping: How to harmonise features; None if they must be the same.
        on_progress: Called with the number of episodes done and of all.

    Raises:
        InvalidSetup: A part has too few episodes, numbers and shares do not go together, or a name is unknown.
        DatasetError: The features still differ (the message lists how), or `out` is not empty.
        CorruptEpisode: A dataset is damaged.
    """
    if not parts:
        raise InvalidSetup("There is nothing to mix; give at least one dataset.")
    seed = require_whole("The seed", seed)
    how = mapping or Harmonise()
    datasets = [Dataset(part.path) for part in parts]
    names = source_names(datasets)
    if unknown := sorted(set(how.rename) - set(names)):
        raise InvalidSetup(f"Cameras of {', '.join(unknown)} cannot be renamed; the datasets are {', '.join(names)}.")
    numbers = _numbers(parts, datasets, total)
    infos = _brought_together(names, datasets, how)
    chosen = [
        _drawn(dataset, count, np.random.default_rng([seed, i]))
        for i, (dataset, count) in enumerate(zip(datasets, numbers, strict=True))
    ]
    setup = shared_setup([dataset.info.setup for dataset in datasets])
    origin: dict[str, Any] = {
        "mix": {"seed": seed, "parts": dict(zip(names, numbers, strict=True))},
        MERGED: own_parts(names, datasets),
    }
    after = dict(zip(names, infos, strict=True))
    info = replace(infos[0], setup=setup, origin=origin)
    with new_output(out) as partial, DatasetWriter.open(partial, info) as made:
        for name, episode, about in gathered([*zip(names, datasets, chosen, strict=True)], on_progress):
            rename = how.rename.get(name, {})
            # Cameras that swap their names leave the features as they are.
            if not rename and _rows_stay(episode.info, after[name]):
                made.copy(episode, **about)
            else:
                made.copy(episode, _mapped(episode, after[name], rename), **about)
    return Dataset(out)


def parse_part(text: str) -> Part:
    """Read "real:143" (episodes), "sim:0.7" (a share) or "sim" (all episodes).

    Raises:
        InvalidSetup: The text after the colon is not a number.
    """
    path, colon, number = text.rpartition(":")
    if not colon:
        return Part(path=Path(text))
    try:
        return (
            Part(path=Path(path), share=float(number)) if "." in number else Part(path=Path(path), episodes=int(number))
        )
    except ValueError as err:
        if Path(text).exists():
            return Part(path=Path(text))
        raise InvalidSetup(
            f"Expected DATASET, DATASET:143 for 143 episodes, or DATASET:0.7 for a share; got {text!r}."
        ) from err


def _numbers(parts: Sequence[Part], datasets: Sequence[Dataset], total: int | None) -> list[int]:
    shares = [part.share for part in parts]
    has_shares = any(share is not None for share in shares)
    if has_shares and (total is None or any(share is None for share in shares)):
        raise InvalidSetup("With shares, every part needs one, and the mix a total number of episodes.")
    if total is not None and not has_shares:
        raise InvalidSetup(f"A total of {total} episodes needs a share for each part.")
    if total is not None:
        total = require_whole("total", total, 1)
        weights = np.array(shares, np.float64)
        weights /= weights.max()  # so that the sum of very large ones is finite
        ends = np.rint(np.cumsum(weights / weights.sum()) * total).astype(int)
        numbers = [int(n) for n in np.diff(ends, prepend=0)]
    else:
        numbers = [len(d) if part.episodes is None else part.episodes for part, d in zip(parts, datasets, strict=True)]
    for count, dataset in zip(numbers, datasets, strict=True):
        if count > len(dataset):
            raise InvalidSetup(f"Expected at most {len(dataset)} episodes of {dataset.path}; got {count}.")
    return numbers


def _drawn(dataset: Dataset, number: int, rng: np.random.Generator) -> list[EpisodeRecord]:
    rows = sorted(rng.permutation(len(dataset))[:number].tolist())
    return [dataset.episodes[row] for row in rows]


def _brought_together(names: Sequence[str], datasets: Sequence[Dataset], how: Harmonise) -> list[DatasetInfo]:
    """Return the info of each dataset's episodes after the mapping; only the setups differ."""
    infos = [renamed(dataset.info, how.rename.get(name, {})) for name, dataset in zip(names, datasets, strict=True)]
    present = dict.fromkeys(feature.key for info in infos for feature in info.features)
    dropped = {place: {key for key in present if f"{key}/".startswith(f"{place}/")} for place in how.drop}
    if unpresent := [place for place, keys in dropped.items() if not keys]:
        raise InvalidSetup(f"drop has {', '.join(unpresent)}, which no dataset has; they have {', '.join(present)}.")
    left_out = set[str]().union(*dropped.values())
    infos = [replace(info, features=tuple(f for f in info.features if f.key not in left_out)) for info in infos]
    if how.common:
        shared = set.intersection(*({feature.key for feature in info.features} for info in infos))
        infos = [replace(info, features=tuple(f for f in info.features if f.key in shared)) for info in infos]
    if how.frequency is not None:
        rate = how.frequency
        infos = [info if info.frequency == rate else at_rate(info, rate) for info in infos]
    if how.size is not None:
        size = how.size
        infos = [resized(info, size) if cameras_of(info) else info for info in infos]
    # A state can be restored only in the simulation that made it.
    states = {(info.sim_state_size, json.dumps(info.setup, sort_keys=True)) for info in infos}
    if len(states) > 1:
        infos = [replace(info, sim_state_size=None) for info in infos]
    first = infos[0]
    known = {feature.key: i for i, feature in enumerate(first.features)}
    infos = [
        replace(info, features=tuple(sorted(info.features, key=lambda f: known.get(f.key, len(known)))))
        for info in infos
    ]
    hint = "leave out features (drop, common), rename cameras, or give one size and rate (size, frequency)"
    require_fit(names, infos, hint)
    return [replace(info, features=first.features) for info in infos]


def _rows_stay(before: DatasetInfo, after: DatasetInfo) -> bool:
    is_alike = before.features == after.features and before.sim_state_size == after.sim_state_size
    return is_alike and before.frequency == after.frequency


def _mapped(episode: EpisodeRecord, after: DatasetInfo, rename: Mapping[str, str]) -> Iterator[pa.Table]:
    info = episode.info
    rows = episode.steps()
    if rename:
        info = renamed(info, rename)
        rows = with_names(rows, info)
    if info.frequency != after.frequency:
        rows = resampled(rows, info, after.frequency)
    sizes = {feature.key: feature for feature in after.features}
    target = replace(info, features=tuple(sizes.get(f.key, f) if f.is_image else f for f in info.features))
    for piece in episode.inlined(rows):
        scaled = with_size(piece, info, target) if target.features != info.features else piece
        yield scaled.select(after.stream_schema.names).cast(after.stream_schema)
