"""What all tests share: programs in a process of their own, and `gl` tests skipped where nothing can draw."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable

import pytest


@functools.cache
def why_nothing_draws() -> str:
    """Return why no OpenGL backend works; empty when one does."""
    from rcs._core import probe_gl

    probes = probe_gl()
    return "" if any(probe.ok for probe in probes) else "; ".join(f"{probe.name}: {probe.detail}" for probe in probes)


def pytest_configure(config: pytest.Config) -> None:
    """Take Ctrl-C as usual: under `nohup make test &` it is ignored, and the programs that tests start inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test that draws where nothing can."""
    if item.get_closest_marker("gl") and (reason := why_nothing_draws()):
        pytest.skip(reason)


@pytest.fixture
def run_program() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run a program, given as text, in a process of its own: for what could end or hang it."""

    def run(program: str, *arguments: str, timeout: float = 30.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", textwrap.dedent(program), *arguments],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    return run
