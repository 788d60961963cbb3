from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import simplejpeg
from rcs_data import Windows, check
from rcs_data.convert.formats import EXPORTS, import_format
from rcs_data.convert.hdf5.aloha import import_aloha, is_aloha
from rcs_data.convert.hdf5.robomimic_import import import_robomimic
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.errors import CorruptEpisode, InvalidSetup

STEPS = 5


def test_numbers_of_episodes_are_those_of_their_files(tmp_path: Path) -> None:
    for i in (0, 1, 3, 10):
        _episode(tmp_path / f"in/episode_{i}.hdf5", seed=i)
    back = import_aloha(tmp_path / "in", tmp_path / "back", ImportOptions(episodes=("3", "10-")))
    assert [(e.id, e.outcome["imported"]["file"]) for e in back] == [
        ("000003", "episode_3.hdf5"),
        ("000010", "episode_10.hdf5"),
    ]
    with pytest.raises(InvalidSetup, match="'2' names no episode"):
        import_aloha(tmp_path / "in", tmp_path / "other", ImportOptions(episodes=("2",)))
    (tmp_path / "in" / "episode_0.hdf5").write_bytes(b"damaged")
    with pytest.raises(CorruptEpisode):
        import_aloha(tmp_path / "in", tmp_path / "other")
    rest = import_aloha(tmp_path / "in", tmp_path / "rest", ImportOptions(allow_missing=True))
    assert [episode.id for episode in rest] == ["000001", "000003", "000010"]


@pytest.mark.parametrize("compressed", [False, True])
def test_episodes_become_a_dataset_that_windows_read(tmp_path: Path, compressed: bool) -> None:
    truth = {i: _episode(tmp_path / f"in/episode_{i}.hdf5", seed=i, compressed=compressed) for i in (0, 2, 10)}
    assert is_aloha(tmp_path / "in") and import_format("auto", tmp_path / "in") is import_aloha
    back = import_aloha(tmp_path / "in", tmp_path / "back", ImportOptions(instruction="insert"))
    assert (back.info.frequency, back.info.instruction) == (50, "insert")
    for episode, (i, given) in zip(back.episodes, truth.items(), strict=True):
        assert episode.outcome["imported"]["file"] == f"episode_{i}.hdf5" and episode.outcome["imported"]["sim"]
        assert episode.length == STEPS + 1
        np.testing.assert_array_equal(episode.column("observation/joints")[:-1], given["qpos"])
        np.testing.assert_array_equal(episode.column("observation/velocity")[:-1], given["qvel"])
        np.testing.assert_array_equal(episode.column("action/joints")[1:], given["action"])
        stored = list(episode.encoded_frames("observation/frames/cam_high/rgb"))
        if compressed:
            assert stored[:-1] == given["jpegs"]
        assert stored[-1] == stored[-2]
        seen = episode.column("observation/frames/cam_high/rgb")[:-1].astype(int)
        assert np.abs(seen - given["images"]).max() < 9
    windows = Windows(back, horizon=3)
    assert len(windows) == 3 * STEPS
    np.testing.assert_array_equal(windows[0]["state"][-1], truth[0]["qpos"][0])
    np.testing.assert_array_equal(windows[0]["actions"], truth[0]["action"][:3])
    assert check(tmp_path / "back").is_ok


def test_a_single_file_is_an_episode_and_robomimics_are_others(tmp_path: Path, dataset: Path) -> None:
    _episode(tmp_path / "episode_3.hdf5", seed=3)
    assert import_format("auto", tmp_path / "episode_3.hdf5") is import_aloha
    back = import_aloha(tmp_path / "episode_3.hdf5", tmp_path / "back", ImportOptions(lossless=True, frequency=25))
    assert len(back) == 1 and back.info.frequency == 25
    assert back.info.feature("observation/frames/cam_high/rgb").encoding == "lossless"
    EXPORTS["robomimic"](back, tmp_path / "out.hdf5", ExportOptions())
    assert import_format("auto", tmp_path / "out.hdf5") is import_robomimic


def _rename(file: Any) -> None:
    file.move("observations/qpos", "observations/joints")


