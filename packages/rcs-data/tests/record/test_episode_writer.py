"""An episode is finished, discarded or aborted, once; and a failing disk spoils no other."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, check, recover
from rcs_data.errors import DatasetError, InvalidSetup

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

STATE = 5  # the sim_state_size of make_info


def test_what_was_added_is_read(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record) -> None:
    rows = make_rows(70, images=True)
    with DatasetWriter.open(tmp_path, make_info(images=True)) as writer:
        record(writer, "a", length=70)
    (episode,) = Dataset.open(tmp_path).episodes
    for key in ("observation/joints", "observation/gripper", "observation/frames/wrist/depth", "time/monotonic"):
        np.testing.assert_array_equal(episode.column(key), np.stack([np.asarray(row[key]) for row in rows]))
    np.testing.assert_array_equal(episode.column("action/joints")[1:], [row["action/joints"] for row in rows[1:]])
    assert np.isnan(episode.column("action/joints")[0]).all()
    assert episode.column("action/index").dtype == np.int32
    np.testing.assert_array_equal(episode.column("action/index")[[0, 1, 69]], [[0, 0], [1, -1], [69, -69]])
    np.testing.assert_array_equal(episode.sim_state(), np.tile(np.arange(70.0)[:, None], STATE))
    colours = episode.column("observation/frames/wrist/rgb")
    assert colours.shape == (70, 16, 24, 3)
    wanted = np.stack([row["observation/frames/wrist/rgb"] for row in rows])
    assert np.abs(colours.astype(int) - wanted).max() <= 2
    assert (episode.seed, episode.success, episode.length, episode.outcome) == (0, True, 70, {"failure": None})


def test_an_episode_of_one_row_is_whole(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    with DatasetWriter.open(tmp_path, make_info(images=True)) as writer:
        assert record(writer, "a", length=1).length == 1
    assert Dataset.open(tmp_path)["a"].column("action/joints").shape == (1, 3)
    assert check(tmp_path).is_ok


def test_an_episode_without_rows_cannot_be_finished(tmp_path: Path, make_info: MakeInfo) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        with writer.episode("a", seed=0) as episode, pytest.raises(InvalidSetup, match="no rows"):
            episode.finish(True)
        assert episode.state == "discarded"
    assert not list((tmp_path / "episodes").iterdir())


def test_without_a_simulation_there_is_no_state(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    with DatasetWriter.open(tmp_path, make_info(sim_state_size=None)) as writer:
        episode = record(writer, "a")
    assert sorted(path.name for path in episode.path.iterdir()) == ["episode.json", "steps.parquet"]
    with pytest.raises(InvalidSetup, match="without"):
        episode.sim_state()
    assert check(tmp_path).is_ok


def test_a_discarded_take_leaves_nothing(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        for row in make_rows(5):
            episode.add({**row, "observation/joints": np.full(3, 99.0)}, np.zeros(STATE))
        episode.discard()
        episode.discard()
        with writer.episode("a", seed=1) as episode:
            for row in make_rows(2):
                episode.add(row, np.zeros(STATE))
            episode.finish(True)
    (found,) = Dataset.open(tmp_path).episodes
    assert (found.length, found.seed) == (2, 1)
    assert 99.0 not in found.column("observation/joints")
    assert [path.name for path in (tmp_path / "episodes").iterdir()] == ["a"]


@pytest.mark.parametrize("end", ["finish", "discard", "abort"])
def test_nothing_is_added_after_the_end(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, end: str) -> None:
    ends: dict[str, Callable[[Any], object]] = {
        "finish": lambda episode: episode.finish(True),
        "discard": lambda episode: episode.discard(),
        "abort": lambda episode: episode.abort("enough"),
    }
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        episode.add(make_rows(1)[0], np.zeros(STATE))
        ends[end](episode)
        with pytest.raises(DatasetError, match=r"is (finished|discarded|aborted)"):
            episode.add(make_rows(2)[1], np.zeros(STATE))
        with pytest.raises(DatasetError, match="Cannot finish"):
            episode.finish(True)


def test_an_outcome_holds_numpy_values_but_no_nan(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer, writer.episode("a", seed=np.int64(7)) as episode:
        episode.add(make_rows(1)[0], np.zeros(STATE))
        with pytest.raises(InvalidSetup, match="JSON"):
            episode.finish(True, {"lift": math.nan})
        with pytest.raises(InvalidSetup, match="success is 'yes'"):
            episode.finish("yes")  # pyright: ignore[reportArgumentType]
        found = episode.finish(np.True_, {"lift": np.float32(0.5), "pose": np.zeros(2)})  # pyright: ignore[reportArgumentType]
    assert (found.success, found.seed, found.outcome) == (True, 7, {"lift": 0.5, "pose": [0.0, 0.0]})


@pytest.mark.parametrize("left", [-9, 0])
def test_an_episode_that_does_not_read_back_whole_gets_no_verdict(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, left: int
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        for row in make_rows(31):  # after which nothing waits to be written
            episode.add(row, np.zeros(STATE))
        stream = tmp_path / "open/a/rows.arrows"
        data = stream.read_bytes()[:left]
        stream.write_bytes(data)
        with pytest.raises(DatasetError, match=r"Only \d+ of 31 rows of episode 'a' can be read again"):
            episode.finish(True)
        assert episode.state == "aborted"
        assert stream.read_bytes() == data
    assert len(Dataset.open(tmp_path)) == 0


@pytest.mark.parametrize("name", ["", ".hidden", "a/b", "a\0b", "a\n", "ä" * 101])
def test_an_id_that_is_no_name_is_refused(tmp_path: Path, make_info: MakeInfo, name: str) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer, pytest.raises(InvalidSetup, match="cannot name"):
        writer.episode(name, seed=0)


@pytest.mark.parametrize("call", ["write", "fsync", "open"])
def test_a_disk_that_fails_at_any_call_aborts_one_episode_and_spoils_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make_info: MakeInfo, record: Record, call: str
) -> None:
    real = getattr(os, call)
    for n in range(100):
        path = tmp_path / str(n)
        with DatasetWriter.open(path, make_info(images=True)) as writer:
            before = record(writer, "before", length=3)
            calls = 0

            def failing(*args: Any, **kwargs: Any) -> Any:
                nonlocal calls
                calls += 1
                if calls > n:  # noqa: B023
                    raise OSError(28, "No space left on device")
                return real(*args, **kwargs)

            with monkeypatch.context() as patched:
                patched.setattr(os, call, failing)
                try:
                    record(writer, "during", length=70)
                except DatasetError as err:
                    assert "No space left on device. Free some space" in str(err)  # noqa: PT017
                    assert str(path) in str(err)  # noqa: PT017
                else:
                    break
            assert Dataset.open(path).episodes[0].content_hash == before.content_hash
        report = recover(path)
        episodes = {episode.id: episode for episode in Dataset.open(path).episodes}
        assert check(path).is_ok, (n, check(path))
        if "during" in episodes:
            # Without any of the three, only the last sync failed, and the episode had its final name.
            assert report.recovered == ("during",) or report.published == ("during",) or episodes["during"].success
            assert episodes["during"].length == 70 or episodes["during"].success is None
        assert episodes["before"].content_hash == before.content_hash
    assert n >= (3 if call == "fsync" else 2), "the disk must have failed at several calls"


def test_a_read_only_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make_info: MakeInfo) -> None:
    # Root writes to read-only folders, so the system's answer is put in its place.
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(30, "Read-only file system")

    with DatasetWriter.open(tmp_path, make_info()) as writer, monkeypatch.context() as patched:
        patched.setattr(os, "mkdir", refuse)
        with pytest.raises(
            DatasetError, match=r"start episode 'a' in .*: Read-only file system.*choose another folder"
        ):
            writer.episode("a", seed=0)


@pytest.mark.parametrize("call", range(12))
def test_ctrl_c_while_an_episode_is_completed_leaves_it_whole(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        for row in make_rows(20):
            episode.add(row, np.zeros(STATE))
        left = call
        real = os.fsync

        def interrupt(fd: int) -> None:
            nonlocal left
            left -= 1
            if left == -1:
                raise KeyboardInterrupt
            real(fd)

        monkeypatch.setattr(os, "fsync", interrupt)
        try:
            episode.finish(True)
        except KeyboardInterrupt:
            assert episode.state in ("aborted", "finished")
        monkeypatch.undo()
    recover(tmp_path)
    (kept,) = Dataset.open(tmp_path).episodes
    assert kept.length == 20
    assert kept.outcome.get("aborted", "KeyboardInterrupt") == "KeyboardInterrupt", "an error without words has a name"
    assert check(tmp_path).is_ok
