"""`rcs collect --ray` starts a cluster of its own, and leaves nothing behind however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset, check

import rcs
from rcs.agents import Agent
from rcs.envs.env import Env
from rcs.rollout.collect import Collection, Progress, collect

pytestmark = pytest.mark.cluster

# A loaded machine takes its time to start processes.
_PATIENCE = 240.0

Processes = Callable[[str], list[str]]
FOLDER = "RCS_TEST_FOLDER"
"""Environment variable: a folder of the test, in which the agent tells that it is at work."""


class Stuck(Agent):
    """An agent that never comes to an end."""

    def __init__(self, env: Env) -> None:
        self._folder = Path(os.environ[FOLDER])

    def reset(self, observation: Any, info: Any) -> None:
        pass

    def act(self, observation: Any, info: Any) -> Any:
        (self._folder / "waiting").touch()
        time.sleep(600)


def collecting(out: Path, mark: str, episodes: int, agent: str | None = None) -> subprocess.Popen[str]:
    """Start `rcs collect --ray` on a cluster of its own, in a process group of its own as in a terminal."""
    program = "from rcs.cli.main import main; main()"
    words = f"collect PickCuboid --cameras none --episodes {episodes} --seed 7 --ray --workers 2 --no-report".split()
    words += [] if agent is None else ["--agent", agent]
    plain = {key: value for key, value in os.environ.items() if not key.startswith(("RAY_", "TMPDIR"))}
    return subprocess.Popen(
        [sys.executable, "-c", program, *words, "--out", str(out)],
        env={**plain, "RCS_TEST_MARK": mark, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def leftovers() -> set[str]:
    return {path.name for path in Path("/tmp").glob(".rcs-*")}


def test_the_command_starts_a_cluster_of_its_own_that_ends_with_it(
    tmp_path: Path, wait_for: Callable[..., None], processes_with: Processes
) -> None:
    mark, before = uuid.uuid4().hex, leftovers()
    with collecting(tmp_path / "ray", mark, 2) as process:
        text, _ = process.communicate(timeout=_PATIENCE)
    assert process.returncode == 0, text
    assert "2 on 1 machine" in text
    wait_for(lambda: not processes_with(mark), "all processes of the cluster have ended", 120)
    assert leftovers() <= before
    for _ in collect(Collection(setup=rcs.Setup(), out=tmp_path / "alone", episodes=2, seed=7), Progress()):
        pass
    # The command leaves cameras out, too.
    hashes = [[each.content_hash for each in Dataset.open(tmp_path / name).episodes] for name in ("ray", "alone")]
    assert hashes[0] == hashes[1]


def test_ctrl_c_ends_after_the_running_episodes(
    tmp_path: Path, wait_for: Callable[..., None], processes_with: Processes
) -> None:
    mark, before, out = uuid.uuid4().hex, leftovers(), tmp_path / "stopped"
    with collecting(out, mark, 1000) as process:
        wait_for(lambda: (out / "episodes/000000").exists() or process.poll() is not None, "an episode has arrived")
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to workers too
        text, _ = process.communicate(timeout=_PATIENCE)
    assert process.returncode == 130, text
    assert "Ending after the episodes at work" in text and "2 on 1 machine" in text
    wait_for(lambda: not processes_with(mark), "all processes of the cluster have ended", 120)
    assert leftovers() <= before
    assert check(out).is_ok
    ids = [episode.id for episode in Dataset.open(out).episodes]
    assert 1 <= len(ids) < 1000 and ids == [f"{number:06d}" for number in range(len(ids))]


def test_the_second_ctrl_c_ends_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wait_for: Callable[..., None], processes_with: Processes
) -> None:
    mark, before, out = uuid.uuid4().hex, leftovers(), tmp_path / "stopped"
    monkeypatch.setenv(FOLDER, str(tmp_path))
    with collecting(out, mark, 1000, f"{__name__}:Stuck") as process:
        wait_for(lambda: (tmp_path / "waiting").exists() or process.poll() is not None, "an episode is under way")
        os.killpg(process.pid, signal.SIGINT)
        assert process.stdout is not None
        said = ""
        while "Ending after the episodes at work" not in said:
            line = process.stdout.readline()
            assert line, said
            said += line
        os.killpg(process.pid, signal.SIGINT)
        text, _ = process.communicate(timeout=_PATIENCE)
    assert process.returncode == 130 and "Traceback" not in text, text
    wait_for(lambda: not processes_with(mark), "all processes of the cluster have ended", 120)
    assert leftovers() <= before
    assert check(out).is_ok and not Dataset.open(out).episodes


def test_a_cluster_whose_command_is_killed_ends_and_is_cleared_away_by_the_next(
    tmp_path: Path, wait_for: Callable[..., None], processes_with: Processes
) -> None:
    mark, before, out = uuid.uuid4().hex, leftovers(), tmp_path / "killed"
    with collecting(out, mark, 1000) as process:
        wait_for(lambda: (out / "episodes/000000").exists() or process.poll() is not None, "an episode has arrived")
        process.kill()
    wait_for(lambda: not processes_with(mark), "all processes of the cluster have ended", 120)
    assert leftovers() > before
    with collecting(out, mark, len(Dataset.open(out).episodes) + 1) as process:
        text, _ = process.communicate(timeout=_PATIENCE)
    assert process.returncode == 0, text
    assert leftovers() <= before
    wait_for(lambda: not processes_with(mark), "all processes of the cluster have ended", 120)
