from __future__ import annotations

import zlib
from pathlib import Path

import pytest
from rcs_data.errors import CorruptEpisode
from rcs_data.index.entry import entry_of


def test_a_line_that_lacks_a_field_is_refused_though_its_checksum_matches() -> None:
    text = b'{"id":"a","folder":"a"'
    with pytest.raises(CorruptEpisode, match=r"damaged in line 3: .*length"):
        entry_of(b'%b,"checksum":"%08x"}' % (text, zlib.crc32(text)), Path("episodes.jsonl"), 3)
