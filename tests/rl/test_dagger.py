"""A student sees what its setup observes and no more, learns from its teacher, and goes on from where it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, UnknownName
from rcs.rl import Dagger, Training

SETUP = Setup(
    task="PickCuboid", frequency=10.0, max_episode_steps=60, layers=("ObserveTarget",), collision_reaction=False
)
QUICK: dict[str, Any] = {"n_steps": 8, "warm_up": 64, "batch_size": 32, "gradient_steps": 4, "network": (32,)}
TRAINING = Training(
    setup=replace(SETUP, observe=("privileged",)),
    copies=4,
    steps=320,
    algorithm=Dagger(**QUICK),
    episodes=0,
    torch_threads=1,
)
CAMERAS = replace(SETUP, cameras=Cameras(names=("wrist", "side"), image_size=64))


def learner(training: Training = TRAINING) -> Any:
    import torch  # pyright: ignore[reportMissingImports]

    from rcs.rl.train import learner_for

    torch.set_num_threads(1)
    return learner_for(training, threads=1)


def weights(made: Any) -> dict[str, np.ndarray]:
    return {name: value.numpy().copy() for name, value in made.weights().items()}


@pytest.mark.extras
@pytest.mark.gl
def test_a_student_with_cameras_sees_nothing_that_only_its_teacher_sees() -> None:
    import rcs
    from rcs.rl import Flat

    made = learner(replace(TRAINING, setup=CAMERAS, steps=96))
    tested = rcs.make(CAMERAS)
    assert not {"privileged", "is_grasped", "finger_contacts"} & {
        entry.key.partition("/")[0] for entry in made.flat.layout.state
    }
    assert made.flat.layout == Flat(tested).layout
    while not made.is_done:
        made.advance()
    assert made.figures()["train/loss"] > 0.0


@pytest.mark.extras
def test_what_the_setup_observes_is_seen_by_the_student_too() -> None:
    names = {entry.key.partition("/")[0] for entry in learner().flat.layout.state}
    assert "privileged" in names
    assert "is_grasped" not in names


@pytest.mark.extras
def test_it_fits_its_teacher_better_and_better() -> None:
    training = replace(TRAINING, algorithm=Dagger(**{**QUICK, "gradient_steps": 40}, fade=None), steps=480)
    made = learner(training)
    losses: list[float] = []
    while not made.is_done:
        made.advance()
        losses += [made.figures().get("train/loss", np.inf)]
    assert losses[-1] < 0.5 * next(loss for loss in losses if np.isfinite(loss))


@pytest.mark.extras
def test_in_behaviour_cloning_the_teacher_acts_all_the_time_and_in_dagger_ever_less() -> None:
    shares: dict[float | None, list[float]] = {None: [], 0.5: []}
    for fade, seen in shares.items():
        made = learner(replace(TRAINING, algorithm=Dagger(**QUICK, fade=fade)))
        while not made.is_done:
            made.advance()
            seen.append(made.figures()["train/teacher_share"])
    assert set(shares[None]) == {1.0}
    assert shares[0.5] == sorted(shares[0.5], reverse=True)
    assert shares[0.5][0] == pytest.approx(1 - 32 / 160)
    assert shares[0.5][-1] == 0.0


@pytest.mark.extras
def test_it_goes_on_from_its_state_to_the_same_weights_bit_for_bit() -> None:
    from rcs.rl.checkpoint import packed, unpacked

    first = learner()
    for _ in range(5):
        first.advance()
    stored = [unpacked(packed(part), Path("it")) for part in (first.weights(), first.state())]
    row, end, rows = first.replay_piece(0)
    assert (row, end) == (0, 40)
    pieces = [unpacked(packed({name: own[:24] for name, own in rows.items()}), Path("it"))]
    pieces += [{name: own[24:].copy() for name, own in rows.items()}]
    second = learner()
    second.load(*stored, pieces)
    assert second.steps == first.steps
    for made in (first, second):
        while not made.is_done:
            made.advance()
    for name, value in weights(first).items():
        np.testing.assert_array_equal(weights(second)[name], value)


@pytest.mark.extras
def test_its_checkpoint_acts_as_the_student_and_a_checkpoint_may_be_a_teacher(tmp_path: Path) -> None:
    import rcs
    from rcs.rl import PolicyAgent, train

    for _ in train(TRAINING, tmp_path / "run", threads=1, videos=False):
        pass
    agent = PolicyAgent.load(tmp_path / "run")
    env = rcs.make(TRAINING.setup)
    observation, info = env.reset(seed=0)
    agent.reset(observation, info)
    assert env.action_space.contains(agent.act(observation, info))
    taught = learner(replace(TRAINING, algorithm=Dagger(**QUICK, teacher=str(tmp_path / "run"))))
    taught.advance()
    assert taught.steps == 32


@pytest.mark.extras
def test_a_teacher_that_is_none_is_refused() -> None:
    with pytest.raises(UnknownName, match="PickTeacher"):
        learner(replace(TRAINING, algorithm=Dagger(**QUICK, teacher="PickTeachr")))
    with pytest.raises(InvalidSetup, match="control='xyzrpy'"):
        learner(replace(TRAINING, setup=replace(TRAINING.setup, control="xyzrpy")))


def test_records_of_teaching_survive_json_and_refuse_what_makes_no_sense() -> None:
    for algorithm in (Dagger(fade=0.3, channels=(4, 8, 8)), Dagger(fade=None)):
        training = replace(TRAINING, algorithm=algorithm)
        assert Training.from_json(training.to_json()) == training
    for wrong in ({"fade": 1.5}, {"channels": (8, 16)}, {"network": (0,)}, {"teacher": 3}, {"warm_up": 0}):
        with pytest.raises(InvalidSetup, match=next(iter(wrong))):
            Dagger(**wrong)  # type: ignore[arg-type]
