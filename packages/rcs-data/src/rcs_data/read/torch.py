"""Windows of a dataset as torch tensors, for `torch.utils.data.DataLoader`."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs_data.errors import package_of
from rcs_data.read.torch_memory import SharedBlock, reused_tensor

Tensors = dict[str, Any]
"""A window or a batch of them, with the keys of `rcs_data.Window`.

Vectors are float32, flags bool, images uint8 of shape (..., history, 3, H, W), depth uint16 (..., history, 1, H, W).
The memory format is torch's `channels_last`; `.contiguous()` returns planes.
"""

if TYPE_CHECKING:
    from torch.utils.data import Dataset  # pyright: ignore[reportMissingImports]

    from rcs_data.read.windows import WindowBatch, Windows

    _Dataset = Dataset[Tensors]
else:
    # Torch accepts anything with a length and items; its base class would require torch at import.
    _Dataset = object


class TorchDataset(_Dataset):  # pyright: ignore[reportUntypedBaseClass]  where torch is not installed
    """Windows as tensors, for a `DataLoader` with any number of workers, forked or spawned.

        loader = DataLoader(TorchDataset(windows), batch_size=64, shuffle=True, num_workers=4)

    Images are decoded straight into the memory of the batch, since torch's own `default_collate` is given a way to make
    a batch of these windows. `Subset` and `random_split` accept this dataset too; through `ConcatDataset`, windows are
    read one by one, which is slower.
    """

    def __init__(self, windows: Windows) -> None:
        """Take windows.

        Raises:
            MissingDependency: torch is not installed.
        """
        _torch()
        self.windows = windows

    def __len__(self) -> int:
        return len(self.windows)

    def __getitem__(self, index: int) -> Tensors:
        """Read one window.

        Raises:
            IndexError: There is no such window.
            CorruptEpisode: The episode is damaged.
        """
        torch = _torch()
        read = self.windows.batch([index])
        batch = _as_tensors(torch, read, {name: torch.from_numpy(array) for name, array in read["images"].items()})
        images = {name: tensor[0] for name, tensor in batch["images"].items()}
        return {**{key: value[0] for key, value in batch.items() if key != "images"}, "images": images}

    def __getitems__(self, indices: Sequence[int]) -> list[ChosenWindow]:
        """Choose windows; torch calls this for each batch and passes the result to the `collate_fn`."""
        _torch().utils.data._utils.collate.default_collate_fn_map[ChosenWindow] = collate
        return [ChosenWindow(self, index) for index in indices]

    def batch(self, indices: Sequence[int]) -> Tensors:
        """Read several windows into one tensor each.

        Raises:
            IndexError: There is no such window.
            CorruptEpisode: An episode is damaged.
        """
        torch = _torch()
        arrays = self.windows.new_images(0)
        shapes = {name: ((len(indices), *array.shape[1:]), array.dtype) for name, array in arrays.items()}
        if torch.utils.data.get_worker_info() is None:
            tensors = {name: reused_tensor(*shape) for name, shape in shapes.items()}
            read = self.windows.batch(indices, images={name: tensor.numpy() for name, tensor in tensors.items()})
            return _as_tensors(torch, read, tensors)
        blocks = {name: SharedBlock(*shape) for name, shape in shapes.items()}
        read = self.windows.batch(indices, images={name: block.array for name, block in blocks.items()})
        batch = _as_tensors(torch, read, {name: torch.from_numpy(block.array) for name, block in blocks.items()})
        return {**batch, "images": {name: block.lend(batch["images"][name]) for name, block in blocks.items()}}


class ChosenWindow(Mapping[str, Any]):
    """A window of a batch: read together with the others by `collate`, or alone when it is accessed."""

    def __init__(self, dataset: TorchDataset, index: int) -> None:
        self.dataset = dataset
        self.index = index

    @functools.cached_property
    def tensors(self) -> Tensors:
        """The window, read when it is first accessed."""
        return self.dataset[self.index]

    def __getitem__(self, key: str) -> Any:
        """Return a part of the window."""
        return self.tensors[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.tensors)

    def __len__(self) -> int:
        return len(self.tensors)


def collate(items: Sequence[ChosenWindow], *, collate_fn_map: object = None) -> Tensors:
    """Make a batch of windows, as torch's `default_collate` does with this function; of use in an own `collate_fn`.

    Args:
        items: The windows, all of one dataset.
        collate_fn_map: Given by torch; not used.

    Raises:
        CorruptEpisode: An episode is damaged.
    """
    return items[0].dataset.batch([item.index for item in items])


def _as_tensors(torch: Any, read: WindowBatch, images: dict[str, Any]) -> Tensors:
    return {
        "state": torch.from_numpy(read["state"].astype(np.float32)),
        "images": {name: _channels_first(tensor) for name, tensor in images.items()},
        "actions": torch.from_numpy(read["actions"].astype(np.float32)),
        "is_pad": torch.from_numpy(read["is_pad"]),
        "is_history_pad": torch.from_numpy(read["is_history_pad"]),
        "instruction": read["instruction"],
        "episode": read["episode"],
        "step": torch.from_numpy(read["step"]),
    }


def _channels_first(images: Any) -> Any:
    # Depth images are (batch, history, H, W); colour images end with the channels.
    return images.unsqueeze(2) if images.dim() == 4 else images.permute(0, 1, 4, 2, 3)


_torch = functools.partial(package_of, "torch", "torch", "Tensors need torch")
