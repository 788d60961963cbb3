"""A loader hands out what the windows have, with any number of workers started in any way, and never overwrites it."""

from __future__ import annotations

import gc
import importlib
import os
import pickle
import sys
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, Windows
from rcs_data.errors import CorruptEpisode, MissingDependency
from rcs_data.read import torch_memory as memory
from rcs_data.read.torch import TorchDataset, collate

STEPS = (21, 30, 1, 14)
RGB, DEPTH = "observation/frames/wrist/rgb", "observation/frames/wrist/depth"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
        Feature(key=RGB, shape=(8, 12, 3), dtype="uint8", encoding="jpeg"),
        Feature(key=DEPTH, shape=(4, 6), dtype="uint16", encoding="depth"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="move")
    path = tmp_path_factory.mktemp("torch") / "dataset"
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for e, steps in enumerate(STEPS):
            with writer.episode(f"{e:06d}", seed=e) as episode:
                for row in range(steps + 1):
                    values: dict[str, Any] = {"observation/joints": rng.normal(size=2)}
                    values |= {"action/joints": rng.normal(size=2)} if row else {}
                    values[RGB] = rng.integers(0, 256, (8, 12, 3), np.uint8)
                    values[DEPTH] = rng.integers(0, 65536, (4, 6), np.uint16)
                    episode.add(values)
                episode.finish(True)
    return Dataset.open(path)


@pytest.fixture
def windows(dataset: Dataset) -> Windows:
    return Windows(dataset, history=2, horizon=4, cameras=("wrist", "wrist/depth"))


def loader(dataset: Any, **options: Any) -> Any:
    return importlib.import_module("torch.utils.data").DataLoader(dataset, batch_size=8, **options)


def check(batch: dict[str, Any], windows: Windows) -> int:
    """Compare a batch with its windows, read one by one."""
    number = {(episode.id, step): i for i in range(len(windows)) for episode, step in [windows.place(i)]}
    for n, place in enumerate(zip(batch["episode"], batch["step"].tolist(), strict=True)):
        expected = windows[number[place]]
        for key in ("state", "actions"):
            np.testing.assert_array_equal(batch[key][n].numpy(), expected[key].astype(np.float32))
        for key in ("is_pad", "is_history_pad"):
            np.testing.assert_array_equal(batch[key][n].numpy(), expected[key])
        colour, depth = (batch["images"][name][n].numpy() for name in ("wrist", "wrist/depth"))
        np.testing.assert_array_equal(colour, np.moveaxis(expected["images"]["wrist"], 3, 1))
        np.testing.assert_array_equal(depth[:, 0], expected["images"]["wrist/depth"])
        assert batch["instruction"][n] == "move"
    return len(batch["step"])


@pytest.mark.extras
def test_a_window_becomes_tensors(windows: Windows) -> None:
    item = TorchDataset(windows)[3]
    shapes = {key: (tuple(item[key].shape), str(item[key].dtype)) for key in ("state", "actions", "is_pad", "step")}
    assert shapes == {
        "state": ((2, 2), "torch.float32"),
        "actions": ((4, 2), "torch.float32"),
        "is_pad": ((4,), "torch.bool"),
        "step": ((), "torch.int64"),
    }
    images = {name: (tuple(image.shape), str(image.dtype)) for name, image in item["images"].items()}
    assert images == {"wrist": ((2, 3, 8, 12), "torch.uint8"), "wrist/depth": ((2, 1, 4, 6), "torch.uint16")}


@pytest.mark.extras
@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_gives_every_window_once(windows: Windows, workers: int) -> None:
    found = loader(TorchDataset(windows), shuffle=True, num_workers=workers)
    for _ in range(2):
        assert sum(check(batch, windows) for batch in found) == len(windows)


@pytest.mark.extras
@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_takes_windows_as_they_are(dataset: Dataset, workers: int) -> None:
    windows = dataset.windows(history=2, actions=4, cameras=("wrist", "wrist/depth"))
    found = loader(windows, shuffle=True, num_workers=workers)
    assert sum(check(batch, windows) for batch in found) == len(windows)


