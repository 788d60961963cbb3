"""The statements of `episode.json` are checked where it is read, whoever sealed it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset, check
from rcs_data.check.repair import repair
from rcs_data.cli.program import run
from rcs_data.cli.view import InfoCommand, ViewCommand
from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import sealed, unsealed
from rcs_data.files.json_file import parsed_json


def say(dataset: Path, **changes: Any) -> None:
    path = dataset / "episodes/000001/episode.json"
    path.write_bytes(sealed({**unsealed(path.read_bytes(), path), **changes}))


MANY_THREADS = """
import sys, threading, time
from pathlib import Path
import msgspec._utils as utils
look = utils.get_class_annotations
utils.get_class_annotations = lambda kind: time.sleep(0.02) or look(kind)  # as on a busy machine
from rcs_data.files.about import read_about
threads = [threading.Thread(target=read_about, args=(Path(sys.argv[1]),)) for _ in range(8)]
for thread in threads:
    thread.start()
    time.sleep(0.011)
for thread in threads:
    thread.join()
"""


def test_many_threads_read_the_first_description_at_once(dataset: Path) -> None:
    program = [sys.executable, "-c", MANY_THREADS, str(dataset / "episodes/000001")]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


WRONG = [
    ("success", "yes"), ("success", 1), ("timing", None), ("timing", {"cameras": 3}), ("length", 10**18),
    ("timing", {"period": {"expected": 0.03, "max": 0.04}}),
    ("length", True), ("outcome", []), ("seed", "1"), ("seed", 2**130), ("instruction", None), ("content_hash", "x"),
    ("sha256", {"../../dataset.json": "0" * 64}), ("versions", {"rcs": 1}), ("source", {"dataset": "../x"}),
    ("source", {"dataset": "a", "episode": "../x"}),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value"), WRONG)
def test_what_cannot_be_is_named_by_check_and_refused_by_all_else(dataset: Path, field: str, value: Any) -> None:
    say(dataset, **{field: value})
    episode = Dataset.open(dataset)["000001"]
    with pytest.raises(CorruptEpisode, match=r"000001/episode\.json is damaged: "):
        _ = episode.about
    found = [finding for finding in check(dataset).damage if finding.episode == "000001"]
    assert "is damaged" in found[0].message
    assert run(InfoCommand(path=dataset)) == 0, "the index has what it needs"
    assert run(ViewCommand(path=dataset)) == 0, "the page lists it as damaged"


def test_a_repair_puts_such_an_episode_aside(dataset: Path) -> None:
    say(dataset, success="yes")
    repair(dataset)
    assert [episode.id for episode in Dataset.open(dataset)] == ["000000", "000002"]
    assert (dataset / "quarantine/000001/episode.json").exists()
    assert check(dataset).is_ok


@pytest.mark.parametrize(
    "text",
    ["[1]", '{"a": NaN}', '{"a": 1e999}', '{"a": ' + "1" * 5000 + "}", "{", '{"a": ' + "[" * 99999],
)
def test_json_that_no_dataset_has_is_refused(text: str) -> None:
    with pytest.raises(CorruptEpisode, match="somewhere is damaged"):
        parsed_json(text.encode(), "somewhere")


IN_THREADS = """
import sys, threading
from pathlib import Path
from rcs_data.files.about import read_about
sys.setswitchinterval(1e-7)
start = threading.Barrier(8)
def read():
    start.wait()
    read_about(Path(sys.argv[1]))
threads = [threading.Thread(target=read) for _ in range(8)]
for thread in threads: thread.start()
for thread in threads: thread.join()
"""


def test_the_first_ones_may_be_read_in_several_threads(dataset: Path) -> None:
    command = [sys.executable, "-c", IN_THREADS, str(dataset / "episodes/000001")]
    for _ in range(3):  # nine of ten crashed where msgspec looked at the type in two threads
        assert subprocess.run(command, timeout=100).returncode == 0
