"""A dataset is made, resumed and shared, and what does not belong in it is refused."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, check, edit, recover
from rcs_data.convert.formats import import_format
from rcs_data.errors import DatasetError

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

STATE = 5  # the sim_state_size of make_info

WORKER = """
import sys
import numpy as np
from rcs_data import DatasetWriter
path, name, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
with DatasetWriter.join(path) as writer:
    for i in range(count):
        with writer.episode(f"{name}-{i}", seed=i) as episode:
            for step in range(3):
                joints = np.full(3, float(i))
                row = {"observation/joints": joints, "observation/gripper": np.zeros(1, np.float32)}
                row |= {"terminated": False, "time/monotonic": None, "time/frames/wrist": None}
                if step:
                    row |= {"action/joints": joints, "action/index": np.zeros(2, np.int32), "reward": 0.0}
                episode.add(row, np.zeros(5))
            episode.finish(None)
"""

DYING_WORKER = """
import os, sys
from rcs_data import DatasetWriter
DatasetWriter.join(sys.argv[1]).episode("a", seed=0)
os._exit(0)
"""


LOADING = (
    WORKER.replace("    for i in range(count):", "    before = set(sys.modules)\n    for i in range(count):")
    + """
print(*(set(sys.modules) - before))
"""
)


def test_no_package_is_loaded_in_mid_episode(tmp_path: Path, make_info: MakeInfo) -> None:
    pytest.importorskip("pandas", reason="pyarrow loads it where it is installed")
    with DatasetWriter.open(tmp_path, make_info()):
        words = [sys.executable, "-c", LOADING, str(tmp_path), "a", "1"]
        loaded = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
    assert not [name for name in loaded if name.partition(".")[0] in ("pandas", "pyarrow")]


def test_a_resumed_dataset_keeps_what_it_had(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        record(writer, "a")
    with DatasetWriter.open(tmp_path, make_info(versions={"rcs": "9"}), resume=True) as writer:
        record(writer, "b")
    assert [episode.id for episode in Dataset.open(tmp_path).episodes] == ["a", "b"]
    assert check(tmp_path).is_ok


def test_another_setup_is_refused_and_the_differences_are_named(tmp_path: Path, make_info: MakeInfo) -> None:
    DatasetWriter.open(tmp_path, make_info()).close()
    with pytest.raises(
        DatasetError, match=r"setup.robot: .*'xarm7'.*\n.*frequency: the dataset has 30.0, this setup has 15.0"
    ):
        DatasetWriter.open(tmp_path, make_info(frequency=15.0, setup={"robot": "xarm7"}), resume=True)
    DatasetWriter.open(tmp_path, make_info(), resume=True).close()


def test_of_many_differences_the_first_are_named_and_the_rest_counted(tmp_path: Path, make_info: MakeInfo) -> None:
    DatasetWriter.open(tmp_path, make_info()).close()
    setup = {"task": "Push", "robot": "xarm7", **{f"option_{i:02d}": i for i in range(30)}}
    with pytest.raises(DatasetError) as told:
        DatasetWriter.open(tmp_path, make_info(setup=setup), resume=True)
    lines = str(told.value).splitlines()
    assert "setup.task" in lines[1]
    assert len(lines) == 12
    assert lines[-1].endswith(" more.")


def test_a_dataset_is_not_added_to_by_accident(tmp_path: Path, make_info: MakeInfo) -> None:
    DatasetWriter.open(tmp_path, make_info()).close()
    with pytest.raises(DatasetError, match="resume=True"):
        DatasetWriter.open(tmp_path, make_info())


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path, make_info: MakeInfo) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(DatasetError, match=r"has thesis\.tex"):
        DatasetWriter.open(tmp_path, make_info(), resume=True)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_second_writer_is_refused(tmp_path: Path, make_info: MakeInfo) -> None:
    with DatasetWriter.open(tmp_path, make_info()), pytest.raises(DatasetError, match="Another writer"):
        DatasetWriter.open(tmp_path, make_info(), resume=True)


@pytest.mark.parametrize("leftovers", ["recover", "discard"])
def test_leftovers_are_treated_as_told(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record, leftovers: str
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        record(writer, "a")
        episode = writer.episode("b", seed=0)
        episode.add(make_rows(1)[0], np.zeros(STATE))
    assert episode.state == "aborted", "closing the dataset ends its episodes"
    with DatasetWriter.open(tmp_path, make_info(), resume=True, leftovers=leftovers) as writer:
        done = writer.recovered
        if leftovers == "discard":
            record(writer, "b")
    assert (done.recovered, done.removed) == ((("b",), ()) if leftovers == "recover" else ((), ("b",)))
    outcomes = [episode.outcome.get("recovered", False) for episode in Dataset.open(tmp_path).episodes]
    assert outcomes == [False, leftovers == "recover"]


def test_workers_write_side_by_side(tmp_path: Path, make_info: MakeInfo) -> None:
    with DatasetWriter.open(tmp_path, make_info()):
        command = [sys.executable, "-c", WORKER, str(tmp_path)]
        workers = [subprocess.Popen([*command, name, "4"]) for name in ("left", "right")]
        assert [worker.wait(30) for worker in workers] == [0, 0]
    names = [episode.id for episode in Dataset.open(tmp_path).episodes]
    assert names == [f"{side}-{i}" for side in ("left", "right") for i in range(4)]
    assert check(tmp_path).is_ok


def test_episodes_that_are_open_together_are_what_they_would_be_one_after_the_other(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record
) -> None:
    with DatasetWriter.open(tmp_path / "together", make_info(images=True)) as writer:
        open_together = [writer.episode(f"{seed:06d}", seed=seed) for seed in range(24)]
        rows = [make_rows(40 + seed, images=True, seed=seed) for seed in range(24)]
        for i in range(64):
            for episode, taken in zip(open_together, rows, strict=True):
                if i < len(taken):
                    episode.add(taken[i], np.full(STATE, float(i)))
        together = [episode.finish(None).content_hash for episode in reversed(open_together)][::-1]
    with DatasetWriter.open(tmp_path / "one by one", make_info(images=True)) as writer:
        alone = [record(writer, f"{seed:06d}", length=40 + seed, seed=seed).content_hash for seed in range(24)]
    assert together == alone
    assert check(tmp_path / "together").is_ok


def test_an_open_episode_that_cannot_be_ended_keeps_no_other_from_its_end(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    writer = DatasetWriter.open(tmp_path, make_info())
    episodes = [writer.episode(f"{i}", seed=i) for i in range(5)]
    for episode in episodes:
        episode.add(make_rows(1)[0], np.zeros(STATE))

    def fail(_: str) -> None:
        raise DatasetError("no space left")

    episodes[2].end = fail
    with pytest.raises(DatasetError, match="no space left"):
        writer.close()
    assert [episode.state for episode in episodes] == ["aborted", "aborted", "open", "aborted", "aborted"]
    assert len(DatasetWriter.open(tmp_path, make_info(), resume=True).recovered.recovered) == 5, "the lock is free"


def test_a_removal_that_was_killed_is_finished_and_brings_nothing_back(dataset: Path, tmp_path: Path) -> None:
    program = Path(__file__).parents[1] / "edit/kill_every_edit.py"
    subprocess.run([sys.executable, program, dataset, tmp_path, "remove"], check=True, timeout=300)
    killed = sorted((path for path in tmp_path.iterdir() if path.name.isdigit()), key=lambda path: int(path.name))
    seen: list[list[str]] = []
    for path in killed:
        seen.append([episode.id for episode in Dataset.open(path)])
        recover(path)
        assert [episode.id for episode in Dataset.open(path)] == seen[-1], path.name
        assert not check(path).findings, path.name
        assert not list(path.glob(".trash/*"))
    assert seen == sorted(seen, key=len, reverse=True), "once it is removed, it stays removed"
    assert {len(ids) for ids in seen} == {2, 3}


def test_one_id_is_recorded_once(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer, DatasetWriter.join(tmp_path) as worker:
        episode = writer.episode("a", seed=0)
        with pytest.raises(DatasetError, match="already being recorded"):
            worker.episode("a", seed=0)
        episode.discard()
        record(worker, "a")
        with pytest.raises(DatasetError, match="There already is an episode 'a'"):
            writer.episode("a", seed=0)
    assert len(Dataset.open(tmp_path)) == 1


def test_the_id_of_a_worker_that_died_is_taken_until_the_dataset_is_resumed(
    tmp_path: Path, make_info: MakeInfo
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        subprocess.run([sys.executable, "-c", DYING_WORKER, str(tmp_path)], check=True, timeout=30)
        with pytest.raises(DatasetError, match="when its writer died"):
            writer.episode("a", seed=0)


def test_a_worker_alone_is_refused(tmp_path: Path, make_info: MakeInfo) -> None:
    DatasetWriter.open(tmp_path, make_info()).close()
    with pytest.raises(DatasetError, match=r"DatasetWriter\.open"):
        DatasetWriter.join(tmp_path)


def test_a_closed_writer_starts_nothing(tmp_path: Path, make_info: MakeInfo) -> None:
    writer = DatasetWriter.open(tmp_path, make_info())
    writer.close()
    writer.close()
    with pytest.raises(DatasetError, match="closed"):
        writer.episode("a", seed=0)
    with pytest.raises(DatasetError, match=r"Cannot remove episode 'a': the writer of .* is closed"):
        writer.remove_episode("a")


def test_a_copy_without_empty_folders_is_recorded_into(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    DatasetWriter.open(tmp_path, make_info()).close()
    for name in ("episodes", "open"):
        (tmp_path / name).rmdir()
    with DatasetWriter.open(tmp_path, make_info(), resume=True) as writer:
        record(writer, "a")
    assert [episode.id for episode in Dataset.open(tmp_path)] == ["a"]
    assert check(tmp_path).is_ok


def test_any_path_will_do(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    path = tmp_path / "Würfel greifen" / "2030 März"
    with DatasetWriter.open(path, make_info(instruction="Greife den Würfel 🎲")) as writer:
        record(writer, "erster Versuch – größer")
    (episode,) = Dataset.open(path).episodes
    assert episode.id == "erster Versuch – größer"
    assert episode.instruction == "Greife den Würfel 🎲"
    assert check(path).is_ok


def test_a_path_that_is_no_text_is_refused_before_anything_is_recorded(
    dataset: Path, tmp_path: Path, make_info: MakeInfo
) -> None:
    folder = tmp_path / os.fsdecode(b"odd\xff")
    with pytest.raises(DatasetError, match="path is not UTF-8"):
        DatasetWriter.open(folder / "set", make_info())
    assert not folder.exists()
    with pytest.raises(DatasetError, match="path is not UTF-8"):
        edit.merge([dataset], folder / "merged")
    assert not folder.exists()
    shutil.copytree(dataset, folder)
    for use in (Dataset.open, check, recover, lambda path: edit.delete(path, ["000001"])):
        with pytest.raises(DatasetError, match="path is not UTF-8"):
            use(folder)
    with pytest.raises(DatasetError, match="path is not UTF-8"):
        import_format("auto", folder)


def test_a_fork_has_no_part_in_what_its_parent_records(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    rows = make_rows(4)
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        for row in rows[:3]:
            episode.add(row, np.zeros(STATE))
        child = os.fork()
        if child == 0:
            refused = 0
            for call in (
                lambda: episode.add(rows[3], np.zeros(STATE)),
                lambda: episode.finish(True),
                lambda: episode.abort("for no reason"),
                episode.discard,
                lambda: writer.episode("b", seed=1),
                lambda: writer.remove_episode("a"),
            ):
                try:
                    call()
                except DatasetError as err:
                    refused += "DatasetWriter.join" in str(err)
            with episode:
                pass
            writer.close()
            os._exit(refused)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 6
        episode.add(rows[3], np.zeros(STATE))
        episode.finish(True)
    assert [(each.id, each.length) for each in Dataset.open(tmp_path)] == [("a", 4)]
    assert check(tmp_path).is_ok


def test_a_program_may_change_its_folder_meanwhile(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    with DatasetWriter.open("set", make_info()) as writer, writer.episode("a", seed=0) as episode:
        for row in make_rows(3):
            episode.add(row, np.zeros(STATE))
        monkeypatch.chdir("elsewhere")
        episode.finish(True)
    monkeypatch.chdir(tmp_path)
    dataset = Dataset.open("set")
    monkeypatch.chdir("elsewhere")
    assert dataset["a"].column("observation/joints").shape == (3, 3)
