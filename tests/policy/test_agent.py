"""A policy in an environment: what it sees, and what its chunks come to."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from rcs_data import Dataset, DatasetWriter
from vlagents import Metadata, Observation, PartSpec
from vlagents.policies.scripted import ScriptedPolicy

import rcs
from rcs.envs import Env
from rcs.envs.layers import Layer
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup
from rcs.policy import NOTES, ChunkAgent, Execution, offer_of
from rcs.rollout import run_episode
from tests.policy.swing import GRIPPER, JOINTS, Swing, rollout


@pytest.mark.parametrize("mode", ["open_loop", "receding", "ensemble", "rtc"])
@pytest.mark.parametrize("rate", [5.0, 30.0])
def test_the_robot_follows_a_function_of_time_at_any_rate_of_the_policy(env: Env, mode: Any, rate: float) -> None:
    agent = ChunkAgent(env, Swing(rate=rate), execution=Execution(mode=mode))
    start, _ = env.reset(seed=0)
    for i, (action, _, _) in enumerate(rollout(env, agent, 30)):
        np.testing.assert_allclose(action["joints"], start["joints"] + 0.3 * (i + 1) / 30, atol=1e-5)


def test_differences_are_split_over_the_steps_of_a_faster_loop() -> None:
    with rcs.make("Free", robot="fr3", relative=True) as env:
        agent = ChunkAgent(env, Swing(rate=5.0, meaning="delta"))
        for action, _, _ in rollout(env, agent, 30):
            np.testing.assert_allclose(action["joints"], 0.01, atol=1e-9)


def test_a_policy_in_degrees_is_shown_degrees_and_gives_degrees(env: Env) -> None:
    policy = Swing(unit="deg")
    start, _ = env.reset(seed=0)
    rows = rollout(env, ChunkAgent(env, policy), 10)
    np.testing.assert_allclose(policy.seen[0].state["joints"], np.rad2deg(start["joints"]))
    np.testing.assert_allclose(rows[9][0]["joints"], start["joints"] + 0.1, atol=1e-5)


def test_the_policy_is_told_instruction_seed_and_time() -> None:
    with rcs.make("PickCuboid", robot="fr3", relative=False) as env:
        policy = Swing()
        rollout(env, ChunkAgent(env, policy), 10, seed=7)
        ((session, *told),) = policy.resets
        assert session.startswith("fr3 ")
        assert told == [env.instruction, 7]
        assert policy.seen[0].instruction == env.instruction
        assert [seen.time for seen in policy.seen] == pytest.approx([0.0, 8 / 30], abs=0.002)


def test_late_answers_hold_first_and_then_are_for_their_moment(env: Env) -> None:
    agent = ChunkAgent(env, Swing(), execution=Execution(latency=0.2))
    start, _ = env.reset(seed=0)
    for i, (action, _, notes) in enumerate(rollout(env, agent, 30)):
        expected = start["joints"] + (0.0 if i < 6 else 0.3 * (i + 1) / 30)
        np.testing.assert_allclose(action["joints"], expected, atol=1e-4)
        assert notes["policy_is_held"] == (i < 6)
        if i >= 6:
            assert notes["policy_latency"] == 0.2


def test_what_a_policy_wants_beyond_the_bounds_is_cut_and_noted(env: Env) -> None:
    far = ScriptedPolicy(lambda *_: np.full((4, 8), 50.0), Metadata(name="far", action=(JOINTS, GRIPPER), rate=30.0))
    rows = rollout(env, ChunkAgent(env, far), 3)
    box: Any = env.action_space["joints"]  # type: ignore[index]
    np.testing.assert_allclose(rows[0][0]["joints"], box.high)
    assert rows[0][2]["policy_is_clipped"] == 1.0


def test_a_policy_that_does_not_fit_is_refused_with_all_differences(env: Env) -> None:
    policy = Swing()
    policy.told = Metadata(
        name="other arm",
        state=(PartSpec("joints", 6, "rad"), PartSpec("tcp_wrench", 6)),
        action=(PartSpec("joints", 7, "ticks", "delta"),),
        rate=30.0,
    )
    with pytest.raises(InvalidSetup) as caught:
        ChunkAgent(env, policy)
    told = str(caught.value)
    for part in ("'other arm'", "size 6", "'tcp_wrench'", "'ticks'", "meaning 'delta'", "takes 'gripper'"):
        assert part in told, part


def test_an_instruction_that_is_given_is_enough_where_the_task_has_none(env: Env) -> None:
    policy = Swing()
    policy.told = replace(policy.told, needs_instruction=True)
    for none in (None, ""):
        with pytest.raises(InvalidSetup, match="instruction: the policy needs one"):
            ChunkAgent(env, policy, instruction=none)
    rollout(env, ChunkAgent(env, policy, instruction="swing"), 1)
    assert [words for _, words, _ in policy.resets] == ["swing"]
    assert offer_of(env, instruction="swing").has_instruction


def test_a_policy_that_needs_images_of_the_goal_is_refused_with_what_to_do(env: Env) -> None:
    policy = Swing()
    policy.told = replace(policy.told, needs_goal=True)
    with pytest.raises(InvalidSetup, match=r"- goal: .* none are sent here; call it from a program"):
        ChunkAgent(env, policy)


class Hide(Layer):
    """Hides what is measured."""

    key = "gripper"

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        return {key: space for key, space in inner.items() if key != self.key}

    def map_observation(self, observation: Any) -> Any:
        return {key: value for key, value in observation.items() if key != self.key}


class HideJoints(Hide):
    """Hides the joints."""

    key = "joints"


class HidePose(Hide):
    """Hides the pose."""

    key = "tquat"


def test_a_gripper_that_is_not_measured_starts_open_and_keeps_its_last_command() -> None:
    with rcs.make("Free", robot="fr3", relative=False, layers=(f"{__name__}:Hide",)) as env:
        assert "gripper" not in env.reset(seed=0)[0]
        policy = ScriptedPolicy(
            lambda seen, _: np.tile([*seen.state["joints"], 0.0], (4, 1)),
            Metadata(name="closes", state=(JOINTS,), action=(JOINTS, GRIPPER), rate=30.0, horizon=4),
        )
        agent = ChunkAgent(env, policy, execution=Execution(mode="open_loop", latency=0.1))
        grips = [float(action["gripper"][0]) for action, _, _ in rollout(env, agent, 6)]
        assert grips == [1.0] * 3 + [0.0] * 3


@pytest.mark.parametrize(
    ("control", "hidden", "named"),
    [("joints", "HideJoints", "joints"), ("tquat", "HidePose", "tquat"), ("xyzrpy", "HidePose", "tquat")],
)
def test_what_a_policy_starts_from_and_is_not_shown_is_a_difference(control: Any, hidden: str, named: str) -> None:
    options: dict[str, Any] = {"robot": "fr3", "control": control, "layers": (f"{__name__}:{hidden}",)}
    with rcs.make("Free", relative=False, **options) as env:
        needs = Metadata(name="unsure", action=offer_of(env).action, rate=30.0)
        with pytest.raises(InvalidSetup, match=f"'{control}' starts and holds .* does not show '{named}'"):
            ChunkAgent(env, ScriptedPolicy(lambda *_: 1 / 0, needs))
    with rcs.make("Free", relative=True, **options) as env:
        differences = replace(needs, action=offer_of(env).action)
        (action, _, _) = rollout(env, ChunkAgent(env, ScriptedPolicy(lambda *_: 1 / 0, differences)), 2)[-1]
        assert not np.any(action[control][:6]), "it holds by differences of nothing"


def test_the_same_seed_gives_the_same_bytes_with_latency_too(env: Env) -> None:
    digests = []
    for _ in range(2):
        agent = ChunkAgent(env, Swing(rate=20.0), execution=Execution(mode="rtc", latency=0.1))
        digest = hashlib.sha256()
        for action, observation, notes in rollout(env, agent, 40, seed=3):
            for value in (*action.values(), observation["joints"], np.array(list(notes.values()))):
                digest.update(value.tobytes())
        digests.append(digest.hexdigest())
    assert digests[0] == digests[1]


def test_latency_age_and_place_in_the_chunk_are_recorded(env: Env, tmp_path: Path) -> None:
    agent = ChunkAgent(env, Swing(), execution=Execution(latency=0.1))
    with DatasetWriter.open(tmp_path, dataset_info(env, notes=NOTES)) as writer:
        recorder = Recorder(writer)
        env.add_observer(recorder)
        recorder.name_next("one")
        run_episode(env, agent, seed=0, max_steps=25)
        recorder.finish(None)
    episode = Dataset.open(tmp_path).episodes[0]
    rows = {key: episode.column(f"notes/{key}") for key in NOTES}
    held = rows["policy_is_held"]
    age, row = rows["policy_age"], rows["policy_row"]
    assert held[1:4].tolist() == [1.0] * 3
    assert not held[4:].any()
    assert rows["policy_latency"][4:] == pytest.approx(0.1)
    assert row[4:] == pytest.approx(np.floor(age[4:] * 30 + 0.1))
    assert rows["policy_chunk"][-1] == 2.0


def test_both_arms_are_led_by_one_policy() -> None:
    sides = ("left", "right")
    state = tuple(PartSpec(f"{side}/joints", 7, "rad") for side in sides)
    action = tuple(part for side in sides for part in (PartSpec(f"{side}/joints", 7, "rad"), replace(
        GRIPPER, name=f"{side}/gripper")))  # fmt: skip

    def act(seen: Observation, _: str) -> np.ndarray:
        left, right = (seen.state[f"{side}/joints"] for side in sides)
        return np.tile([*(left + 0.05), 1.0, *(right - 0.05), 0.0], (8, 1))

    with rcs.make("LiftBar", robot="dual_fr3", relative=False) as env:
        policy = ScriptedPolicy(act, Metadata(name="both", state=state, action=action, rate=30.0, horizon=8))
        agent = ChunkAgent(env, policy)
        start, _ = env.reset(seed=0)
        rows = rollout(env, agent, 6)
        last = rows[-1][1]
        assert (last["left"]["joints"] - start["left"]["joints"] > 0.02).all()
        assert (last["right"]["joints"] - start["right"]["joints"] < -0.02).all()
        assert (rows[-1][0]["left"]["gripper"], rows[-1][0]["right"]["gripper"]) == (1.0, 0.0)
