"""Derived datasets: mixed data and several robots replay in every way, and only due frames are rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset
from rcs_data.edit import Part, mix

import rcs
from rcs.envs.spaces import join_robots, robot_prefixes, split_by_robot
from rcs.errors import InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.recorded_setup import setup_of
from rcs.rollout.reexecute import reexecute
from rcs.rollout.replay import replay
from rcs.rollout.rerender import rerender
from rcs.sim.camera import SimCameras

REPLAYS: dict[str, Callable[..., Iterator[Any]]] = {
    "render": rerender,
    "actions": reexecute,
    "states": partial(reexecute, kind="states"),
}


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
    for kind, make in REPLAYS.items():
        list(make(mixed.path, tmp_path / kind))
        assert len(Dataset.open(tmp_path / kind)) == 3
    executed, before = Dataset.open(tmp_path / "actions").episodes, mixed.episodes
    assert [episode.content_hash for episode in executed] == [episode.content_hash for episode in before]


def test_a_mix_of_different_setups_is_refused_with_what_differs(dataset: Path, tmp_path: Path) -> None:
    other = recorded(tmp_path / "other", physics_step=0.001)
    mixed = mix([Part(path=dataset), Part(path=other)], tmp_path / "mixed")
    with pytest.raises(InvalidSetup, match="physics_step"):
        list(reexecute(mixed.path, tmp_path / "out", kind="states"))


@pytest.mark.gl
@pytest.mark.parametrize("kind", REPLAYS)
def test_data_of_several_robots_replay_in_every_way(tmp_path: Path, kind: str) -> None:
    options = {"task": "LiftBar", "robot": "dual_fr3", "cameras": rcs.Cameras("front", image_size=32)}
    source = recorded(tmp_path / "source", **options)
    list(REPLAYS[kind](source, tmp_path / "out"))
    old, new = Dataset.open(source).episodes, Dataset.open(tmp_path / "out").episodes
    if kind != "states":
        assert [episode.content_hash for episode in new] == [episode.content_hash for episode in old]
        assert [e.sim_state().tobytes() for e in new] == [e.sim_state().tobytes() for e in old]
    assert all(result.is_equal for result in replay(tmp_path / "out"))


@pytest.mark.gl
def test_only_frames_that_are_due_are_drawn(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    draw = SimCameras.read

    def watch(self: SimCameras, names: Any = None, copies: Any = None) -> Any:
        drawn.extend(self.names if names is None else names)
        return draw(self, names, copies)

    monkeypatch.setattr(SimCameras, "read", watch)
    setup = replace(setup_of(Dataset.open(dataset)), cameras=rcs.Cameras("side", image_size=32, fps=15.0))
    list(rerender(dataset, tmp_path / "out", setup=setup))
    episodes = Dataset.open(tmp_path / "out").episodes
    assert len(drawn) == sum((episode.length + 1) // 2 for episode in episodes)
    assert len(drawn) == sum(int((episode.column("flags/frames/side") == 0).sum()) for episode in episodes)


def test_values_by_robot_are_joined_to_what_they_were() -> None:
    one, two = {"joints": 1}, {"left": {"joints": 1}, "right": {"joints": 2}}
    assert join_robots(split_by_robot(["fr3"], one)) == one
    assert join_robots(split_by_robot(["left", "right"], {**two, "frames": 3})) == two
    assert robot_prefixes(["fr3"]) == {"fr3": ""}
    assert robot_prefixes(["left", "right"]) == {"left": "left/", "right": "right/"}