def _cut(file: Any) -> None:
    file["action"].resize(3, 0)


def _shorten(file: Any) -> None:
    file["observations/qvel"].resize(9, 1)


def _empty(file: Any) -> None:
    for name in ("action", "observations/qpos", "observations/qvel"):
        file[name].resize(0, 0)


def _damage(file: Any) -> None:
    file["observations/images/cam_high"][2, 40:] = 0


def _swap(file: Any) -> None:
    file["observations/images/cam_high"][1, :] = 7


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (_rename, (CorruptEpisode, InvalidSetup), "qpos"),
        (_cut, CorruptEpisode, "expected 3"),
        (_shorten, InvalidSetup, "other episodes have"),
        (_empty, CorruptEpisode, "0 rows"),
        (_damage, CorruptEpisode, "not a whole JPEG"),
        (_swap, CorruptEpisode, "not an image"),
    ],
)
def test_files_that_do_not_fit_are_refused(tmp_path: Path, change: Any, error: Any, message: str) -> None:
    _episode(tmp_path / "in/episode_0.hdf5", seed=0, compressed=True)
    _episode(tmp_path / "in/episode_1.hdf5", seed=1, compressed=True)
    with h5py.File(tmp_path / "in/episode_1.hdf5", "r+") as file:
        change(file)
    with pytest.raises(error, match=message):
        import_aloha(tmp_path / "in", tmp_path / "back")
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_first_file_without_images_is_told(tmp_path: Path) -> None:
    for i in range(2):
        _episode(tmp_path / f"in/episode_{i}.hdf5", seed=i, compressed=True)
    with h5py.File(tmp_path / "in/episode_0.hdf5", "r+") as file:
        del file["observations/images/cam_high"]
        file["observations/images/cam_high"] = np.empty((0, 9), np.uint8)
    with pytest.raises(CorruptEpisode, match=r"cam_high in .* has 0 rows; an episode has at least 1"):
        import_aloha(tmp_path / "in", tmp_path / "back")
    rest = import_aloha(tmp_path / "in", tmp_path / "rest", ImportOptions(allow_missing=True))
    assert [episode.id for episode in rest] == ["000001"]


def test_what_is_no_file_of_aloha_is_told(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="no files of ALOHA"):
        import_aloha(tmp_path, tmp_path / "back")
    (tmp_path / "episode_0.hdf5").write_bytes(b"words")
    assert not is_aloha(tmp_path)
    with pytest.raises(CorruptEpisode, match="Cannot read"):
        import_aloha(tmp_path, tmp_path / "back")


def _episode(path: Path, *, seed: int, compressed: bool = False) -> dict[str, Any]:
    """Write an episode as ACT's record_sim_episodes.py or, compressed, record_episodes.py do."""
    path.parent.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    given: dict[str, Any] = {name: rng.normal(size=(STEPS, 14)) for name in ("qpos", "qvel", "action")}
    smooth = np.add.outer(np.arange(24) * 3, np.arange(32) * 3)[..., None] + np.array([0, 20, 40])
    given["images"] = np.stack([(smooth + 5 * i) % 256 if i > 9 else smooth + 5 * i for i in range(STEPS)]).astype(
        np.uint8
    )
    given["jpegs"] = [simplejpeg.encode_jpeg(image, 50 + 8 * i) for i, image in enumerate(given["images"])]
    with h5py.File(path, "w") as file:
        file.attrs["sim"] = True
        for name in ("qpos", "qvel"):
            file.create_dataset(f"observations/{name}", data=given[name], maxshape=(None, None))
        file.create_dataset("action", data=given["action"], maxshape=(None, None))
        if compressed:
            file.attrs["compress"] = True
            longest = max(map(len, given["jpegs"]))
            padded = np.stack([np.frombuffer(jpeg.ljust(longest, b"\0"), np.uint8) for jpeg in given["jpegs"]])
            file["observations/images/cam_high"] = padded
        else:
            file.create_dataset("observations/images/cam_high", data=given["images"], chunks=(1, 24, 32, 3))
    return given
