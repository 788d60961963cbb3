from __future__ import annotations

import numpy as np
import pytest
from rcs_data.convert.crc32c import crc32c


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        # RFC 3720, appendix B.4; the check value of the CRC catalogue; and nothing.
        (bytes(32), 0x8A9136AA),
        (b"\xff" * 32, 0x62A8AB43),
        (bytes(range(32)), 0x46DD794E),
        (bytes(range(31, -1, -1)), 0x113FDB5C),
        (
            bytes.fromhex("01c00000 00000000 00000000 00000000 14000000 00000400 00000014 00000018 28000000") + bytes(4)
            + bytes.fromhex("02000000") + bytes(4),
            0xD9963A56,
        ),
        (b"123456789", 0xE3069283),
        (b"", 0),
    ],
)  # fmt: skip
def test_known_data_has_the_known_checksum(data: bytes, crc: int) -> None:
    assert crc32c(data) == crc


@pytest.mark.parametrize("length", [1, 3, 4, 8191, 8192, 8193, 8194, 8195, 12289, 50_001])
def test_many_stripes_have_the_checksum_of_one_bit_after_the_other(length: int) -> None:
    data = np.random.default_rng(length).bytes(length)
    assert crc32c(data) == _bit_by_bit(data)


@pytest.mark.parametrize("length", [100, 20_000])
def test_every_changed_byte_changes_the_checksum(length: int) -> None:
    rng = np.random.default_rng(0)
    data = bytearray(rng.bytes(length))
    before = crc32c(bytes(data))
    for place in rng.integers(0, length, 20):
        data[place] ^= 1
        assert crc32c(bytes(data)) != before
        data[place] ^= 1
    assert crc32c(bytes(data)) == before


def test_zeros_in_front_change_the_checksum_however_many() -> None:
    assert len({crc32c(bytes(n) + b"a" * 9000) for n in range(10)}) == 10


def _bit_by_bit(data: bytes) -> int:
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0x82F63B78 if register & 1 else 0)
    return register ^ 0xFFFFFFFF
