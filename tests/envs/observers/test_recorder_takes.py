from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, recover

import rcs
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.errors import DatasetError, WrongOrder


class Session:
    """A robot that moves on, whether a take is under way or not."""

    def __init__(self, path: Path, background: bool) -> None:
        setup = rcs.Setup(task="Free", robot="fr3", cameras=())
        self.path = path
        self.env: Env = rcs.make(setup)
        self.writer = DatasetWriter.open(path, dataset_info(self.env), resume=True)
        self.takes = Recorder(self.writer, background=background)
        self.env.add_observer(self.takes)
        self.env.reset(seed=0)

    def steps(self, n: int) -> None:
        for _ in range(n):
            self.env.step(self.env.action_space.sample())

    def ids(self) -> list[str]:
        return [episode.id for episode in Dataset.open(self.path).episodes]


@pytest.fixture(params=[False, True], ids=["here", "background"])
def session(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Session]:
    session = Session(tmp_path / "takes", request.param)
    yield session
    session.env.close()
    session.writer.close()


def test_a_take_has_its_instruction_and_verdict_and_only_its_own_rows(session: Session) -> None:
    session.steps(3)
    assert session.takes.start("wave") == "000000"
    session.steps(4)
    episode = session.takes.finish(True, {"operator": "left hand"})
    session.steps(2)
    assert (episode.length, episode.instruction, episode.success) == (4, "wave", True)
    assert episode.outcome == {"operator": "left hand"}
    assert session.ids() == ["000000"]


def test_of_a_discarded_take_nothing_is_left_and_its_number_is_free(session: Session) -> None:
    session.takes.start()
    session.steps(5)
    session.takes.discard()
    assert not list((session.path / "episodes").iterdir())
    assert session.takes.start() == "000000"
    session.steps(2)
    kept = session.takes.finish(None)
    assert kept.length == 2
    assert (np.diff(kept.column("simulated_time")) > 0).all()


def test_a_retake_replaces_the_take_under_way_or_the_last_one(session: Session) -> None:
    session.takes.start("push")
    session.steps(5)
    assert session.takes.retake() == "000000"
    session.steps(3)
    assert session.takes.finish(False).length == 3
    assert session.takes.retake() == "000000"
    assert session.ids() == []
    session.steps(2)
    again = session.takes.finish(True)
    assert (again.length, again.instruction, again.success) == (2, "push", True)
    assert session.takes.start() == "000001"


def test_after_a_disk_that_was_full_takes_go_on_and_the_rows_of_the_last_one_stay(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    session.takes.start()
    session.steps(3)
    with monkeypatch.context() as full:
        full.setattr("os.fsync", fail)
        with pytest.raises(DatasetError, match="No space left"):
            session.takes.finish(True)
    assert session.takes.start() == "000001"
    session.steps(2)
    assert session.takes.finish(True).length == 2
    session.env.close()
    session.writer.close()
    assert recover(session.path).recovered == ("000000",)


def test_what_makes_no_sense_is_refused(session: Session) -> None:
    with pytest.raises(WrongOrder, match="no open episode to finish"):
        session.takes.finish(True)
    with pytest.raises(WrongOrder, match="no take to repeat"):
        session.takes.retake()
    session.takes.start()
    with pytest.raises(WrongOrder, match="under way"):
        session.takes.start()
    with pytest.raises(WrongOrder, match="no observation yet"):
        session.takes.finish(True)


def test_a_new_session_goes_on_after_the_last_take(tmp_path: Path) -> None:
    for _ in range(2):
        session = Session(tmp_path, background=False)
        session.takes.start(at_reset=True)
        session.steps(2)
        session.env.reset()
        session.steps(2)
        assert session.takes.finish(True).length == 3
        session.env.close()
        session.writer.close()
    assert session.ids() == ["000000", "000001"]
