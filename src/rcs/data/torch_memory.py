"""Memory that images of a batch are put into, over and over: in this process, or shared by a worker of a loader.

Each page of new memory has to be found and cleared. For an image of 224 x 224 pixels that took 25 µs on a virtual
machine, and 85 µs in shared memory, beside 170 µs for decoding it. So memory is written to again when the last tensor
in it is gone, and what a worker handed over when its receiver has let go of it. A tensor that leaves a worker in any
other way, such as a part or a copy, is sent as torch sends all, and its memory is not used again.
"""

from __future__ import annotations

import functools
import importlib
import math
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Behind the values, and in a cache line of their own. The last one says whether somebody has the memory.
_FLAG_BYTES = 64
_FREE, _TAKEN = 0, 1
# Two for each of four cameras: the batch that is being used, and the one that is being read.
_MOST_SPARE = 8

_spare: list[OwnBlock] = []
"""Memory of this process that nobody has now."""
_handed_over: list[Any] = []
"""Shared memory of this process that another one has or had, as tensors of bytes."""


class OwnBlock:
    """A piece of memory of this process, for one tensor at a time."""

    def __init__(self, size: int) -> None:
        """Take new memory.

        Args:
            size: Bytes.
        """
        self.memory = np.empty(size, np.uint8)


def reused_tensor(shape: Sequence[int], dtype: np.dtype[Any]) -> Any:
    """Return a tensor with nothing in it, in memory of this process that is free again or new.

    Args:
        shape: Its shape.
        dtype: Its dtype.
    """
    size = math.prod(shape) * dtype.itemsize
    block = _take_spare(size) or OwnBlock(size)
    values = block.memory[:size].view(dtype).reshape(shape)
    # torch holds just this array as long as there is a tensor on it, views included; and what numpy makes of a tensor
    # holds that. The array itself must go to nobody else: numpy's views of it would hold the memory, and not it.
    weakref.finalize(values, _put_spare, block).atexit = False
    return importlib.import_module("torch").from_numpy(values)


def _take_spare(size: int) -> OwnBlock | None:
    for block in reversed(list(_spare)):
        if block.memory.nbytes >= size:
            try:
                _spare.remove(block)
            except ValueError:  # another thread was faster
                continue
            return block
    return None


def _put_spare(block: OwnBlock) -> None:
    _spare.append(block)
    del _spare[:-_MOST_SPARE]


class SharedBlock:
    """A piece of shared memory, for one array of a worker."""

    def __init__(self, shape: Sequence[int], dtype: np.dtype[Any]) -> None:
        """Take memory that is free again, or new.

        Args:
            shape: The shape of the array.
            dtype: Its dtype.
        """
        size = math.prod(shape) * dtype.itemsize
        self._bytes = _free_again(size + _FLAG_BYTES)
        if self._bytes is None:
            self._bytes = _new_shared(size + _FLAG_BYTES)
        memory = self._bytes.numpy()
        memory[-1] = _TAKEN
        self.array: NDArray[Any] = memory[:size].view(dtype).reshape(shape)

    def lend(self, tensor: Any) -> Any:
        """Return a tensor as one that gives the block back when the process it is sent to no longer has it.

        Args:
            tensor: All of the array, its axes in any order.
        """
        lent = tensor.as_subclass(_lent_class())
        lent.block = self._bytes
        return lent


def _free_again(size: int) -> Any:
    # Only this thread takes blocks out of the list; the one that sends them only adds to its end.
    for n, block in enumerate(_handed_over):
        if block.numel() >= size and block[-1].item() == _FREE:
            return _handed_over.pop(n)
    return None


def _new_shared(size: int) -> Any:
    torch: Any = importlib.import_module("torch")
    # As torch's own `default_collate` does.
    return torch.empty(0, dtype=torch.uint8).set_(torch.UntypedStorage._new_shared(size), 0, (size,), (1,))


@functools.cache
def _lent_class() -> Any:
    torch: Any = importlib.import_module("torch")

    def reduce(self: Any, _: int) -> tuple[Any, ...]:
        block, self.block = self.block, None
        if block is None:  # somebody else has it already
            return _unchanged, (self.as_subclass(torch.Tensor).clone(),)
        _handed_over.append(block)
        return _received, (block, self.dtype, tuple(self.shape), tuple(self.stride()))

    # Whatever is computed from such a tensor is a plain one.
    plain = torch._C._disabled_torch_function_impl
    return type("LentTensor", (torch.Tensor,), {"__reduce_ex__": reduce, "__torch_function__": plain})


def _unchanged(tensor: Any) -> Any:
    return tensor


def _received(block: Any, dtype: Any, shape: tuple[int, ...], strides: tuple[int, ...]) -> Any:
    torch: Any = importlib.import_module("torch")
    memory = block.numpy()
    values = memory[: math.prod(shape) * dtype.itemsize]
    # As above: `values` is gone when the last tensor on it is.
    weakref.finalize(values, _give_back, memory).atexit = False
    return torch.from_numpy(values).view(dtype).as_strided(shape, strides)


def _give_back(memory: NDArray[np.uint8]) -> None:
    memory[-1] = _FREE
