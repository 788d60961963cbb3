"""An observer beside the loop: it sees everything in order, never slows the loop, and its errors are reported."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetWriter

import rcs
from rcs.envs import InBackground, Observer, Recorder, Transition, dataset_info
from rcs.errors import InvalidSetup
from rcs.sim.pixels import Pixels

ACTION = {"joints": np.zeros(7), "gripper": np.ones(1, np.float32)}


class Witness(Observer):
    """Remembers what it sees; waits for `go` before every step."""

    def __init__(self, *, go: threading.Event | None = None, fail_at: int | None = None) -> None:
        self.seen: list[Any] = []
        self.threads: set[str] = set()
        self.is_closed = False
        self._go, self._fail_at = go, fail_at

    def on_reset(self, first: Transition, seed: int | None) -> None:
        self.seen.append(("reset", seed))

    def on_step(self, transition: Transition) -> None:
        self.threads.add(threading.current_thread().name)
        if self._go is not None:
            assert self._go.wait(10)
        if len(self.seen) == self._fail_at:
            raise ValueError("the disk is full")
        self.seen.append(transition.observation["joints"])

    def on_end(self, end: str, reasons: Mapping[str, str]) -> None:
        self.seen.append(("end", end))

    def info(self) -> Mapping[str, Any]:
        return {"witness": len(self.seen)}

    def close(self) -> None:
        self.is_closed = True


def test_it_sees_what_an_observer_in_the_loop_sees_in_a_thread_of_its_own() -> None:
    beside, within = Witness(), Witness()
    background = InBackground(beside)
    with rcs.make("Free", observers=[background, within]) as env:
        for seed in (3, 4):
            env.reset(seed=seed)
            for _ in range(20):
                env.step(env.action_space.sample())
        assert background.wait()
        assert background.missed == 0
    assert beside.is_closed
    assert beside.threads == {"rcs observer Witness"}
    assert len(beside.seen) == len(within.seen) == 42
    for one, other in zip(beside.seen, within.seen, strict=True):
        np.testing.assert_array_equal(one, other)
    assert "rcs observer Witness" not in {thread.name for thread in threading.enumerate()}


def test_one_that_hangs_misses_steps_and_holds_up_nothing_but_starts_and_ends_get_through() -> None:
    go = threading.Event()
    slow = Witness(go=go)
    background = InBackground(slow, bound=5)
    with rcs.make("Free", observers=[background]) as env:
        env.reset(seed=0)
        for _ in range(50):
            env.step(ACTION)  # would hang for good if it waited
        env.reset(seed=1)
        go.set()
        assert background.wait()
        resets = [seen for seen in slow.seen if isinstance(seen, tuple)]
        assert resets == [("reset", 0), ("reset", 1)]
        steps = len(slow.seen) - 2
        assert steps + background.missed == 50
        assert 4 <= steps <= 7


def test_its_error_is_in_the_info_of_later_steps_and_raised_by_close_and_the_loop_goes_on() -> None:
    background = InBackground(Witness(fail_at=3))
    env = rcs.make("Free", observers=[background])
    env.reset(seed=0)
    infos = [env.step(ACTION)[-1] for _ in range(2)]
    assert background.wait()
    assert "observers" not in infos[0]
    env.step(ACTION)
    background.wait()
    info = env.step(ACTION)[-1]
    assert info["observers"] == {"Witness": "ValueError: the disk is full"}
    assert info["witness"] == 3
    with pytest.raises(ValueError, match="disk is full"):
        env.close()
    env.close()


class Other(Witness):
    """Another class, with a name of its own."""


def test_of_two_that_fail_both_are_told() -> None:
    watched = [InBackground(Witness(fail_at=1)), InBackground(Other(fail_at=1))]
    env = rcs.make("Free", observers=watched)
    env.reset(seed=0)
    env.step(ACTION)
    assert all(one.wait() for one in watched)
    info = env.step(ACTION)[-1]
    assert info["observers"] == dict.fromkeys(("Witness", "Other"), "ValueError: the disk is full")
    with pytest.raises(ValueError, match="disk is full"):
        env.close()


def test_closing_waits_for_what_is_in_the_queue() -> None:
    witness = Witness()
    with rcs.make("Free", observers=[InBackground(witness)]) as env:
        env.reset(seed=0)
        for _ in range(10):
            env.step(ACTION)
    assert len(witness.seen) == 11


def test_what_the_program_does_to_its_observation_is_not_seen() -> None:
    go = threading.Event()
    witness = Witness(go=go)
    background = InBackground(witness)
    with rcs.make("Free", observers=[background]) as env:
        env.reset(seed=0)
        observation, *_, info = env.step(ACTION)
        del observation["joints"], info["time"]
        go.set()
        assert background.wait()
        assert witness.seen[1].shape == (7,)


class Copies(Witness):
    """Keeps copies of actions and pixels, as they are when it comes to look at them."""

    def on_step(self, transition: Transition) -> None:
        super().on_step(transition)
        action: Any = transition.action
        self.seen[-1] = action["joints"].copy(), transition.observation["frames"]["side"]["pixels"].copy()


def test_actions_and_pixels_whose_memory_is_used_again_are_seen_as_they_were() -> None:
    go = threading.Event()
    late = Copies(go=go)
    background = InBackground(late)
    cameras = rcs.Cameras(names=("side",), image_size=(16, 16), pixels=Pixels(valid_steps=1))
    with rcs.make("PickCuboid", cameras=cameras, observers=[background]) as env:
        env.action_space.seed(0)
        env.reset(seed=0)
        action = env.action_space.sample()
        expected: list[Any] = []
        for _ in range(8):
            action["joints"][:] = env.action_space.sample()["joints"]
            observation, *_ = env.step(action)
            expected.append((action["joints"].copy(), observation["frames"]["side"]["pixels"].copy()))
        go.set()
        assert background.wait()
    for (joints, pixels), (given, shown) in zip(late.seen[1:], expected, strict=True):
        np.testing.assert_array_equal(joints, given)
        np.testing.assert_array_equal(pixels, shown)


def test_without_an_episode_there_is_no_thread() -> None:
    before = threading.active_count()
    InBackground(Witness()).close()
    assert threading.active_count() == before


@pytest.mark.parametrize("bound", [0, -1, 1.5, True])
def test_a_bound_that_makes_no_sense_is_refused(bound: Any) -> None:
    with pytest.raises(InvalidSetup, match="bound is"):
        InBackground(Witness(), bound=bound)


def test_a_recorder_is_refused_because_it_has_a_thread_of_its_own(tmp_path: Path) -> None:
    env = rcs.make("Free")
    with DatasetWriter.open(tmp_path, dataset_info(env)) as writer:
        with pytest.raises(InvalidSetup, match="background=True"):
            InBackground(Recorder(writer))
        env.close()
