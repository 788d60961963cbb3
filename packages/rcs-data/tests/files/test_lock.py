"""Two writers never share a dataset, and a dead one does not keep it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rcs_data.errors import DatasetError
from rcs_data.files.lock import DatasetLock, is_locked

HOLD = """
import sys, time
from pathlib import Path
from rcs_data.files.lock import DatasetLock
lock = DatasetLock.writer(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


def test_the_second_writer_is_refused_and_told_by_whom(tmp_path: Path) -> None:
    first = DatasetLock.writer(tmp_path)
    with pytest.raises(DatasetError, match=f"process {os.getpid()}, has .* open"):
        DatasetLock.writer(tmp_path)
    first.release()
    first.release()
    DatasetLock.writer(tmp_path).release()


def test_the_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(DatasetError, match=f"process {other.pid}, has"):
            DatasetLock.writer(tmp_path)
        other.send_signal(signal.SIGKILL)
        other.wait()
        DatasetLock.writer(tmp_path).release()


def test_a_forked_child_does_not_keep_the_lock_of_its_parent(tmp_path: Path) -> None:
    lock = DatasetLock.writer(tmp_path)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(writing)
        os.read(reading, 1)  # until the parent is done
        os._exit(0)
    os.close(reading)
    try:
        assert is_locked(tmp_path), "a fork must not free the lock either"
        lock.release()
        DatasetLock.writer(tmp_path).release()
    finally:
        os.close(writing)
        os.waitpid(child, 0)


def test_workers_need_a_writer_and_keep_the_next_one_waiting(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="No writer"):
        DatasetLock.worker(tmp_path)
    writer = DatasetLock.writer(tmp_path)
    workers = [DatasetLock.worker(tmp_path) for _ in range(2)]
    writer.release()
    with pytest.raises(DatasetError, match="Worker processes of an earlier collection"):
        DatasetLock.writer(tmp_path)
    for worker in workers:
        worker.release()
    DatasetLock.writer(tmp_path).release()


def test_asking_whether_it_is_locked_changes_nothing(tmp_path: Path) -> None:
    assert not is_locked(tmp_path)
    lock = DatasetLock.writer(tmp_path)
    assert is_locked(tmp_path)
    assert is_locked(tmp_path)
    lock.release()
    assert not is_locked(tmp_path)
