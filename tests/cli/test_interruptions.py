"""Ctrl-C, full disks and readers that go away: how commands end early."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rcs_data import Dataset

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]


def start(out: Path, *arguments: str, limit: int | None = None) -> subprocess.Popen[str]:
    def set_limit() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    command = [*RCS, "collect", "PickCuboid", "--cameras", "none", "--out", str(out), *arguments]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=set_limit,
    )


def wait_for_episodes(out: Path, count: int) -> None:
    deadline = time.monotonic() + 30
    while len(list((out / "episodes").glob("0*/episode.json"))) < count:
        assert time.monotonic() < deadline, "no episodes within 30 s"
        time.sleep(0.02)


def test_a_disk_without_room_ends_the_collection_with_a_clear_error(tmp_path: Path) -> None:
    # A limit on the size of files stands in for a full disk: writes fail the same way.
    process = start(tmp_path / "out", "--episodes", "2", "--workers", "1", limit=20_000)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "DatasetError" in told
    assert "Traceback" not in told


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_finishes_cleanly_and_the_same_command_goes_on(tmp_path: Path, workers: str) -> None:
    out = tmp_path / "out"
    process = start(out, "--episodes", "500", "--workers", workers)
    wait_for_episodes(out, 2)
    os.killpg(process.pid, signal.SIGINT)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    kept = len(Dataset.open(out))
    assert 2 <= kept < 500
    assert not list((out / "episodes").glob(".*")), "nothing is left open"
    assert (out / "report.html").exists()
    again = start(out, "--episodes", str(kept + 1), "--workers", "1")
    told, _ = again.communicate(timeout=60)
    assert again.returncode == 0, told
    assert len(Dataset.open(out)) == kept + 1


def is_worker(pid: str) -> bool:
    """Return whether a process is a worker; one that has ended since it was listed is none."""
    try:
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return False


def workers_of(pid: int) -> list[int]:
    """Return the worker processes of a process, from when they are started on."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if is_worker(child)]


@pytest.mark.skipif(sys.platform != "linux", reason="workers are found in /proc")
@pytest.mark.slow
@pytest.mark.parametrize(("verb", "after"), [("collect", 0.0), ("eval", 0.3)])
def test_ctrl_c_while_workers_start_ends_as_at_any_other_time(tmp_path: Path, verb: str, after: float) -> None:
    options = ["--cameras", "none", "--episodes", "500", "--workers", "2", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        [*RCS, verb, "PickCuboid", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while not workers_of(process.pid) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    time.sleep(after)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to workers too
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Ending after the running episodes" in told
    assert "Traceback" not in told


def test_ctrl_c_while_a_command_is_imported_ends_without_a_word(tmp_path: Path) -> None:
    # Extensions that are interrupted while they start raise an ImportError.
    (tmp_path / "slow_verb.py").write_text(
        "import time\n"
        "print('importing', flush=True)\n"
        "try:\n    time.sleep(60.0)\nexcept KeyboardInterrupt as err:\n    raise ImportError('failed') from err\n"
    )
    program = "from rcs_data.cli.program import Program; Program('rcs', {'slow': 'slow_verb:Slow'}, '1').main(['slow'])"
    process = subprocess.Popen(
        [sys.executable, "-c", program], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    told, complaint = process.communicate(timeout=60)
    assert (process.returncode, told, complaint) == (130, "", "")


@pytest.mark.parametrize("words", [["--help"], ["collect", "--help"], ["--version"], ["list"]])
def test_a_reader_that_goes_away_ends_the_command_quietly(words: list[str]) -> None:
    command = [*RCS, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1
