from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from rcs_data import Dataset, check, edit
from rcs_data.convert.formats import import_format
from rcs_data.convert.hdf5.robomimic import export_robomimic
from rcs_data.convert.hdf5.robomimic_import import import_robomimic
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.read.trajectory import action_layout


def test_an_export_comes_back_with_observations_actions_and_verdicts(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    export_robomimic(source, tmp_path / "out.hdf5")
    back = import_robomimic(tmp_path / "out.hdf5", tmp_path / "back", ImportOptions(lossless=True))
    assert (back.info.frequency, back.info.instruction) == (source.info.frequency, source.info.instruction)
    for old, new in zip(source.episodes, back.episodes, strict=True):
        names = ("id", "seed", "success", "length", "instruction", "failure")
        assert [getattr(new, name) for name in names] == [getattr(old, name) for name in names]
        assert new.outcome["imported"]["provenance"]["content_hash"] == old.content_hash
        for key in ("observation/joints", "observation/gripper", "observation/frames/wrist/rgb", "reward"):
            np.testing.assert_array_equal(new.column(key), old.column(key), err_msg=key)
        np.testing.assert_array_equal(new.column("action/action"), action_layout(source.info).rows(old))
        np.testing.assert_array_equal(new.column("simulation/states")[:-1], old.sim_state()[:-1])
    assert check(tmp_path / "back").is_ok


def test_relative_actions_come_back_as_such(make_dataset: Callable[..., Dataset], tmp_path: Path) -> None:
    meaning = {"control": "joints", "relative": "last_step"}
    source = make_dataset(episodes=1, cameras=False, setup={"robot": "fr3", **meaning})
    export_robomimic(source, tmp_path / "out.hdf5")
    back = import_robomimic(tmp_path / "out.hdf5", tmp_path / "back")
    assert {key: back.info.setup.get(key) for key in meaning} == meaning
    with pytest.raises(InvalidSetup, match="action/action cannot be resampled"):
        edit.resample(back.path, 10)


def test_normalised_actions_come_back_in_their_units(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    export_robomimic(source, tmp_path / "out.hdf5", ExportOptions(normalise=True))
    back = import_robomimic(tmp_path / "out.hdf5", tmp_path / "back")
    for old, new in zip(source.episodes, back.episodes, strict=True):
        np.testing.assert_allclose(new.column("action/action")[1:], action_layout(source.info).rows(old)[1:], atol=1e-6)
    with h5py.File(tmp_path / "out.hdf5", "r+") as file:
        file["data"].attrs["action_normalization_stats"] = json.dumps(
            {"actions": {"offset": [[1.0]], "scale": [[2.0]]}}
        )
    with pytest.raises(CorruptEpisode, match="no offset and scale of"):
        import_robomimic(tmp_path / "out.hdf5", tmp_path / "wrong")


def test_what_was_not_exported_is_not_missed(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    options = ExportOptions(cameras=(), episodes=("000002",), state=("observation/gripper",))
    export_robomimic(source, tmp_path / "out.hdf5", options)
    back = import_robomimic(tmp_path / "out.hdf5", tmp_path / "back")
    assert [episode.id for episode in back.episodes] == ["000002"]
    assert [f.key for f in back.info.features if f.key.startswith("observation/")] == ["observation/gripper"]


def test_a_file_of_others_becomes_a_dataset(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    _foreign(tmp_path / "in.hdf5", [(f"demo_{i}", 4, {}) for i in range(11)])
    with h5py.File(tmp_path / "in.hdf5", "r+") as file:
        file["mask/success"] = np.array(["demo_2", "demo_10"], "S")
        for i in range(11):
            image = np.repeat(rng.integers(0, 256, (4, 1, 1, 3), np.uint8), 16, 1).repeat(16, 2)
            file[f"data/demo_{i}/obs/agentview_image"] = image
            file[f"data/demo_{i}/next_obs/agentview_image"] = np.roll(image, -1, 0)
            file[f"data/demo_{i}/obs/agentview_depth"] = rng.integers(0, 65536, (4, 6, 8, 1), np.uint16)
    assert import_format("auto", tmp_path / "in.hdf5") is import_robomimic
    back = import_robomimic(tmp_path / "in.hdf5", tmp_path / "back")
    assert back.info.frequency == 20 and back.info.instruction == "Lift"
    assert back.info.setup["imported"]["env_args"]["env_name"] == "Lift"
    kinds = {feature.key: (feature.shape, feature.dtype, feature.encoding) for feature in back.info.features}
    assert kinds == {
        "observation/robot0_eef_pos": ((3,), "float64", "plain"),
        "observation/frames/agentview/rgb": ((16, 16, 3), "uint8", "jpeg"),
        "observation/frames/agentview/depth": ((6, 8), "uint16", "depth"),
        "action/action": ((2,), "float32", "plain"),
        "reward": ((), "float64", "plain"),
        "terminated": ((), "bool", "plain"),
        "simulation/states": ((5,), "float64", "plain"),
    }
    with h5py.File(tmp_path / "in.hdf5") as file:
        for i, episode in enumerate(back.episodes):  # demo_10 is the eleventh, not the third
            demo = file[f"data/demo_{i}"]
            assert episode.length == 5 and episode.success is (True if i in (2, 10) else None)
            np.testing.assert_array_equal(episode.column("action/action")[1:], demo["actions"])
            np.testing.assert_array_equal(episode.column("reward")[1:], demo["rewards"])
            np.testing.assert_array_equal(episode.column("terminated"), [False, *demo["dones"][()].astype(bool)])
            seen = episode.column("observation/robot0_eef_pos")
            np.testing.assert_array_equal(seen[:-1], demo["obs/robot0_eef_pos"])
            np.testing.assert_array_equal(seen[-1], demo["next_obs/robot0_eef_pos"][-1])
            np.testing.assert_array_equal(
                episode.column("observation/frames/agentview/depth")[:-1], demo["obs/agentview_depth"][..., 0]
            )
            colour = episode.column("observation/frames/agentview/rgb").astype(int)
            assert np.abs(colour[:-1] - demo["obs/agentview_image"]).max() <= 3
            assert np.abs(colour[-1] - demo["next_obs/agentview_image"][-1]).max() <= 3
            imported = episode.outcome["imported"]
            assert imported["episode"] == f"demo_{i}" and imported["last_observation"] == "repeated"
            assert imported["repeated"] == ["observation/frames/agentview/depth", "simulation/states"]
    assert check(tmp_path / "back").is_ok


def test_other_forms_of_the_action_and_masks_are_kept_there_and_back(tmp_path: Path) -> None:
    _foreign(tmp_path / "in.hdf5", [(f"demo_{i}", 4, {}) for i in range(3)])
    with h5py.File(tmp_path / "in.hdf5", "r+") as file:
        for i in range(3):
            file[f"data/demo_{i}/action_dict/abs_pos"] = np.arange(12.0).reshape(4, 3) + i
            file[f"data/demo_{i}/action_dict/gripper"] = np.ones((4, 1))
        file["mask/train"] = np.array(["demo_0", "demo_2"], "S")
        file["mask/20_percent"] = np.array(["demo_1"], "S")
        file["mask/success"] = np.array(["demo_1"], "S")
    back = import_robomimic(tmp_path / "in.hdf5", tmp_path / "back")
    assert [episode.outcome["imported"].get("masks") for episode in back.episodes] == [
        ["train"],
        ["20_percent"],
        ["train"],
    ]
    np.testing.assert_array_equal(back.episodes[1].column("action_dict/abs_pos")[1:], np.arange(12.0).reshape(4, 3) + 1)
    assert [feature.key for feature in action_layout(back.info).features] == ["action/action"]
    with h5py.File(export_robomimic(back, tmp_path / "out.hdf5").path) as file:
        found = {name: [member.decode() for member in members[()]] for name, members in file["mask"].items()}
        assert found == {"train": ["demo_0", "demo_2"], "20_percent": ["demo_1"], "success": ["demo_1"]}
        with h5py.File(tmp_path / "in.hdf5") as given:
            for name in ("action_dict/abs_pos", "action_dict/gripper", "actions"):
                np.testing.assert_array_equal(file[f"data/demo_2/{name}"], given[f"data/demo_2/{name}"])


def test_without_next_obs_the_last_observation_is_repeated_and_said_to_be(tmp_path: Path) -> None:
    _foreign(tmp_path / "in.hdf5", [("demo_0", 4, {})])
    with h5py.File(tmp_path / "in.hdf5", "r+") as file:
        del file["data/demo_0/next_obs"]
    (episode,) = import_robomimic(tmp_path / "in.hdf5", tmp_path / "back").episodes
    seen = episode.column("observation/robot0_eef_pos")
    np.testing.assert_array_equal(seen[-1], seen[-2])
    assert "observation/robot0_eef_pos" in episode.outcome["imported"]["repeated"]


def test_instructions_are_found_where_libero_and_robocasa_have_them(tmp_path: Path) -> None:
    demos = [("demo_0", 3, {}), ("demo_1", 3, {"ep_meta": json.dumps({"lang": "close the drawer"})})]
    _foreign(tmp_path / "in.hdf5", demos)
    with h5py.File(tmp_path / "in.hdf5", "r+") as file:
        file["data"].attrs["problem_info"] = json.dumps({"language_instruction": "öffne die Tür"})
    back = import_robomimic(tmp_path / "in.hdf5", tmp_path / "back", ImportOptions(instruction="not this"))
    assert [episode.instruction for episode in back.episodes] == ["öffne die Tür", "close the drawer"]


def test_what_is_unknown_is_kept_and_what_is_no_number_is_named(tmp_path: Path) -> None:
    _foreign(tmp_path / "in.hdf5", [("demo_0", 3, {})])
    with h5py.File(tmp_path / "in.hdf5", "r+") as file:
        demo = file["data/demo_0"]
        demo["robot_states"] = np.arange(6, dtype=np.float16).reshape(3, 2)
        demo["actions_abs"] = np.arange(6, dtype=">f8").reshape(3, 2)
        demo["obs/words"] = ["a", "b", "c"]
        demo["obs/nested/part"] = np.zeros(3)
    back = import_robomimic(tmp_path / "in.hdf5", tmp_path / "back")
    (episode,) = back.episodes
    np.testing.assert_array_equal(episode.column("imported/robot_states")[:-1], [[0, 1], [2, 3], [4, 5]])
    np.testing.assert_array_equal(episode.column("action/actions_abs")[1:], [[0, 1], [2, 3], [4, 5]])
    assert set(back.info.setup["imported"]["left_out"]) == {"obs/words", "obs/nested"}


def test_a_rate_that_the_file_does_not_have_must_be_given(tmp_path: Path) -> None:
    _foreign(tmp_path / "in.hdf5", [("demo_0", 3, {})], environment={"env_name": "x", "type": 2, "env_kwargs": None})
    with pytest.raises(InvalidSetup, match="give frequency"):
        import_robomimic(tmp_path / "in.hdf5", tmp_path / "back")
    assert not (tmp_path / "back").exists()
    assert (
        import_robomimic(tmp_path / "in.hdf5", tmp_path / "back", ImportOptions(frequency=12.5)).info.frequency == 12.5
    )


@pytest.mark.parametrize(
    ("name", "values", "error", "message"),
    [
        ("obs/robot0_eef_pos", np.zeros((3, 3)), CorruptEpisode, "3 rows; expected 4"),
        ("obs/robot0_eef_pos", np.zeros((4, 2)), InvalidSetup, "other episodes have"),
        ("obs/robot0_eef_pos", None, InvalidSetup, "other episodes have"),
        ("actions", None, CorruptEpisode, "no actions"),
        ("actions", np.zeros((0, 2)), CorruptEpisode, "no actions"),
    ],
)
def test_episodes_that_do_not_fit_are_refused_by_name(
    tmp_path: Path, name: str, values: Any, error: type[Exception], message: str
) -> None:
    _foreign(tmp_path / "in.hdf5", [("demo_0", 4, {}), ("demo_1", 4, {})])
    with h5py.File(tmp_path / "in.hdf5", "r+") as file:
        del file[f"data/demo_1/{name}"]
        if values is not None:
            file[f"data/demo_1/{name}"] = values
    with pytest.raises(error, match=message) as refused:
        import_robomimic(tmp_path / "in.hdf5", tmp_path / "back")
    assert "demo_1" in str(refused.value)
    assert [path.name for path in tmp_path.iterdir()] == ["in.hdf5"]


def test_what_is_no_file_of_robomimic_is_told(dataset: Path, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "empty.hdf5", "w") as file:
        file["other"] = 1
    with pytest.raises(InvalidSetup, match="no episodes"):
        import_robomimic(tmp_path / "empty.hdf5", tmp_path / "back")
    with h5py.File(tmp_path / "array.hdf5", "w") as file:
        file["data/x"] = np.zeros((3, 2))
    with pytest.raises(InvalidSetup, match="/data/x is an array, not an episode"):
        import_robomimic(tmp_path / "array.hdf5", tmp_path / "back")
    (tmp_path / "text.hdf5").write_text("words")
    with pytest.raises(CorruptEpisode, match="Cannot read"):
        import_robomimic(tmp_path / "text.hdf5", tmp_path / "back")
    export_robomimic(Dataset.open(dataset), tmp_path / "cut.hdf5")
    cut = (tmp_path / "cut.hdf5").read_bytes()
    (tmp_path / "cut.hdf5").write_bytes(cut[: len(cut) // 2])
    with pytest.raises(CorruptEpisode, match="Cannot read"):
        import_robomimic(tmp_path / "cut.hdf5", tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_progress_ends_at_the_number_of_steps_and_a_dataset_is_not_written_over(dataset: Path, tmp_path: Path) -> None:
    export_robomimic(Dataset.open(dataset), tmp_path / "out.hdf5")
    calls: list[tuple[int, int]] = []
    options = ImportOptions(on_progress=lambda done, total: calls.append((done, total)))
    import_robomimic(tmp_path / "out.hdf5", tmp_path / "back", options)
    assert calls[-1] == (18, 18) and calls == sorted(calls)
    with pytest.raises(DatasetError, match="exists already"):
        import_robomimic(tmp_path / "out.hdf5", tmp_path / "back")


def _foreign(
    path: Path, demos: list[tuple[str, int, dict[str, str]]], environment: dict[str, Any] | None = None
) -> None:
    """Write a file as robosuite and robomimic do, without a camera."""
    environment = environment or {"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 20}}
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps(environment)
        data.attrs["total"] = sum(length for _, length, _ in demos)
        for name, length, attributes in demos:
            demo = data.create_group(name)
            demo.attrs["num_samples"] = length
            for key, value in attributes.items():
                demo.attrs[key] = value
            rows = rng.normal(size=(length + 1, 3))
            demo["obs/robot0_eef_pos"], demo["next_obs/robot0_eef_pos"] = rows[:-1], rows[1:]
            demo["actions"] = rng.normal(size=(length, 2)).astype(np.float32)
            demo["rewards"] = rng.normal(size=length)
            demo["dones"] = (np.arange(length) == length - 1).astype(np.int64)
            demo["states"] = rng.normal(size=(length, 5))
