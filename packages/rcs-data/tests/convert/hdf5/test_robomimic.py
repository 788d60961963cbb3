from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, Feature
from rcs_data.convert.hdf5.robomimic import export_robomimic
from rcs_data.convert.options import ExportOptions
from rcs_data.errors import InvalidSetup
from rcs_data.read.trajectory import action_layout, state_layout, trajectory


def test_every_step_has_what_was_seen_what_was_done_and_what_came_of_it(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    report = export_robomimic(source, tmp_path / "out.hdf5")
    assert (report.path, report.episodes, report.steps) == (tmp_path / "out.hdf5", 3, 18)
    state, action = state_layout(source.info), action_layout(source.info)
    with h5py.File(report.path) as file:
        assert file["data"].attrs["total"] == 18
        assert list(file["data"]) == ["demo_0", "demo_1", "demo_2"]
        for episode, demo in zip(source.episodes, file["data"].values(), strict=True):
            steps = trajectory(episode, state, action)
            assert demo.attrs["num_samples"] == len(steps)
            np.testing.assert_array_equal(demo["actions"], steps.actions)
            np.testing.assert_array_equal(demo["rewards"], steps.rewards)
            assert demo["dones"][()].tolist() == [int(i == len(steps) - 1) for i in range(len(steps))]
            np.testing.assert_array_equal(demo["states"], episode.sim_state()[:-1])
            for name in ("joints", "gripper"):
                rows = episode.column(f"observation/{name}")
                assert demo[f"obs/{name}"].dtype == rows.dtype
                np.testing.assert_array_equal(demo[f"obs/{name}"], rows[:-1])
                np.testing.assert_array_equal(demo[f"next_obs/{name}"], rows[1:])


@pytest.mark.parametrize("compress", [True, False])
def test_every_pixel_is_as_it_was_recorded(dataset: Path, tmp_path: Path, compress: bool) -> None:
    source = Dataset.open(dataset)
    report = export_robomimic(source, tmp_path / "out.hdf5", ExportOptions(compress=compress))
    assert report.frames == 2 * report.steps
    with h5py.File(report.path) as file:
        for episode, demo in zip(source.episodes, file["data"].values(), strict=True):
            colour = episode.column("observation/frames/wrist/rgb")
            depth = episode.column("observation/frames/wrist/depth")[..., None]
            for group, rows in (("obs", slice(None, -1)), ("next_obs", slice(1, None))):
                assert demo[f"{group}/wrist_image"].dtype == np.uint8
                assert demo[f"{group}/wrist_depth"].dtype == np.uint16
                assert demo[f"{group}/wrist_image"].chunks == (1, 16, 24, 3)  # a frame is read without the others
                assert demo[f"{group}/wrist_image"].compression == ("gzip" if compress else None)
                np.testing.assert_array_equal(demo[f"{group}/wrist_image"], colour[rows])
                np.testing.assert_array_equal(demo[f"{group}/wrist_depth"], depth[rows])


def test_without_a_simulation_states_have_no_columns(tmp_path: Path, make_info: Any, record: Any) -> None:
    with DatasetWriter.open(tmp_path / "source", make_info(sim_state_size=None)) as writer:
        record(writer, "a")
    report = export_robomimic(Dataset.open(tmp_path / "source"), tmp_path / "out.hdf5")
    with h5py.File(report.path) as file:
        assert file["data/demo_0/states"].shape == (5, 0)
        assert list(file["data/demo_0/obs"]) == ["gripper", "joints"]


def test_masks_part_the_episodes_and_name_those_that_succeeded(tmp_path: Path, make_info: Any, record: Any) -> None:
    with DatasetWriter.open(tmp_path / "source", make_info(sim_state_size=None)) as writer:
        for seed in range(12):
            record(writer, f"{seed:02d}", length=2, seed=seed)
    source = Dataset.open(tmp_path / "source")

    def masks(**options: Any) -> dict[str, list[int]]:
        out = tmp_path / f"{len(list(tmp_path.iterdir()))}.hdf5"
        with h5py.File(export_robomimic(source, out, ExportOptions(**options)).path) as file:
            return {name: [int(demo[5:]) for demo in found[()]] for name, found in file["mask"].items()}

    found = masks()
    assert found["valid"] == [9] and sorted(found["train"] + found["valid"]) == list(range(12))
    assert found["success"] == [0, 2, 4, 6, 8, 10] and found["failure"] == [1, 3, 5, 7, 9, 11]
    few = masks(episodes=("00", "02", "04"))
    assert few == {"train": [0, 1], "valid": [2], "success": [0, 1, 2]}
    assert masks(episodes=("01",)) == {"train": [0], "failure": [0]}


def test_the_file_says_what_the_robot_was_and_where_episodes_came_from(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    with h5py.File(export_robomimic(source, tmp_path / "out.hdf5").path) as file:
        environment = json.loads(file["data"].attrs["env_args"])
        assert set(environment) == {"env_name", "type", "env_kwargs"}
        assert environment["env_kwargs"]["robot"] == "fr3" and environment["env_kwargs"]["control_freq"] == 30
        came = json.loads(file["data/demo_1"].attrs["provenance"])
        assert came["episode"] == "000001" and came["seed"] == 1 and came["success"] is False


def test_a_long_description_has_a_place(tmp_path: Path, make_info: Any, record: Any) -> None:
    setup = {"notes": "é" * 200_000}  # an attribute of fixed length ends at 64 KiB
    with DatasetWriter.open(tmp_path / "source", make_info(setup=setup)) as writer:
        record(writer, "a")
    report = export_robomimic(Dataset.open(tmp_path / "source"), tmp_path / "out.hdf5")
    with h5py.File(report.path) as file:
        assert json.loads(file["data"].attrs["env_args"])["env_kwargs"]["notes"] == setup["notes"]


def test_episodes_parts_and_cameras_are_chosen(dataset: Path, tmp_path: Path) -> None:
    options = ExportOptions(success_only=True, cameras=(), state=("observation/joints",), action=("action/index",))
    report = export_robomimic(Dataset.open(dataset), tmp_path / "out.hdf5", options)
    with h5py.File(report.path) as file:
        assert list(file["data"]) == ["demo_0", "demo_1"]
        demo = file["data/demo_1"]
        assert list(demo["obs"]) == list(demo["next_obs"]) == ["joints"]
        assert demo["actions"].shape == (7, 2)
        assert json.loads(demo.attrs["provenance"])["episode"] == "000002"


def test_actions_out_of_the_range_of_robomimic_are_told(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    notes = export_robomimic(source, tmp_path / "a.hdf5", ExportOptions(action=("action/index",))).notes
    assert len(notes) == 1 and "from -7 to 7" in notes[0]


def test_actions_are_normalised_and_the_file_says_how(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    report = export_robomimic(source, tmp_path / "out.hdf5", ExportOptions(normalise=True))
    assert report.notes == ()
    action = action_layout(source.info)
    with h5py.File(report.path) as file:
        stats = json.loads(file["data"].attrs["action_normalization_stats"])["actions"]
        offset, scale = np.array(stats["offset"]), np.array(stats["scale"])
        assert offset.shape == scale.shape == (1, action.size)
        actions = np.concatenate([demo["actions"][()] for demo in file["data"].values()])
        np.testing.assert_allclose(actions.min(axis=0), -1)
        np.testing.assert_allclose(actions.max(axis=0), 1)
        recorded = np.concatenate([action.rows(episode)[1:] for episode in source.episodes])
        np.testing.assert_allclose(actions * scale + offset, recorded, atol=1e-12)


def test_an_action_that_is_constant_becomes_zero(tmp_path: Path, make_info: Any) -> None:
    features = tuple(Feature(key=f"{kind}/joints", shape=(2,), dtype="float64") for kind in ("observation", "action"))
    info = make_info(sim_state_size=None, features=features)
    with DatasetWriter.open(tmp_path / "source", info) as writer, writer.episode("a", seed=None) as episode:
        for i in range(4):
            done = {"action/joints": np.array([3.0, float(i)])} if i else {}
            episode.add({"observation/joints": np.zeros(2), **done})
        episode.finish(True)
    source = Dataset.open(tmp_path / "source")
    with h5py.File(export_robomimic(source, tmp_path / "a.hdf5", ExportOptions(normalise=True)).path) as file:
        np.testing.assert_allclose(file["data/demo_0/actions"], [[0, -1], [0, 0], [0, 1]])


def test_parts_of_the_action_stand_by_themselves(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    options = ExportOptions(action=("action/joints", "action/index"), normalise=True)
    with h5py.File(export_robomimic(source, tmp_path / "a.hdf5", options).path) as file:
        for episode, demo in zip(source.episodes, file["data"].values(), strict=True):
            assert set(demo["action_dict"]) == {"joints", "index"}
            for name in ("joints", "index"):
                np.testing.assert_array_equal(demo["action_dict"][name], episode.column(f"action/{name}")[1:])


def test_a_state_of_images_is_refused_and_leaves_nothing(dataset: Path, tmp_path: Path) -> None:
    before, options = sorted(tmp_path.iterdir()), ExportOptions(state=("observation/frames/wrist/rgb",))
    with pytest.raises(InvalidSetup, match="cannot be joined"):
        export_robomimic(Dataset.open(dataset), tmp_path / "out.hdf5", options)
    assert sorted(tmp_path.iterdir()) == before