@pytest.mark.extras
@pytest.mark.slow
def test_spawned_workers_give_the_same(windows: Windows) -> None:
    windows[0]  # what this process has read does not go along
    found = loader(TorchDataset(windows), num_workers=1, multiprocessing_context="spawn")
    assert sum(check(batch, windows) for batch in found) == len(windows)


@pytest.mark.extras
@pytest.mark.parametrize("workers", [0, 2])
def test_batches_that_are_kept_are_not_overwritten(windows: Windows, workers: int) -> None:
    options = {"persistent_workers": True, "prefetch_factor": 2} if workers else {}
    found = loader(TorchDataset(windows), shuffle=True, num_workers=workers, **options)
    kept = [batch for _ in range(4) for batch in found]
    # Of some only a part is held, by torch or by numpy.
    parts = [batch["images"]["wrist"][1:2, :, 0] for batch in kept]
    arrays = [batch["images"]["wrist/depth"].numpy()[::2, 0] for batch in kept]
    expected = [part.clone() for part in parts], [array.copy() for array in arrays]
    assert sum(check(batch, windows) for batch in kept) == 4 * len(windows)
    del kept
    gc.collect()
    for _ in range(4):
        assert sum(check(batch, windows) for batch in found) == len(windows)
    assert all(bool((part == copy).all()) for part, copy in zip(parts, expected[0], strict=True))
    assert all((array == copy).all() for array, copy in zip(arrays, expected[1], strict=True))


@pytest.mark.extras
def test_memory_is_used_again_without_workers_too(windows: Windows) -> None:
    whole = TorchDataset(windows)
    memory._spare.clear()
    counts = [2, 2, 1, 3, 2, 1] * 10
    addresses = {whole.batch(range(count))["images"]["wrist"].data_ptr() for count in counts}
    assert len(addresses) <= 6  # those of two cameras, each a few times as they grow
    assert len(memory._spare) <= memory._MOST_SPARE


class Counting(TorchDataset):
    """Says in `step` how many blocks of memory the worker has handed over so far."""

    def batch(self, indices: Any) -> dict[str, Any]:
        batch = super().batch(indices)
        batch["step"][:] = len(memory._handed_over)
        return batch


@pytest.mark.extras
@pytest.mark.parametrize("part", ["whole", "subset"])
def test_a_loader_reads_a_batch_at_once_without_being_told(windows: Windows, part: str) -> None:
    whole = Counted(windows)
    data: Any = importlib.import_module("torch.utils.data")
    found = loader(whole if part == "whole" else data.Subset(whole, list(range(len(whole)))), shuffle=True)
    assert sum(check(batch, windows) for batch in found) == len(windows)
    assert (whole.singles, whole.batches) == (0, len(found))


@pytest.mark.extras
def test_an_own_collate_function_gets_windows(windows: Windows) -> None:
    torch: Any = importlib.import_module("torch")
    own = lambda items: {key: torch.stack([item[key] for item in items]) for key in ("state", "actions")}  # noqa: E731
    (batch, *_) = loader(TorchDataset(windows), collate_fn=own)
    expected = windows.batch(range(8))
    np.testing.assert_array_equal(batch["state"], expected["state"].astype(np.float32))


class Counted(TorchDataset):
    """Counts what is read."""

    singles = batches = 0

    def __getitem__(self, index: int) -> dict[str, Any]:
        self.singles += 1
        return super().__getitem__(index)

    def batch(self, indices: Any) -> dict[str, Any]:
        self.batches += 1
        return super().batch(indices)


@pytest.mark.extras
def test_workers_use_memory_again(windows: Windows) -> None:
    found = loader(Counting(windows), num_workers=1, persistent_workers=True)
    blocks = [int(batch["step"][0]) for _ in range(10) for batch in found]
    cameras, at_once = 2, 5  # two batches ahead, one here, one on its way, one being written
    assert max(blocks) <= cameras * at_once
    assert len(blocks) > 80


