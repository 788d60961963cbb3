"""Opens an HDF5 export with robomimic's own reader, and fails where a value is not what was exported.

Run with the interpreter that has it: `python read_robomimic.py EXPORT EXPECTED`. Prints one line of JSON.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path

import h5py
import numpy as np
import robomimic
import robomimic.utils.obs_utils as obs_utils
import torch
from robomimic.utils.dataset import SequenceDataset


def main() -> dict[str, object]:
    """Compare every step, then read in other ways: cached, in windows, of a mask, with two workers."""
    export, expected = sys.argv[1], Path(sys.argv[2])
    about = json.loads((expected / "about.json").read_text())
    images = [f"{camera}_image" for camera in about["cameras"]]
    depths = [f"{camera}_depth" for camera in about["depths"]]
    parts = ["_".join(key.split("/")[1:]) for key in about["state"]]
    kinds = {"low_dim": parts, "rgb": images, "depth": depths}
    obs_utils.initialize_obs_utils_with_obs_specs({"obs": kinds})

    def dataset(**options) -> SequenceDataset:
        given = {"obs_keys": (*parts, *images, *depths), "dataset_keys": ("actions", "rewards", "dones", "states")}
        return SequenceDataset(hdf5_path=export, **{**given, **options})

    every = dataset()
    assert every.n_demos == about["episodes"], every
    row = 0
    truths = [np.load(expected / f"{index}.npz") for index in range(about["episodes"])]
    for truth in truths:
        steps = len(truth["action"])
        for step in range(steps):
            item = every[row]
            row += 1
            np.testing.assert_array_equal(item["actions"][0], truth["action"][step])
            assert item["rewards"][0] == truth["reward"][step], step
            assert item["dones"][0] == (step == steps - 1), step
            for group, at in (("obs", step), ("next_obs", step + 1)):
                if at == steps:
                    continue
                seen = {name: values[0] for name, values in item[group].items()}
                np.testing.assert_array_equal(np.concatenate([seen[name] for name in parts]), truth["state"][at])
                for camera in about["cameras"]:
                    np.testing.assert_array_equal(seen[f"{camera}_image"], truth[f"image_{camera}"][at])
                for camera in about["depths"]:
                    np.testing.assert_array_equal(seen[f"{camera}_depth"][..., 0], truth[f"depth_{camera}"][at])
    assert row == len(every), (row, len(every))

    with h5py.File(export) as file:
        assert int(file["data"].attrs["total"]) == row
        environment = json.loads(file["data"].attrs["env_args"])
        assert {"env_name", "type", "env_kwargs"} <= set(environment), environment
        masks = {name: len(members) for name, members in file["mask"].items()}
    for name, members in masks.items():
        assert dataset(filter_by_attribute=name).n_demos == members, name
    assert masks["train"] + masks["valid"] == about["episodes"], masks
    windows = dataset(seq_length=4, frame_stack=2, hdf5_cache_mode="low_dim", hdf5_normalize_obs=False)
    batch = next(iter(torch.utils.data.DataLoader(windows, batch_size=4, num_workers=2, shuffle=True)))
    assert batch["actions"].shape == (4, 5, truths[0]["action"].shape[1]), batch["actions"].shape
    for name in images:
        processed = obs_utils.process_obs(batch["obs"][name], obs_key=name)
        assert processed.shape[2] == 3 and 0 <= float(processed.min()) <= float(processed.max()) <= 1
    cached = dataset(hdf5_cache_mode="all")
    np.testing.assert_array_equal(cached[row - 1]["actions"], every[row - 1]["actions"].astype(np.float32))
    return {"reader": f"robomimic {robomimic.__version__}", "export": Path(export).name, "steps": row, "masks": masks}


if __name__ == "__main__":
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every file it opens
        found = main()
    print(json.dumps(found))
