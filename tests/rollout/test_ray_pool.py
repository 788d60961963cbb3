"""On a cluster of Ray, episodes are those of a single process, whatever is killed; nothing stays running."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset, check

import rcs
from rcs.agents import Agent, agent_for
from rcs.envs.env import Env
from rcs.errors import InvalidSetup, RcsError
from rcs.rollout import ray_pool
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.evaluate import evaluate, film
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.ray_pool import RayPool

pytestmark = pytest.mark.cluster

SHORT = rcs.Setup(max_episode_steps=12)
FOLDER = "RCS_TEST_FOLDER"
"""Environment variable: a folder of the test, in which files tell agents what to do."""


@dataclass(frozen=True)
class Squares:
    """Makes a worker that squares numbers; negative ones end its process."""

    fails_to_start: bool = False

    def __call__(self, folder: Path, agent: Any) -> Squares:
        if self.fails_to_start:
            raise InvalidSetup("no such robot")
        return self

    def attempt(self, number: int) -> int:
        if number < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        if number == 1000:
            raise ValueError("out of order")
        return number * number

    def close(self) -> None:
        return


class Surroundings:
    """A worker that tells where it is."""

    def __init__(self, folder: Path, agent: Any) -> None:
        pass

    def attempt(self, number: int) -> dict[str, Any]:
        time.sleep(0.05)  # so that every worker gets some
        import ray

        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "LP_NUM_THREADS")
        about = ray.get_runtime_context()
        return {"node": about.get_node_id(), "threads": {os.environ.get(name) for name in names}, "pid": os.getpid()}

    def close(self) -> None:
        return


class Unlucky(Agent):
    """The expert of the task; in the fifth step of the process that first takes the file `die`, the process is killed.

    On the machine whose id is in the file `wait`, it waits there for its end, after making the file `waiting`.
    """

    def __init__(self, env: Env) -> None:
        self._expert = agent_for(env)
        self._folder = Path(os.environ[FOLDER])
        self._steps = 0

    def reset(self, observation: Any, info: Any) -> None:
        self._steps = 0
        self._expert.reset(observation, info)

    def act(self, observation: Any, info: Any) -> Any:
        self._steps += 1
        if self._steps == 5:
            self._meet_fate()
        return self._expert.act(observation, info)

    def _meet_fate(self) -> None:
        try:
            (self._folder / "die").unlink()  # one process alone succeeds
        except FileNotFoundError:
            pass
        else:
            os.kill(os.getpid(), signal.SIGKILL)
        wait = self._folder / "wait"
        if wait.exists():
            import ray

            if ray.is_initialized() and ray.get_runtime_context().get_node_id() == wait.read_text():
                (self._folder / "waiting").touch()
                time.sleep(600)

    @property
    def failure(self) -> str | None:
        return self._expert.failure


class Machines:
    """A cluster of two machines, simulated on this one, with a CPU each."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster

        # Dead machines are noticed in seconds instead of in half a minute.
        quick = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500, "health_check_failure_threshold": 3}
        head = {"num_cpus": 1, "include_dashboard": False, "_system_config": quick}
        self.cluster = Cluster(initialize_head=True, head_node_args=head)
        self.cluster.add_node(num_cpus=1)
        self.address: str = self.cluster.address


@pytest.fixture(scope="module")
def folder(
    tmp_path_factory: pytest.TempPathFactory, wait_for: Callable[..., None], processes_with: Callable[[str], list[str]]
) -> Iterator[Path]:
    """A folder that agents know, and an environment without tokens and reports."""
    folder = tmp_path_factory.mktemp("agents")
    mark = uuid.uuid4().hex
    place = Path("/tmp") / f"rcs-{mark[:6]}"  # short enough for sockets
    (place / "ray").mkdir(parents=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER, str(folder))
        patch.setenv("RAY_TMPDIR", str(place))
        patch.setenv("TMPDIR", str(place))
        patch.setenv("RCS_TEST_MARK", mark)
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "disabled")
        yield folder
    shutil.rmtree(place, ignore_errors=True)
    wait_for(lambda: not processes_with(mark), "all processes of the tests have ended", 120)


@pytest.fixture(scope="module")
def machines(folder: Path) -> Iterator[Machines]:
    made = Machines()
    yield made
    made.cluster.shutdown()


def plan(out: Path, **changes: Any) -> Collection:
    return replace(Collection(setup=SHORT, out=out, episodes=6, seed=7, agent=Unlucky), **changes)


def run(collection: Collection) -> Progress:
    progress = Progress()
    for _ in collect(collection, progress):
        pass
    return progress