@pytest.mark.extras
def test_workers_may_change_a_batch_before_they_send_it(windows: Windows) -> None:
    def smaller(items: Any) -> dict[str, Any]:
        batch = collate(items)
        images = batch["images"]["wrist"]
        assert type(images[:, :1]).__name__ == "Tensor"  # a part is a plain one
        return {"half": images.float() / 2, "part": images[:, -1:], "step": batch["step"], "episode": batch["episode"]}

    number = {(episode.id, step): i for i in range(len(windows)) for episode, step in [windows.place(i)]}
    batches = list(loader(TorchDataset(windows), shuffle=True, num_workers=1, collate_fn=smaller))
    for batch in batches:
        for n, place in enumerate(zip(batch["episode"], batch["step"].tolist(), strict=True)):
            expected = np.moveaxis(windows[number[place]]["images"]["wrist"], 3, 1)
            np.testing.assert_array_equal(batch["half"][n].numpy(), expected.astype(np.float32) / 2)
            np.testing.assert_array_equal(batch["part"][n].numpy(), expected[-1:])


@pytest.mark.extras
def test_a_tensor_that_is_sent_twice_is_sent_as_a_copy() -> None:
    torch: Any = importlib.import_module("torch")
    block = memory.SharedBlock((2, 3), np.dtype("uint16"))
    block.array[:] = [[1, 2, 3], [4, 5, 6]]
    lent = block.lend(torch.from_numpy(block.array).T)
    before = len(memory._handed_over)
    first, second = (pickle.loads(ForkingPickler.dumps(lent)) for _ in range(2))
    assert len(memory._handed_over) == before + 1
    memory._handed_over.pop()
    for tensor in (first, second):
        assert tensor.tolist() == [[1, 4], [2, 5], [3, 6]]


@pytest.mark.extras
def test_torchs_own_tools_take_it(windows: Windows) -> None:
    data: Any = importlib.import_module("torch.utils.data")
    whole = TorchDataset(windows)
    for part in (
        data.Subset(whole, list(range(5, 20))),
        data.ConcatDataset([whole, whole]),
        data.random_split(whole, [0.5, 0.5])[0],
    ):
        assert sum(check(batch, windows) for batch in loader(part)) == len(part)
    (first, *_) = data.DataLoader(whole, batch_size=None)
    assert (first["images"]["wrist"].shape, str(first["state"].dtype)) == ((2, 3, 8, 12), "torch.float32")


@pytest.mark.extras
def test_damage_comes_out_of_a_worker_with_its_name(tmp_path: Path, dataset: Dataset) -> None:
    with DatasetWriter.open(tmp_path / "dataset", dataset.info) as writer, writer.episode("a", seed=0) as episode:
        for row in range(3):
            zeros = {f.key: np.zeros(f.shape, f.numpy_dtype) for f in dataset.info.features}
            episode.add({**zeros, "action/joints": np.zeros(2) if row else None})
        episode.finish(True)
    damaged = Dataset.open(tmp_path / "dataset")
    (damaged.episodes[0].path / "steps.parquet").write_bytes(b"no")
    with pytest.raises(CorruptEpisode, match=r"Cannot read .*steps\.parquet"):
        list(loader(TorchDataset(Windows(damaged)), num_workers=1))


def test_without_torch_the_message_says_what_to_install(windows: Windows, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingDependency, match=r"rcs-data\[torch\]"):
        TorchDataset(windows)


@pytest.mark.extras
def test_a_fork_that_is_done_with_a_batch_leaves_it_to_its_parent(windows: Windows) -> None:
    batches = iter(loader(TorchDataset(windows), num_workers=1))
    batch = next(batches)
    before = batch["images"]["wrist"].clone()
    child = os.fork()
    if child == 0:
        batch.clear()
        gc.collect()
        os._exit(0)
    os.waitpid(child, 0)
    for _ in range(6):
        next(batches)
    assert importlib.import_module("torch").equal(batch["images"]["wrist"], before)
