"""What all replays share: mixed data and several robots replay too, rows are counted, and only due frames are drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset
from rcs_data.edit import Part, mix

import rcs
from rcs.envs.by_robot import by_robot, joined, prefixes
from rcs.errors import InvalidSetup
from rcs.rollout.collect import Collection, Progress, collect
from rcs.rollout.derive import Derivation, derive, row_counter
from rcs.rollout.look import Look, setup_of
from rcs.rollout.real_to_sim import RealToSim
from rcs.rollout.reexecute import Reexecution
from rcs.rollout.replay import replay
from rcs.rollout.rerender import Rerendering
from rcs.sim.camera import SimCameras

JOBS: list[type[Derivation]] = [Rerendering, Reexecution, RealToSim]


def recorded(out: Path, seed: int = 1, **options: Any) -> Path:
    setup = rcs.Setup(**{"cameras": (), "max_episode_steps": 20, **options})
    for _ in collect(Collection(setup=setup, out=out, episodes=2, seed=seed), Progress()):
        pass
    return out


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("derive") / "dataset")


def test_a_mixed_dataset_replays_in_every_way(dataset: Path, tmp_path: Path) -> None:
    other = recorded(tmp_path / "other", seed=2)
    mixed = mix([Part(path=dataset), Part(path=other, episodes=1)], tmp_path / "mixed")
    assert setup_of(mixed) == setup_of(Dataset.open(dataset))
    assert [result.is_equal for result in replay(mixed.path)] == [True] * 3
    for job in JOBS:
        options: dict[str, Any] = {"keep": "all"} if job is RealToSim else {}
        list(derive(job(source=mixed.path, out=tmp_path / job.kind, **options)))
        assert len(Dataset.open(tmp_path / job.kind)) == 3
    executed, before = Dataset.open(tmp_path / "actions").episodes, mixed.episodes
    assert [episode.content_hash for episode in executed] == [episode.content_hash for episode in before]


def test_a_mix_of_different_setups_is_refused_with_what_differs(dataset: Path, tmp_path: Path) -> None:
    other = recorded(tmp_path / "other", physics_step=0.001)
    mixed = mix([Part(path=dataset), Part(path=other)], tmp_path / "mixed")
    with pytest.raises(InvalidSetup, match="physics_step"):
        list(derive(RealToSim(source=mixed.path, out=tmp_path / "out")))


@pytest.mark.gl
@pytest.mark.parametrize("job", JOBS)
def test_data_of_several_robots_replay_in_every_way(tmp_path: Path, job: type[Derivation]) -> None:
    options = {"task": "LiftBar", "robot": "dual_fr3", "cameras": ("front",), "image_size": 32}
    source = recorded(tmp_path / "source", **options)
    more: dict[str, Any] = {"keep": "all"} if job is RealToSim else {}
    list(derive(job(source=source, out=tmp_path / "out", **more)))
    old, new = Dataset.open(source).episodes, Dataset.open(tmp_path / "out").episodes
    if job is not RealToSim:
        assert [episode.content_hash for episode in new] == [episode.content_hash for episode in old]
        assert [e.sim_state().tobytes() for e in new] == [e.sim_state().tobytes() for e in old]
    assert all(result.is_equal for result in replay(tmp_path / "out"))


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("job", [Rerendering, Reexecution])
def test_every_row_is_counted_in_whichever_process_it_is_made(
    dataset: Path, tmp_path: Path, job: type[Derivation], workers: int
) -> None:
    rows = row_counter()
    list(derive(job(source=dataset, out=tmp_path / "out", workers=workers), rows))
    assert rows.value == sum(episode.length for episode in Dataset.open(tmp_path / "out").episodes)


@pytest.mark.gl
def test_only_frames_that_are_due_are_drawn(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    draw = SimCameras.read

    def watch(self: SimCameras, names: Any = None, copies: Any = None) -> Any:
        drawn.extend(self.names if names is None else names)
        return draw(self, names, copies)

    monkeypatch.setattr(SimCameras, "read", watch)
    look = Look(cameras=("side",), image_size=32, camera_fps=15.0)
    list(derive(Rerendering(source=dataset, out=tmp_path / "out", look=look)))
    episodes = Dataset.open(tmp_path / "out").episodes
    assert len(drawn) == sum((episode.length + 1) // 2 for episode in episodes)
    assert len(drawn) == sum(int((episode.column("flags/frames/side") == 0).sum()) for episode in episodes)


def test_values_by_robot_are_joined_to_what_they_were() -> None:
    one, two = {"joints": 1}, {"left": {"joints": 1}, "right": {"joints": 2}}
    assert joined(by_robot(["fr3"], one)) == one
    assert joined(by_robot(["left", "right"], {**two, "frames": 3})) == two
    assert prefixes(["fr3"]) == {"fr3": ""}
    assert prefixes(["left", "right"]) == {"left": "left/", "right": "right/"}
