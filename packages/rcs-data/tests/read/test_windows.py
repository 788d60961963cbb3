"""Windows are pieces of trajectories: nothing is added, nothing is lost, and none crosses into another episode."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, Windows
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.read.trajectory import action_layout, state_layout, trajectory

STEPS = (5, 0, 9, 1, 2)
RGB, DEPTH = "observation/frames/wrist/rgb", "observation/frames/wrist/depth"


def record(path: Path, steps: tuple[int, ...] = STEPS) -> Dataset:
    """Episode e has state 100 e + t and action 1000 + 100 e + t in step t, and noise for images."""
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="observation/gripper", shape=(1,), dtype="float32"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
        Feature(key=RGB, shape=(8, 12, 3), dtype="uint8", encoding="jpeg"),
        Feature(key=DEPTH, shape=(4, 6), dtype="uint16", encoding="depth"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="move")
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for e, count in enumerate(steps):
            with writer.episode(f"{e:06d}", seed=e, instruction=f"move {e}") as episode:
                for row in range(count + 1):
                    value = 100.0 * e + row
                    values: dict[str, Any] = {"observation/joints": np.array([value, -value])}
                    values["observation/gripper"] = np.array([row], np.float32)
                    if row:
                        values["action/joints"] = np.array([999 + value, 0.0])
                    # Every third row has no new image.
                    values[RGB] = rng.integers(0, 256, (8, 12, 3), np.uint8) if row % 3 != 2 else None
                    values[DEPTH] = rng.integers(0, 65536, (4, 6), np.uint16) if row % 3 != 2 else None
                    episode.add(values)
                episode.finish(e != 2)
    return Dataset.open(path)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return record(tmp_path_factory.mktemp("windows") / "dataset")


@settings(max_examples=60, deadline=None)
@given(
    history=st.integers(1, 4),
    horizon=st.integers(1, 6),
    stride=st.integers(1, 4),
    pad=st.sampled_from(["repeat", "drop"]),
)
def test_every_window_has_what_its_flags_and_its_step_say(
    dataset: Dataset, history: int, horizon: int, stride: int, pad: str
) -> None:
    windows = Windows(dataset, history=history, horizon=horizon, stride=stride, pad=pad, cameras=())
    seen: list[tuple[str, int]] = []
    for window in windows:
        e, step = int(window["episode"]), window["step"]
        steps = STEPS[e]
        seen.append((window["episode"], step))
        states, actions = window["state"][:, 0], window["actions"][:, 0]
        wanted = 100 * e + step + np.arange(1 - history, 1)
        np.testing.assert_array_equal(states[~window["is_history_pad"]], wanted[~window["is_history_pad"]])
        np.testing.assert_array_equal(states[window["is_history_pad"]], 100 * e)
        np.testing.assert_array_equal(window["is_history_pad"], wanted < 100 * e)
        wanted = 1000 + 100 * e + step + np.arange(horizon)
        np.testing.assert_array_equal(actions[~window["is_pad"]], wanted[~window["is_pad"]])
        np.testing.assert_array_equal(actions[window["is_pad"]], 999 + 100 * e + steps)
        np.testing.assert_array_equal(window["is_pad"], step + np.arange(horizon) >= steps)
        assert window["instruction"] == f"move {e}"
        assert pad == "repeat" or not (window["is_pad"].any() or window["is_history_pad"].any())
    first, tail = (0, 0) if pad == "repeat" else (history - 1, horizon - 1)
    expected = [(f"{e:06d}", step) for e, n in enumerate(STEPS) for step in range(first, n - tail, stride)]
    assert seen == expected
    assert len(windows) == len(expected)


def test_windows_of_one_step_in_a_row_are_the_trajectory(dataset: Dataset) -> None:
    windows = Windows(dataset, horizon=1)
    for episode in dataset.episodes:
        own = [window for window in windows if window["episode"] == episode.id]
        whole = trajectory(episode, windows.state_layout, windows.action_layout)
        assert len(own) == len(whole) == episode.length - 1
        if not own:
            continue
        np.testing.assert_array_equal(np.concatenate([window["state"] for window in own]), whole.states)
        np.testing.assert_array_equal(np.concatenate([window["actions"] for window in own]), whole.actions)
        images = np.concatenate([window["images"]["wrist"] for window in own])
        np.testing.assert_array_equal(images, episode.column(RGB)[:-1])


def test_a_history_has_the_images_of_its_rows(dataset: Dataset) -> None:
    windows = Windows(dataset, history=3, cameras=("wrist/depth", "wrist"))
    for i in np.random.default_rng(0).permutation(len(windows)).tolist():
        episode, step = windows.place(i)
        rows = np.maximum(step + np.arange(-2, 1), 0)
        images = windows[i]["images"]
        assert list(images) == ["wrist/depth", "wrist"]
        np.testing.assert_array_equal(images["wrist"], episode.column(RGB)[rows])
        np.testing.assert_array_equal(images["wrist/depth"], episode.column(DEPTH)[rows])


def test_a_batch_has_its_windows_in_the_order_asked_for(dataset: Dataset) -> None:
    windows = Windows(dataset, history=2, horizon=3)
    indices = [7, 0, -1, 7]
    batch = windows.batch(indices)
    assert batch["images"]["wrist"].shape == (4, 2, 8, 12, 3)
    for n, i in enumerate(indices):
        window = windows[i]
        for key in ("state", "actions", "is_pad", "is_history_pad", "instruction", "episode", "step"):
            np.testing.assert_array_equal(batch[key][n], window[key])
        np.testing.assert_array_equal(batch["images"]["wrist"][n], window["images"]["wrist"])
    out = windows.new_images(4)
    assert windows.batch(indices, images=out)["images"]["wrist"] is out["wrist"]
    np.testing.assert_array_equal(out["wrist"], batch["images"]["wrist"])
    empty = windows.batch([])
    assert (empty["state"].shape, empty["actions"].shape) == ((0, 2, 3), (0, 3, 2))


def test_it_is_a_sequence(dataset: Dataset) -> None:
    windows = Windows(dataset, cameras=())
    assert len(windows) == sum(STEPS)
    assert windows[-1]["step"] == windows[np.int64(len(windows) - 1)]["step"] == 1
    assert [window["step"] for window in windows[5:8]] == [0, 1, 2]
    for i in (len(windows), -len(windows) - 1):
        with pytest.raises(IndexError, match="there are 17"):
            windows[i]


def test_a_window_can_be_changed_without_changing_the_next(dataset: Dataset) -> None:
    windows = Windows(dataset)
    first = windows[3]
    expected = {key: np.copy(first[key]) for key in ("state", "actions")}
    image = first["images"]["wrist"].copy()
    for array in (first["state"], first["actions"], first["images"]["wrist"]):
        array[:] = 77
    again = windows[3]
    np.testing.assert_array_equal(again["state"], expected["state"])
    np.testing.assert_array_equal(again["actions"], expected["actions"])
    np.testing.assert_array_equal(again["images"]["wrist"], image)


def test_state_action_cameras_and_episodes_can_be_chosen(dataset: Dataset) -> None:
    good = [episode for episode in dataset.episodes if episode.success]
    windows = Windows(dataset, episodes=good, state=("observation/gripper",), action=("action/joints",), cameras=())
    assert {window["episode"] for window in windows} == {"000000", "000003", "000004"}
    assert windows[0]["state"].shape == (1, 1)
    assert windows[0]["images"] == {}
    assert windows.state_layout.names == ("gripper",)


def test_images_come_in_the_size_asked_for(dataset: Dataset) -> None:
    small = Windows(dataset, image_size=(6, 4), history=2)
    assert small.image_shape("wrist") == (4, 6, 3)
    assert small[3]["images"]["wrist"].shape == (2, 4, 6, 3)
    mean = Windows(dataset, history=2)[3]["images"]["wrist"].mean((1, 2, 3))
    np.testing.assert_allclose(small[3]["images"]["wrist"].mean((1, 2, 3)), mean, atol=12)
    whole = Windows(dataset, image_size=(12, 8))
    np.testing.assert_array_equal(whole[3]["images"]["wrist"], Windows(dataset)[3]["images"]["wrist"])


def test_little_memory_changes_nothing(dataset: Dataset) -> None:
    windows, tight = Windows(dataset), Windows(dataset, cache_bytes=0)
    for i in np.random.default_rng(0).permutation(len(windows)).tolist():
        np.testing.assert_array_equal(tight[i]["actions"], windows[i]["actions"])
    assert len(tight._vectors) == 1


def test_another_process_starts_with_nothing_read(dataset: Dataset) -> None:
    windows = Windows(dataset, history=2)
    fresh = len(pickle.dumps(windows))
    expected = [windows[i] for i in range(len(windows))]
    copied = pickle.loads(pickle.dumps(windows))
    assert len(pickle.dumps(windows)) <= fresh
    for i, window in enumerate(expected):
        np.testing.assert_array_equal(copied[i]["images"]["wrist"], window["images"]["wrist"])
        np.testing.assert_array_equal(copied[i]["state"], window["state"])


def test_statistics_count_each_step_once(dataset: Dataset) -> None:
    told: list[tuple[int, int]] = []
    windows = Windows(dataset, history=3, horizon=5, stride=2, pad="drop", cameras=())
    found = windows.statistics(lambda done, of: told.append((done, of)))
    whole = [trajectory(e, windows.state_layout, windows.action_layout) for e in dataset.episodes]
    for name, values in (("state", [t.states for t in whole]), ("actions", [t.actions for t in whole])):
        assert found[name].count == sum(STEPS)
        np.testing.assert_allclose(found[name].mean, np.concatenate(values).mean(axis=0))
        np.testing.assert_allclose(found[name].q99, np.quantile(np.concatenate(values), 0.99, axis=0))
    assert told[-1] == (5, 5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"history": 0}, "history is 0; valid is a whole number from 1"),
        ({"history": 1.5}, "history is 1.5; valid is a whole number from 1"),
        ({"horizon": 0}, "horizon is 0"),
        ({"stride": 0}, "stride is 0"),
        ({"pad": "zero"}, "valid are repeat, drop"),
        ({"cameras": ("side",)}, "no camera of this dataset named 'side'. .*Known: wrist, wrist/depth"),
        ({"cameras": ("wirst",)}, "Did you mean 'wrist'"),
        ({"state": ("observation/griper",)}, "Did you mean 'observation/gripper'"),
        ({"cameras": "wrist"}, r"cameras is 'wrist'; it must be a sequence of names"),
        ({"cameras": ("wrist/depth",), "image_size": (4, 4)}, "cannot be scaled"),
        ({"state": (RGB,)}, "cannot be joined"),
        ({"state": "observation/joints"}, r"is one text; valid is a sequence of features"),
        ({"image_size": 224}, "image_size is 224; it must be width and height"),
        ({"image_size": (224, 224, 3)}, r"image_size is \(224, 224, 3\); it must be"),
        ({"episodes": ("000009",)}, "no episode '000009'"),
        ({"episodes": ()}, "None of the 0 episodes"),
        ({"horizon": 10, "pad": "drop"}, "has the 10 steps of one window; use pad='repeat'"),
    ],
)
def test_what_makes_no_sense_is_refused(dataset: Dataset, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetup, match=message):
        Windows(dataset, **options)


def test_an_episode_of_another_dataset_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    info = DatasetInfo(frequency=5.0, features=dataset.info.features, setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "other", info):
        other = Dataset.open(tmp_path / "other")
    with pytest.raises(InvalidSetup, match="Episode '000000' is not of the dataset"):
        Windows(other, episodes=dataset.episodes)


def test_a_damaged_episode_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    dataset = record(tmp_path / "dataset", (3, 3))
    (dataset.episodes[0].path / "steps.parquet").write_bytes(b"no")
    windows = Windows(dataset)
    with pytest.raises(CorruptEpisode, match=r"Cannot read .*000000/steps\.parquet"):
        windows[0]
    assert windows[3]["episode"] == "000001"


@pytest.mark.parametrize("key", ["action/joints", "executed/joints", "reward", "time/period"])
def test_what_is_unknown_at_the_reset_is_no_state(key: str) -> None:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key=key, shape=(), dtype="float64"),
    )
    info = DatasetInfo(frequency=10.0, features=features, setup={}, instruction="")
    with pytest.raises(InvalidSetup, match="before the first step, it may have no value"):
        state_layout(info, ("observation/joints", key))


def test_an_imported_vector_is_not_left_out_for_a_part_beside_it() -> None:
    keys = ("observation/state", "observation/gripper", "action/action", "action/gripper")
    features = tuple(Feature(key=key, shape=(2,), dtype="float32") for key in keys)
    info = DatasetInfo(frequency=10.0, features=features, setup={}, instruction="")
    assert [f.key for f in state_layout(info).features] == list(keys[:2])
    assert [f.key for f in action_layout(info).features] == list(keys[2:])
