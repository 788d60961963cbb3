"""CRC-32C, the checksum of TFRecord files, computed over many stripes of the data at once.

CRC-32C (Castagnoli) is defined in RFC 3720, appendix B.4. Over the field of two elements, the register is linear in its
start and the message. So stripes of equal length are processed side by side, each from zero, and then joined: the
register after two stripes is that of the first, advanced by as many zero bytes as the second has, plus that of the
second.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x82F63B78  # 0x1EDC6F41 with its bits reversed
_ALL_ONES = 0xFFFFFFFF
_WORD = 4

# Below this size [B], going byte by byte is as fast.
_SHORT = 8192

# A linear map of a register: column i is where bit i goes.
_Map = NDArray[np.uint32]


def crc32c(data: bytes) -> int:
    """Return the CRC-32C of the bytes."""
    if len(data) < _SHORT:
        register = _ALL_ONES
        table = _byte_table()
        for byte in data:
            register = (register >> 8) ^ table[(register ^ byte) & 0xFF]
        return register ^ _ALL_ONES
    words = -(-len(data) // _WORD)
    # As many stripes as words in each, which balances the cost per stripe and per word.
    stripes = 1 << (words.bit_length() + 2) // 2
    length = -(-words // stripes)
    # Leading zeros change nothing, since the register starts at zero.
    padded = np.zeros(stripes * length * _WORD, np.uint8)
    start = len(padded) - len(data)
    padded[start:] = np.frombuffer(data, np.uint8)
    padded[start : start + _WORD] ^= 0xFF  # instead of a register of ones
    registers = np.zeros(stripes, np.uint32)
    low, high = _word_tables()
    for column in np.ascontiguousarray(padded.view("<u4").reshape(stripes, length).T):
        registers ^= column
        registers = low[registers & 0xFFFF] ^ high[registers >> 16]
    over = _over_words(length)
    while len(registers) > 1:
        registers = _apply(over, registers[0::2]) ^ registers[1::2]
        over = _apply(over, over)
    return int(registers[0]) ^ _ALL_ONES


def _apply(linear: _Map, registers: NDArray[np.uint32]) -> NDArray[np.uint32]:
    result = np.zeros_like(registers)
    for bit, image in enumerate(linear):
        result ^= ((registers >> bit) & 1) * image
    return result


def _over_words(count: int) -> _Map:
    """Return the linear map that a number of zero words applies to a register."""
    total, power = np.array([1 << bit for bit in range(32)], np.uint32), _over_one_word()
    while count:
        if count & 1:
            total = _apply(power, total)
        power = _apply(power, power)
        count >>= 1
    return total


@lru_cache(maxsize=1)
def _byte_table() -> list[int]:
    table: list[int] = []
    for byte in range(256):
        register = byte
        for _ in range(8):
            register = (register >> 1) ^ (_POLYNOMIAL if register & 1 else 0)
        table.append(register)
    return table


@lru_cache(maxsize=1)
def _over_one_word() -> _Map:
    table = np.array(_byte_table(), np.uint32)
    registers = np.array([1 << bit for bit in range(32)], np.uint32)
    for _ in range(_WORD):
        registers = (registers >> np.uint32(8)) ^ table[registers & 0xFF]
    return registers


@lru_cache(maxsize=1)
def _word_tables() -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the images of all lower and upper halves of a register under a word of zeros."""
    halves = np.arange(1 << 16, dtype=np.uint32)
    return _apply(_over_one_word(), halves), _apply(_over_one_word(), halves << np.uint32(16))
