"""Frames that are late are those of their capture time, and their age is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.sim.randomisation import Randomisation

pytestmark = pytest.mark.gl
CAMERAS: dict[str, Any] = {"cameras": rcs.Cameras(names=("side", "wrist"), image_size=24)}
STEPS = 12


def action(copies: int | None = None) -> dict[str, np.ndarray]:
    leading = () if copies is None else (copies,)
    return {"joints": np.full((*leading, 7), 0.02), "gripper": np.ones((*leading, 1), np.float32)}


def frames_of(
    ranges: Randomisation | None, seed: int = 0, *, fps: float | None = None, **options: Any
) -> tuple[list[Any], list[Any]]:
    """Return frames and ages of an episode, the start first."""
    env: Any = rcs.make("Free", randomisation=ranges, cameras=replace(CAMERAS["cameras"], fps=fps), **options)
    observation, _ = env.reset(seed=seed)
    frames, ages = [observation["frames"]], [{}]
    for _ in range(STEPS):
        observation, *_, info = env.step(action())
        frames.append(observation["frames"])
        ages.append(info.get("ages", {}))
    env.close()
    return frames, ages


@pytest.mark.parametrize("options", [{}, {"fps": 15.0}, {"frequency": 50}], ids=["30 Hz", "slow", "fast steps"])
def test_a_late_frame_is_the_one_of_its_age_before(options: dict[str, Any]) -> None:
    latency, frequency = 0.07, options.get("frequency", 30)
    fresh, none = frames_of(None, **options)
    late, ages = frames_of(Randomisation.off(frame_latency=(latency, latency)), **options)
    assert not any(none)
    seen = set()
    for k in range(1, STEPS + 1):
        for name in CAMERAS["cameras"]:
            age = float(ages[k][f"frames/{name}"])
            steps = round(age * frequency)
            assert age == pytest.approx(steps / frequency, abs=0.002)  # steps are whole physics steps
            # At the start, the first frame is new; then nothing is seen that had no time to come.
            assert k - steps == 0 or latency - 1e-9 <= age < latency + 1.1 / frequency + 1 / options.get("fps", 60)
            for key, values in late[k][name].items():
                np.testing.assert_array_equal(values, fresh[k - steps][name][key])
            seen.add(steps)
    assert max(seen) / frequency > latency - 0.002
    moved = fresh[-1]["wrist"]["extrinsics"] - late[-1]["wrist"]["extrinsics"]
    assert np.abs(moved).max() > 1e-3


def test_every_copy_sees_what_its_single_environment_sees() -> None:
    ranges = Randomisation.off(frame_latency=(0.0, 0.1), frame_jitter=0.03)
    options: dict[str, Any] = {**CAMERAS, "randomisation": ranges}
    envs: Any = rcs.make_vec("Free", copies=4, threads=2, autoreset="Disabled", **options)
    observation, info = envs.reset(seed=5)
    seen, told = [observation["frames"]], []
    for _ in range(STEPS):
        observation, *_, info = envs.step(action(4))
        seen.append(observation["frames"])
        told.append(info["ages"])
    assert len({tuple(ages["frames/side"]) for ages in told}) > 1
    for copy in range(4):
        frames, ages = frames_of(ranges, seed=5 + copy)
        for k in range(STEPS + 1):
            for name in CAMERAS["cameras"]:
                for key, values in frames[k][name].items():
                    np.testing.assert_array_equal(seen[k][name][key][copy], values)
                if k:
                    assert told[k - 1][f"frames/{name}"][copy] == pytest.approx(ages[k][f"frames/{name}"], abs=1e-12)
    envs.close()


def test_a_copy_that_starts_anew_sees_its_start_at_once() -> None:
    ranges = Randomisation.off(frame_latency=(0.1, 0.1), robot_start=0.1)
    envs: Any = rcs.make_vec("Free", copies=2, autoreset="Disabled", randomisation=ranges, **CAMERAS)
    envs.reset(seed=0)
    for _ in range(5):
        before, *_ = envs.step(action(2))
    observation, _ = envs.reset(options={"reset_mask": np.array([False, True])})
    single: Any = rcs.make("Free", randomisation=ranges, **CAMERAS)
    single.reset(seed=1)
    again, _ = single.reset()
    for name in CAMERAS["cameras"]:
        np.testing.assert_array_equal(observation["frames"][name]["rgb"][1], again["frames"][name]["rgb"])
        np.testing.assert_array_equal(observation["frames"][name]["rgb"][0], before["frames"][name]["rgb"][0])
    envs.close()
    single.close()


def test_a_recording_has_the_times_of_capture_and_flags_what_was_seen_before(tmp_path: Path) -> None:
    ranges = Randomisation.off(frame_latency=(0.07, 0.07))
    env: Any = rcs.make("Free", randomisation=ranges, max_episode_steps=8, **CAMERAS)
    with rcs.record_all(env, tmp_path / "late"):
        env.reset(seed=0)
        for _ in range(8):
            env.step(action())
    env.close()
    episode = Dataset.open(tmp_path / "late").episodes[0]
    captured, ends = episode.column("time/frames/side"), episode.column("time/monotonic")
    # The start is seen until the frame after it has had its time.
    np.testing.assert_array_equal(captured[:4], captured[0])
    for row in range(4, 9):
        assert ends[row - 4] < captured[row] <= ends[row - 3]
    assert (np.diff(captured[3:]) > 0).all()


def test_in_real_time_frames_are_late_on_the_wall_clock() -> None:
    ranges = Randomisation.off(frame_latency=(0.1, 0.1))
    _, ages = frames_of(ranges, stepping="realtime", frequency=20)
    assert all(told["frames/side"] >= 0.1 - 1e-6 for told in ages[4:])
