"""Ray is wanted only where it is used, and what is missing is named."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import rcs
from rcs.cli.main import main
from rcs.errors import InvalidSetup, MissingDependency
from rcs.rollout import ray_pool
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation
from rcs.rollout.ray_pool import RayPool, connected

IMPORTS = (
    "import sys, rcs.rollout.collect, rcs.rollout.evaluate, rcs.cli.collect, rcs.cli.eval; print('ray' in sys.modules)"
)


@pytest.fixture
def no_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)


def test_ray_is_not_imported_before_it_is_used() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


@pytest.mark.usefixtures("no_ray")
def test_a_cluster_without_ray_names_the_extra(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(MissingDependency, match=r"pip install 'robot-control-stack\[ray\]'"):
        list(evaluate(Evaluation(setup=rcs.Setup(), ray="auto", out=tmp_path)))
    with pytest.raises(MissingDependency, match=r"\[ray\]"):
        list(collect(Collection(setup=rcs.Setup(), episodes=1, ray="auto", out=tmp_path / "a"), Progress()))
    with pytest.raises(SystemExit) as end:
        main(["eval", "PickCuboid", "--ray", "auto", "--episodes", "1", "--out", str(tmp_path / "b")])
    assert end.value.code == 1
    assert "[ray]" in capsys.readouterr().err


@pytest.mark.usefixtures("no_ray")
def test_numbers_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="workers is -1"):
        RayPool(list, -1, "auto")
    with pytest.raises(InvalidSetup, match="workers"):
        Collection(setup=rcs.Setup(), episodes=1, out=tmp_path, workers=0)
    assert Collection(setup=rcs.Setup(), episodes=1, out=tmp_path, ray="auto", workers=0).workers == 0


def test_an_address_of_ray_client_is_refused() -> None:
    with (
        pytest.raises(InvalidSetup, match=r"ray://there:10001.*valid is 'auto'"),
        connected("ray://there:10001"),
    ):
        pass


class Joining:
    """A cluster to which a machine with two CPUs comes when it is asked for the fourth time."""

    exceptions = None

    def __init__(self) -> None:
        self.asked = 0

    def cluster_resources(self) -> dict[str, int]:
        self.asked += 1
        return {"CPU": 2} if self.asked > 3 else {}

    def put(self, value: Any) -> Any:
        return value

    def remote(self, **_: Any) -> Any:
        return lambda task: SimpleNamespace(remote=lambda source, number: number)

    def wait(self, pending: list[int], timeout: float) -> tuple[list[int], list[int]]:
        return pending, []

    def get(self, done: int) -> tuple[int, dict[str, Any]]:
        return done, {}


def test_without_a_cpu_what_has_nothing_left_ends_and_the_rest_waits_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Joining()
    monkeypatch.setattr(ray_pool, "connected", lambda address: nullcontext(cluster))
    monkeypatch.setattr(ray_pool, "time", SimpleNamespace(sleep=lambda seconds: None))
    taken: list[tuple[int, int]] = []

    def numbers() -> Iterator[int]:
        for number in range(3):
            taken.append((number, cluster.asked))
            yield number

    with RayPool(list, 0, "auto") as pool:
        assert list(pool.map(iter(()))) == []
        assert cluster.asked == 1
        assert sorted(result for result, _ in pool.map(numbers())) == [0, 1, 2]
    assert taken[:2] == [(0, 2), (1, 4)], "one alone while there is no CPU"


@pytest.mark.cluster
def test_an_address_without_a_cluster_says_what_to_do() -> None:
    with (
        pytest.raises(Exception, match=r"Could not connect .*`ray start --head` starts one"),
        connected("auto"),
    ):
        pass
