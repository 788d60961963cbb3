"""Servers that are started for an evaluation; `tests/cli/test_sweep.py` has whole ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from rcs.rollout.serving import ServerProcess


def test_servers_at_a_time_have_a_port_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("rcs.rollout.serving._free_ports", lambda: iter(("1021", "1022")))  # as before any listens
    words = ["sleep", "60"]
    one = ServerProcess(words, tmp_path / "one.log")
    other = ServerProcess(words, tmp_path / "other.log")
    one.end()
    again = ServerProcess(words, tmp_path / "again.log")
    other.end()
    again.end()
    ports = [server.address.rpartition(":")[2] for server in (one, other, again)]
    assert ports == ["1021", "1022", "1021"], "a server that has ended gives it back"
