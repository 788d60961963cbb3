"""Where a value of msgpack ends, found without reading it: that of a picture is not copied then."""

from __future__ import annotations

MOST = 4096
"""Values inside of one that are looked at; what has more is not worth it."""
FIXED = {0xC0: 1, 0xC2: 1, 0xC3: 1, 0xCA: 5, 0xCB: 9, 0xCC: 2, 0xCD: 3, 0xCE: 5, 0xCF: 9, 0xD0: 2, 0xD1: 3, 0xD2: 5} | {
    0xD3: 9
}
"""Bytes of values whose first byte says how long they are: nil, booleans, numbers."""
COUNTED = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}
"""Bytes that say how many bytes follow: bin and str."""
NESTED = {0xDC: (2, 1), 0xDD: (4, 1), 0xDE: (2, 2), 0xDF: (4, 2)}
"""Bytes that say how many values follow, and how many each counts for: arrays and maps."""


def end_of(data: memoryview, start: int) -> int | None:
    """Return where the value ends that begins at `start`; None if it is damaged, has extensions or too many parts."""
    at, left, size = start, 1, len(data)
    for _ in range(MOST):
        if at >= size:
            return None
        kind = data[at]
        left -= 1
        if kind <= 0x7F or kind >= 0xE0:
            at += 1
        elif kind <= 0x8F:
            at, left = at + 1, left + 2 * (kind & 15)
        elif kind <= 0x9F:
            at, left = at + 1, left + (kind & 15)
        elif kind <= 0xBF:
            at += 1 + (kind & 31)
        elif kind in FIXED:
            at += FIXED[kind]
        elif kind in COUNTED:
            behind = at + 1 + COUNTED[kind]
            at = behind + int.from_bytes(data[at + 1 : behind], "big")
        elif kind in NESTED:
            width, each = NESTED[kind]
            left += each * int.from_bytes(data[at + 1 : at + 1 + width], "big")
            at += 1 + width
        else:
            return None
        if left == 0:
            return at if at <= size else None
    return None