@pytest.fixture(scope="module")
def alone(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("alone") / "dataset"
    run(plan(out))
    return out


def assert_same_bytes(one: Path, two: Path) -> None:
    first, second = Dataset.open(one), Dataset.open(two)
    assert first.info == second.info
    assert [episode.id for episode in first.episodes] == [episode.id for episode in second.episodes]
    measured = {"started", "ended", "timing", "sha256", "checksum"}
    for a, b in zip(first.episodes, second.episodes, strict=True):
        assert a.content_hash == b.content_hash
        about = ({key: value for key, value in each.about.items() if key not in measured} for each in (a, b))
        assert next(about) == next(about)
    assert check(two).is_ok


def test_every_number_is_answered_on_all_machines(machines: Machines) -> None:
    with RayPool(Squares(), 0, machines.address) as pool:
        assert sorted(result for result, _ in pool.map(iter(range(9)))) == [n * n for n in range(9)]
        assert sorted(result for result, _ in pool.map(iter(range(3)))) == [0, 1, 4]
    pool.close()
    with RayPool(Surroundings, 0, machines.address) as pool:
        answers = [answer for answer, _ in pool.map(iter(range(20)))]
    assert len({answer["node"] for answer in answers}) == len({answer["pid"] for answer in answers}) == 2


def test_each_worker_has_one_thread(machines: Machines) -> None:
    with RayPool(Surroundings, 1, machines.address) as pool:
        assert next(pool.map(iter([0])))[0]["threads"] == {"1"}


def test_numbers_are_taken_only_when_a_worker_is_free(machines: Machines) -> None:
    taken: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    with RayPool(Squares(), 2, machines.address) as pool:
        next(pool.map(numbers()))
        assert len(taken) <= 2


def test_errors_of_a_worker_reach_the_caller_as_they_are(machines: Machines) -> None:
    with RayPool(Squares(fails_to_start=True), 1, machines.address) as pool:
        with pytest.raises(InvalidSetup, match="no such robot") as error:
            list(pool.map(iter(range(3))))
        assert type(error.value) is InvalidSetup
    with RayPool(Squares(), 1, machines.address) as pool, pytest.raises(ValueError, match="out of order"):
        list(pool.map(iter([1, 1000, 2])))


def test_a_number_that_ends_every_worker_ends_the_work(machines: Machines) -> None:
    with (
        RayPool(Squares(), 2, machines.address) as pool,
        pytest.raises(RcsError, match="Number -1 ended 3 workers"),
    ):
        list(pool.map(iter([1, -1, 2, 3])))


def test_machines_with_other_software_are_refused(machines: Machines, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_pool, "_versions", lambda: {"numpy": "0.1"})
    with (
        RayPool(Squares(), 1, machines.address) as pool,
        pytest.raises(RcsError, match=r"has numpy .* instead of 0\.1"),
    ):
        list(pool.map(iter([1])))


def test_a_collection_of_two_machines_is_that_of_one_process(machines: Machines, alone: Path, tmp_path: Path) -> None:
    progress = run(plan(tmp_path / "two", ray=machines.address, workers=0))
    assert progress.kept == 6
    assert_same_bytes(alone, tmp_path / "two")


def test_a_killed_worker_loses_no_episode(machines: Machines, folder: Path, alone: Path, tmp_path: Path) -> None:
    (folder / "die").touch()
    run(plan(tmp_path / "killed", ray=machines.address, workers=2))
    assert not (folder / "die").exists(), "a worker was killed"
    assert_same_bytes(alone, tmp_path / "killed")


def test_a_machine_that_is_lost_loses_no_episode(
    machines: Machines, folder: Path, alone: Path, tmp_path: Path, wait_for: Callable[..., None]
) -> None:
    lost = machines.cluster.add_node(num_cpus=1)
    (folder / "wait").write_text(lost.node_id)
    progress = Progress()
    attempts = collect(plan(tmp_path / "lost", ray=machines.address, workers=0), progress)
    next(attempts)
    wait_for((folder / "waiting").exists, "an episode is under way on the machine")
    machines.cluster.remove_node(lost, allow_graceful=False)
    (folder / "wait").unlink()
    for _ in attempts:
        pass
    assert progress.kept == 6
    assert_same_bytes(alone, tmp_path / "lost")


def test_a_collection_whose_driver_is_killed_goes_on(
    machines: Machines, alone: Path, tmp_path: Path, wait_for: Callable[..., None]
) -> None:
    out = tmp_path / "driver"
    driver = [sys.executable, "-c", DRIVER, str(out), machines.address]
    with subprocess.Popen(driver, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}) as process:
        wait_for(lambda: (out / "episodes/000000").exists() or process.poll() is not None, "an episode has arrived")
        process.kill()
    assert process.returncode == -signal.SIGKILL
    found = run(plan(out, ray=machines.address, workers=2)).found
    assert 1 <= found < 6
    assert_same_bytes(alone, out)


DRIVER = """
import sys
from pathlib import Path
from tests.rollout.test_ray_pool import plan, run
run(plan(Path(sys.argv[1]), ray=sys.argv[2], workers=2))
"""


def test_only_success_keeps_the_same_episodes(machines: Machines, folder: Path, tmp_path: Path) -> None:
    collection = plan(tmp_path / "one", setup=rcs.Setup(max_episode_steps=112), episodes=2, only_success=True)
    run(collection)
    (folder / "die").touch()
    run(replace(collection, out=tmp_path / "two", ray=machines.address, workers=2))
    assert_same_bytes(tmp_path / "one", tmp_path / "two")


@pytest.mark.gl
def test_an_evaluation_has_the_same_figures_and_videos(machines: Machines, folder: Path, tmp_path: Path) -> None:
    (folder / "die").touch()
    made: list[list[Any]] = []
    for name, address in (("here", None), ("there", machines.address)):
        evaluation = Evaluation(setup=SHORT, episodes=4, workers=2, ray=address, out=tmp_path / name)
        evaluation = replace(evaluation, agent=Unlucky if address else None)
        summary = Summary()
        for _ in evaluate(evaluation, summary):
            pass
        assert len(list(film(evaluation, 2))) == 2
        made.append(summary.results)
    assert made[0] == made[1]
    films = [
        [path.read_bytes() for path in sorted((tmp_path / name / "films").iterdir())] for name in ("here", "there")
    ]
    assert len(films[0]) == 2
    assert sorted(films[0]) == sorted(films[1])
