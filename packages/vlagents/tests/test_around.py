from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from vlagents import Chunk, ImageSpec, InvalidInput, Metadata, Observation, PartSpec
from vlagents.around import Resized, resized
from vlagents.policies.random import RandomPolicy
from vlagents.policies.replay import Recorded, ReplayPolicy, read_calls
from vlagents.policies.scripted import ScriptedPolicy

METADATA = Metadata(name="mean", action=(PartSpec("joints", 3),), images=(ImageSpec("side", 20, 20),), rate=10.0)


def mean(observation: Observation, instruction: str) -> np.ndarray:
    """Answer with the mean colour of a picture."""
    image = observation.image("side")
    assert image.shape == (20, 20, 3)
    return image.mean(axis=(0, 1))


def test_pictures_are_made_as_large_as_the_policy_needs() -> None:
    image = np.full((48, 64, 3), (10, 100, 200), np.uint8)
    policy = Resized(ScriptedPolicy(mean, METADATA))
    assert policy.metadata().images == (ImageSpec("side"),)
    chunk = policy.infer(Observation(images={"side": image}))
    np.testing.assert_allclose(chunk.actions, 15 / 20 * np.array([[10, 100, 200]]), atol=0.5)  # a quarter is black


@pytest.mark.parametrize("size", [(48, 64), (20, 20), (100, 30), (1, 1), (96, 128)])
def test_a_picture_of_one_colour_keeps_it_and_its_shape(size: tuple[int, int]) -> None:
    image = np.full((48, 64, 3), (10, 100, 200), np.uint8)
    found = resized(image, *size)
    assert found.shape == (*size, 3)
    rows, columns = np.nonzero(found.any(axis=2))
    assert (found[rows, columns] == (10, 100, 200)).all()
    scale = min(size[0] / 48, size[1] / 64)
    assert np.ptp(rows) + 1 == max(1, round(48 * scale))
    assert np.ptp(columns) + 1 == max(1, round(64 * scale))


def test_a_ramp_stays_a_ramp() -> None:
    ramp = np.repeat(np.arange(0, 240, 2, dtype=np.uint8)[None, :, None], 40, axis=0).repeat(3, axis=2)
    found = resized(ramp, 20, 60)[10, 2:-2, 0].astype(float)
    np.testing.assert_allclose(np.diff(found), 4.0, atol=1.0)


def test_what_was_recorded_is_answered_again(tmp_path: Path) -> None:
    observation = Observation(state={"joints": np.arange(3.0)}, session="a", time=1.0)
    with Recorded(RandomPolicy(size=3), tmp_path / "calls") as policy:
        policy.reset("a", "pick", seed=1)
        given = [policy.infer(observation).actions for _ in range(4)]
    calls = list(read_calls(tmp_path / "calls"))
    assert calls[1]["reset"] == {"session": "a", "instruction": "pick", "seed": 1}
    np.testing.assert_array_equal(calls[2]["observation"]["state"]["joints"], np.arange(3.0))
    replay = ReplayPolicy(tmp_path / "calls")
    for _ in range(2):
        replay.reset("a")
        for actions in given:
            chunk = replay.infer(Observation(session="a", time=7.0))
            np.testing.assert_array_equal(chunk.actions, actions)
            assert chunk.time == 7.0
        with pytest.raises(InvalidInput, match="replayed"):
            replay.infer(Observation(session="a"))


def test_a_record_that_was_cut_off_by_a_kill_is_read_up_to_there(tmp_path: Path) -> None:
    policy = Recorded(RandomPolicy(size=3), tmp_path / "calls", with_images=True)
    for _ in range(3):
        policy.infer(Observation(images={"side": np.zeros((4, 4, 3), np.uint8)}))
    data = (tmp_path / "calls").read_bytes()  # not closed
    for cut in range(1, 40):
        (tmp_path / "cut").write_bytes(data[:-cut])
        assert len(list(read_calls(tmp_path / "cut"))) == 3
    policy.close()
    (tmp_path / "other").write_bytes(b"something else")
    with pytest.raises(InvalidInput, match="no record"):
        list(read_calls(tmp_path / "other"))


def test_actions_that_are_not_finite_never_leave() -> None:
    with pytest.raises(InvalidInput, match="Row 1"):
        Chunk(np.array([[0.0], [np.nan]]), 0.1)


def test_pictures_of_the_goal_are_made_as_large_too() -> None:
    shapes: list[tuple[int, ...]] = []

    def look(observation: Observation, instruction: str) -> np.ndarray:
        shapes.append(observation.goals["side"].shape)
        return np.zeros((1, 3))

    image = np.zeros((48, 64, 3), np.uint8)
    Resized(ScriptedPolicy(look, METADATA)).infer(Observation(images={"side": image}, goals={"side": image}))
    assert shapes == [(20, 20, 3)]
