"""Exports to an HDF5 file for robomimic.

`data/demo_<i>` is the i-th episode of `num_samples` steps:

- `obs/<name>`, `next_obs/<name>`: every part of the observation under its own name (`joints`, `left_gripper`), in its
  own dtype; `<camera>_image` (H, W, 3) uint8; `<camera>_depth` (H, W, 1) uint16 [mm]; `<camera>_intrinsics` and so on;
- `actions` float64, `rewards` float64, `dones` (1 where a step ended the episode), `states`: the simulation state,
without columns if there is none; `action_dict/<name>`: each part of the action as recorded.

The attribute `env_args` of `data` describes the robot; `provenance` of an episode says where it is from. `mask/train`
and `mask/valid` split the episodes nine to one, unless they were imported with masks of their own; `mask/success` lists
the successful ones. Normalised actions are (action - offset) / scale, with both in the attribute
`action_normalization_stats`, in the form in which robomimic stores them with a policy.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.hdf5.arrays import load_h5py
from rcs_data.convert.observations import ACTION_DICT, export_report, kept_info, named, observed, short_name
from rcs_data.convert.options import ExportOptions, ExportReport, refuse_unused, selected_episodes
from rcs_data.convert.provenance import episode_provenance
from rcs_data.files.codec import decode_frame
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import new_output
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.read.trajectory import Trajectory, VectorLayout, action_layout, state_layout, trajectory

PROVENANCE = "provenance"
"""The attribute of an episode with its origin."""
VERDICTS = {"success": True, "successful": True, "failure": False}
"""The masks that say how episodes went."""
NORMALISATION = "action_normalization_stats"
"""The attribute of `data` with offset and scale of normalised actions, named as in robomimic's checkpoints."""

# robomimic numbers its kinds of environments; 2 is Gym.
_GYM_ENVIRONMENT = 2
# One episode in this many is for validation, as in robomimic's own script.
_VALIDATION = 10
# Where an action is constant it is not scaled; robomimic's limit for that.
_LEAST_RANGE = 1e-4
# On noisy images level 6 takes twice as long and saves little.
_ZLIB_LEVEL = 1


def export_robomimic(dataset: Dataset, out: str | Path, options: ExportOptions | None = None) -> ExportReport:
    """Export episodes as one HDF5 file for robomimic.

    Args:
        dataset: The dataset.
        out: The file.
        options: Episodes, cameras and features. `state` selects the parts of the observation in `obs`, each under its
            own name; None for all. `compress` is for images, `normalise` for `actions`.

    Raises:
        MissingDependency: h5py is not installed.
        InvalidSetup: An option does not suit the dataset, or nothing is left to export.
        CorruptEpisode: An episode is damaged.
        DatasetError: The file exists already, or the disk fails.
    """
    h5py = load_h5py()
    options = options or ExportOptions()
    refuse_unused(options, "robomimic", ("state", "action", "compress", "normalise"))
    episodes = selected_episodes(dataset, options)
    info = kept_info(dataset.info, options)
    # Only observed images have a place.
    info = replace(info, features=tuple(f for f in info.features if f in observed(info) or not f.is_image))
    action = action_layout(info, options.action)
    parts = observed(info)
    if options.state is not None:
        parts = (*state_layout(info, options.state).features, *(feature for feature in parts if feature.is_image))
    observations = named(parts, lambda f: short_name(f, "{camera}_{kind}"))
    digest = dataset.digest()
    total = sum(episode.length - 1 for episode in episodes)
    low, high = _limits(episodes, action)
    offset, scale = _normalisation(low, high) if options.normalise else (np.zeros_like(low), np.ones_like(low))
    done = 0
    with new_output(out) as partial, h5py.File(partial, "w", libver=("v110", "v110")) as file:
        data = file.create_group("data")
        data.attrs["total"] = total
        data.attrs["env_args"] = json.dumps(_environment(info, action))
        if options.normalise:
            statistics = {"offset": [offset.tolist()], "scale": [scale.tolist()]}
            data.attrs[NORMALISATION] = json.dumps({"actions": statistics})
        for i, episode in enumerate(episodes):
            demo = data.create_group(f"demo_{i}")
            steps = trajectory(episode, VectorLayout(features=()), action)
            _write_demo(demo, episode, steps, observations, action, options.compress)
            demo["actions"] = (steps.actions - offset) / scale
            demo.attrs[PROVENANCE] = json.dumps(episode_provenance(episode, digest))
            done += len(steps)
            if options.on_progress is not None:
                options.on_progress(done, total)
        for name, members in _masks(episodes).items():
            file[f"mask/{name}"] = np.array([f"demo_{i}" for i in members], "S")
    is_fit = options.normalise or (low.min() >= -1 and high.max() <= 1)
    notes = () if is_fit else (_range_note(low.min(), high.max()),)
    return export_report(
        Path(out), dataset, options, episodes, total * sum(feature.is_image for feature in parts), notes
    )


