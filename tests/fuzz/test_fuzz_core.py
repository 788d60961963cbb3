"""A short run of the fuzzer; `python tests/fuzz/fuzz_core.py --calls 300000` is a long one."""

from __future__ import annotations

import pytest

from tests.fuzz.fuzz_core import CALLS_PER_ROUND, PLANTED, fuzz
from tests.fuzz.targets import targets_of_core

RARE = ("Render", "probe_gl")
"""Targets that take milliseconds, and are called only in long runs."""


def test_no_call_ends_the_process_or_hangs_or_raises_what_nobody_named() -> None:
    result = fuzz(12000, seed=1)
    assert result["findings"] == []
    missing = {t.name for t in targets_of_core() if not t.name.startswith(RARE)} - set(result["seen"])
    assert not missing, "some functions of the core were not called"


@pytest.mark.parametrize(("planted", "kind"), [("end", "end with -6"), ("hang", "hang"), ("error", "RuntimeError")])
def test_the_fuzzer_finds_what_it_looks_for(planted: str, kind: str) -> None:
    assert planted in PLANTED
    result = fuzz(1, seed=1, timeout=2.0, planted=planted)
    assert result["findings"][0]["kind"] == kind
    assert f"planted_{planted}" in result["findings"][0]["call"]
    assert 0 <= result["findings"][0]["round"] * CALLS_PER_ROUND < CALLS_PER_ROUND