def _write_demo(
    demo: Any,
    episode: EpisodeRecord,
    steps: Trajectory,
    observations: dict[str, Feature],
    action: VectorLayout,
    compress: bool,
) -> None:
    demo.attrs["num_samples"] = len(steps)
    for name, feature in observations.items():
        if feature.is_image:
            _write_images(demo, name, episode, feature, compress)
        else:
            rows = episode.column(feature.key)
            demo[f"obs/{name}"], demo[f"next_obs/{name}"] = rows[:-1], rows[1:]
    dictionary = {"_".join(key.split("/")[1:]): steps.actions[:, part] for key, part in action.slices.items()}
    imported = (f for f in episode.info.features if f.key.startswith(ACTION_DICT))
    dictionary |= {feature.key.removeprefix(ACTION_DICT): episode.column(feature.key)[1:] for feature in imported}
    for name, values in dictionary.items():
        demo[f"{ACTION_DICT}{name}"] = values
    demo["rewards"] = steps.rewards
    is_last = np.arange(len(steps)) == len(steps) - 1
    demo["dones"] = (steps.terminated | steps.truncated | is_last).astype(np.int64)
    if episode.info.sim_state_size is None:
        demo["states"] = np.empty((len(steps), 0))
    else:
        demo["states"] = episode.sim_state()[:-1]


def _write_images(demo: Any, name: str, episode: EpisodeRecord, feature: Feature, compress: bool) -> None:
    """Write an image per step to `obs` and the one after it to `next_obs`, each decoded and compressed once."""
    shape = feature.shape if len(feature.shape) == 3 else (*feature.shape, 1)
    form: dict[str, Any] = {"shape": (episode.length - 1, *shape), "dtype": feature.dtype, "chunks": (1, *shape)}
    if compress:
        form |= {"compression": "gzip", "compression_opts": _ZLIB_LEVEL, "shuffle": feature.numpy_dtype.itemsize > 1}
    now, after = (demo.create_dataset(f"{group}/{name}", **form).id for group in ("obs", "next_obs"))
    last, chunk = None, b""
    for row, data in enumerate(episode.encoded_frames(feature.key)):
        if data is not last:
            last, chunk = data, _chunk(decode_frame(feature, data), compress)
        start = (0,) * len(shape)
        if row < episode.length - 1:
            now.write_direct_chunk((row, *start), chunk)
        if row > 0:
            after.write_direct_chunk((row - 1, *start), chunk)


def _chunk(image: NDArray[Any], compress: bool) -> bytes:
    """Return an image as stored in HDF5: with `compress`, byte-shuffled and compressed by zlib."""
    little_endian = np.ascontiguousarray(image, image.dtype.newbyteorder("<"))
    if not compress:
        return little_endian.tobytes()
    shuffled = little_endian.view(np.uint8).reshape(-1, image.dtype.itemsize).T
    return zlib.compress(shuffled.tobytes(), _ZLIB_LEVEL)


def _environment(info: DatasetInfo, action: VectorLayout) -> dict[str, Any]:
    # What was executed is absolute, whatever the actions are relative to.
    is_own = all(feature.key.startswith("action/") for feature in action.features)
    meaning = {} if is_own else {"relative": "absolute"}
    return {
        "env_name": str(info.setup.get("task") or info.instruction),
        "type": _GYM_ENVIRONMENT,
        "env_kwargs": {**info.setup, **meaning, "control_freq": info.frequency, "instruction": info.instruction},
    }


def _limits(
    episodes: tuple[EpisodeRecord, ...], action: VectorLayout
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and greatest of each number of the actions, shape (size,)."""
    low, high = np.full(action.size, np.inf), np.full(action.size, -np.inf)
    for episode in episodes:
        actions = action.rows(episode)[1:]
        low, high = np.minimum(low, actions.min(axis=0)), np.maximum(high, actions.max(axis=0))
    return low, high


def _normalisation(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    is_constant = high - low < _LEAST_RANGE
    return (low + high) / 2, np.where(is_constant, 1, (high - low) / 2)


def _masks(episodes: tuple[EpisodeRecord, ...]) -> dict[str, list[int]]:
    everyone = range(len(episodes))
    verdicts = {
        "success": [i for i in everyone if episodes[i].success is True],
        "failure": [i for i in everyone if episodes[i].success is False],
    }
    imported = [(episode.outcome.get("imported") or {}).get("masks") or () for episode in episodes]
    if any(imported):
        names = dict.fromkeys(str(name) for masks in imported for name in masks if "/" not in str(name))
        return {
            **{name: [i for i in everyone if name in imported[i]] for name in names},
            **{name: members for name, members in verdicts.items() if members},
        }
    # Every tenth, or the last of fewer; a single episode is for training.
    valid = list(everyone[_VALIDATION - 1 :: _VALIDATION]) or list(everyone[1:][-1:])
    masks = {"train": [i for i in everyone if i not in valid], "valid": valid, **verdicts}
    return {name: members for name, members in masks.items() if members}


def _range_note(low: float, high: float) -> str:
    return (
        f"Actions range from {low:.3g} to {high:.3g} as recorded; robomimic's policies with tanh outputs need them "
        "from -1 to 1: export with --normalise."
    )
