"""Copy i of a batch is, bit for bit, a single environment with the same seed."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import rcs
from rcs.agents import agent_for
from rcs.errors import InvalidAction, InvalidSetup, WrongOrder
from rcs.testing.env_contract import _spoil, require_same_bits

COPIES = 3
STEPS = 9
SETUPS: dict[str, dict[str, Any]] = {
    "relative joints": {"control": "joints"},
    "absolute joints": {"control": "joints", "relative": False},
    "relative poses": {"control": "tquat"},
    "absolute poses": {"control": "tquat", "relative": False},
    "relative roll-pitch-yaw": {"control": "xyzrpy"},
    "poses relative to an origin": {"control": "tquat", "relative": "origin"},
    "velocities": {"control": "twist"},
    "synchronous": {"control": "joints", "stepping": "sync"},
    "synchronous velocities": {"control": "twist", "stepping": "sync"},
}


def of_copy(tree: Any, copy: int) -> Any:
    """Return one copy's part of a batched observation."""
    return {key: of_copy(value, copy) for key, value in tree.items()} if isinstance(tree, dict) else tree[copy]


def require_same_info(batch: dict[str, Any], copy: int, single: dict[str, Any]) -> None:
    for key, value in single.items():
        assert batch[f"_{key}"][copy], key
        given = batch[key] if isinstance(value, dict) else batch[key][copy]
        if isinstance(value, dict):
            require_same_info(given, copy, value)
        else:
            np.testing.assert_array_equal(given, value, err_msg=key)


def make_pair(autoreset: AutoresetMode, threads: int, **options: Any) -> tuple[Any, list[Any]]:
    options = {"task": "PickCuboid", "max_episode_steps": 4, **options}
    envs = rcs.make_vec(copies=COPIES, threads=threads, autoreset=autoreset, **options)
    envs.action_space.seed(3)
    return envs, [rcs.make(**options) for _ in range(COPIES)]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", SETUPS)
def test_the_next_step_starts_a_new_episode(name: str, threads: int) -> None:
    envs, singles = make_pair(AutoresetMode.NEXT_STEP, threads, **SETUPS[name])
    observation, info = envs.reset(seed=11)
    is_done = [False] * COPIES
    for copy, single in enumerate(singles):
        first, told = single.reset(seed=11 + copy)
        require_same_bits(of_copy(observation, copy), first)
        require_same_info(info, copy, told)
    for step in range(STEPS):
        if step == 2:
            # One copy starts anew in between, so that episodes end at different times from here on.
            observation, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
            first, _ = singles[1].reset()
            require_same_bits(of_copy(observation, 1), first)
        actions = envs.action_space.sample()
        observation, reward, terminated, truncated, info = envs.step(actions)
        for copy, single in enumerate(singles):
            if is_done[copy]:
                first, _ = single.reset()
                expected: tuple[Any, ...] = (first, 0.0, False, False)
            else:
                *expected, told = single.step(of_copy(actions, copy))
                require_same_info(info, copy, told)
            given = (of_copy(observation, copy), float(reward[copy]), bool(terminated[copy]), bool(truncated[copy]))
            require_same_bits(given, tuple(expected))
            is_done[copy] = given[2] or given[3]
    for env in (envs, *singles):
        env.close()


@pytest.mark.parametrize("threads", [1, 2])
def test_the_same_step_starts_a_new_episode_and_keeps_the_end_of_the_last(threads: int) -> None:
    envs, singles = make_pair(AutoresetMode.SAME_STEP, threads)
    envs.reset(seed=11)
    for copy, single in enumerate(singles):
        single.reset(seed=11 + copy)
    ends = 0
    for _ in range(STEPS):
        actions = envs.action_space.sample()
        observation, reward, terminated, truncated, info = envs.step(actions)
        for copy, single in enumerate(singles):
            last, *expected, told = single.step(of_copy(actions, copy))
            require_same_bits((float(reward[copy]), bool(terminated[copy]), bool(truncated[copy])), tuple(expected))
            if expected[1] or expected[2]:
                ends += 1
                assert info["_final_obs"][copy]
                assert info["_final_info"][copy]
                require_same_bits(of_copy(info["final_obs"], copy), last)
                for key, value in told.items():
                    if key == "target":
                        for part, target in value.items():
                            np.testing.assert_array_equal(info["final_info"][key][part][copy], target)
                    elif key != "end":
                        np.testing.assert_array_equal(info["final_info"][key][copy], value)
                last, told = single.reset()
                assert not info["_target"][copy]
                assert not np.shares_memory(info["cuboid"], info["final_info"]["cuboid"])
            require_same_info(info, copy, told)
            require_same_bits(of_copy(observation, copy), last)
    assert ends == 2 * COPIES


@pytest.mark.parametrize("threads", [1, 2])
def test_without_autoreset_copies_wait_for_the_caller(threads: int) -> None:
    envs, singles = make_pair(AutoresetMode.DISABLED, threads)
    envs.reset(seed=11)
    for copy, single in enumerate(singles):
        single.reset(seed=11 + copy)
    for _ in range(4):
        actions = envs.action_space.sample()
        observation, _, _, truncated, _ = envs.step(actions)
        for copy, single in enumerate(singles):
            require_same_bits(of_copy(observation, copy), single.step(of_copy(actions, copy))[0])
    assert truncated.all()
    with pytest.raises(WrongOrder, match="reset_mask"):
        envs.step(actions)
    observation, _ = envs.reset(options={"reset_mask": truncated})
    for copy, single in enumerate(singles):
        require_same_bits(of_copy(observation, copy), single.reset()[0])


@pytest.mark.gl
def test_cameras_of_a_batch_see_what_those_of_single_environments_see() -> None:
    cameras = {"cameras": rcs.Cameras(names=("wrist", "side"), image_size=(24, 16), depth=True)}
    envs, singles = make_pair(AutoresetMode.NEXT_STEP, 2, **cameras)
    observation, _ = envs.reset(seed=5)
    assert "with cameras" in repr(envs)
    for copy, single in enumerate(singles):
        require_same_bits(of_copy(observation, copy), single.reset(seed=5 + copy)[0])
    actions = envs.action_space.sample()
    observation, *_ = envs.step(actions)
    for copy, single in enumerate(singles):
        require_same_bits(of_copy(observation, copy), single.step(of_copy(actions, copy))[0])
        single.close()
    envs.close()


def test_seeds_may_be_given_one_by_one() -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    by_number, _ = envs.reset(seed=[4, 9, 4])
    require_same_bits(of_copy(by_number, 0), of_copy(by_number, 2))


def test_a_copy_without_a_seed_of_its_own_goes_on_with_its_next_episode() -> None:
    envs, singles = make_pair(AutoresetMode.NEXT_STEP, 1)
    envs.reset(seed=[4, 9, 4])
    observation, _ = envs.reset(seed=[None, 7, None])
    for copy, (first, second) in enumerate([(4, None), (9, 7), (4, None)]):
        singles[copy].reset(seed=first)
        require_same_bits(of_copy(observation, copy), singles[copy].reset(seed=second)[0])
    other, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    other.reset(seed=[None, 7, None])


def test_a_masked_reset_is_of_the_copies_of_its_mask_alone() -> None:
    envs, singles = make_pair(AutoresetMode.DISABLED, 1)
    envs.reset(seed=[4, 9, 4])
    observation, info = envs.reset(seed=7, options={"reset_mask": np.array([True, False, False])})
    require_same_bits(of_copy(observation, 0), singles[0].reset(seed=7)[0])
    np.testing.assert_array_equal(info["_is_grasped"], [True, False, False])
    observation, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    singles[1].reset(seed=9)
    require_same_bits(of_copy(observation, 1), singles[1].reset()[0])


def test_after_a_masked_reset_the_other_copies_have_the_values_of_their_last_step() -> None:
    envs, (single, *_) = make_pair(AutoresetMode.DISABLED, 1, max_episode_steps=None)
    agent, (observation, told) = agent_for(single), single.reset(seed=3)
    agent.reset(observation, told)
    action: dict[str, Any] = {}
    for _ in range(200):
        action = dict(agent.act(observation, told))
        observation, *_, told = single.step(action)
        if told["is_grasped"]:
            break
    envs.reset(seed=0)
    envs.set_state(single.get_state())
    *_, last = envs.step({key: np.stack([value] * COPIES) for key, value in action.items()})
    assert last["is_grasped"].all()
    _, info = envs.reset(options={"reset_mask": np.array([True, False, False])})
    for key in ("success", "is_grasped", "is_touched", "cuboid", "edges", "time"):
        np.testing.assert_array_equal(info[key][1:], last[key][1:], err_msg=key)
        np.testing.assert_array_equal(info[f"_{key}"], [True, False, False])
    assert not info["is_grasped"][0]
    assert not info["is_touched"][0]


def test_a_mask_does_not_count_where_all_copies_have_to_start() -> None:
    envs, singles = make_pair(AutoresetMode.DISABLED, 1)
    observation, info = envs.reset(seed=7, options={"reset_mask": np.array([True, False, False])})
    for copy, single in enumerate(singles):
        first, told = single.reset(seed=7 + copy)
        require_same_bits(of_copy(observation, copy), first)
        require_same_info(info, copy, told)


def test_without_a_seed_every_start_is_another() -> None:
    first, second = (rcs.make_vec(copies=2) for _ in range(2))
    cuboids = [first.reset()[1]["cuboid"], first.reset()[1]["cuboid"], second.reset()[1]["cuboid"]]
    places = np.concatenate(cuboids)[:, :2]
    assert len(np.unique(places, axis=0)) == 6


@pytest.mark.parametrize("seed", [-1, [1, 2], [1, 2, -3], 2**70])
def test_wrong_seeds_are_refused(seed: Any) -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    with pytest.raises(InvalidSetup, match="eed"):
        envs.reset(seed=seed)


@pytest.mark.parametrize(
    "options",
    [
        {"reset_mask": np.zeros(COPIES, np.bool_)},
        {"reset_mask": np.ones(COPIES - 1, np.bool_)},
        {"reset_mask": np.ones(COPIES, np.int64)},
        {"no_such_option": 1},
    ],
)
def test_wrong_reset_options_are_refused(options: dict[str, Any]) -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    with pytest.raises(InvalidSetup, match="reset"):
        envs.reset(seed=0, options=options)


@pytest.mark.parametrize("value", [np.nan, np.inf, 100.0])
def test_a_bad_action_of_one_copy_moves_nothing_in_any_copy(value: float) -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    envs.reset(seed=0)
    before = envs.simulation.world.states().copy()
    actions = envs.action_space.sample()
    actions["joints"][1, 4] = value
    with pytest.raises(InvalidAction, match=r"'joints'\[1, 4\]"):
        envs.step(actions)
    np.testing.assert_array_equal(envs.simulation.world.states(), before)
    with pytest.raises(InvalidAction, match=r"shape \(7,\); valid is \(3, 7\)"):
        envs.step({**actions, "joints": np.zeros(7)})


def test_a_copy_that_diverges_is_truncated_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    envs, singles = make_pair(AutoresetMode.NEXT_STEP, 2)
    envs.reset(seed=11)
    for copy, single in enumerate(singles):
        single.reset(seed=11 + copy)
    envs.simulation.world.qvel[1, 0] = np.nan
    for step in range(3):
        actions = envs.action_space.sample()
        observation, reward, terminated, truncated, info = envs.step(actions)
        if step == 0:
            np.testing.assert_array_equal(info["end"] == "diverged", [False, True, False])
            assert -0.01 <= reward[1] <= 0.0, "it keeps its potential, and pays for the time"
        else:
            assert not (info["end"] == "diverged").any()
        np.testing.assert_array_equal(truncated, [False, step == 0, False])
        assert not terminated.any()
        assert envs.observation_space.contains(observation)
        for copy in (0, 2):
            require_same_bits(of_copy(observation, copy), singles[copy].step(of_copy(actions, copy))[0])


def test_calls_at_the_wrong_time_are_refused() -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    actions = envs.action_space.sample()
    with pytest.raises(WrongOrder, match="before the first reset"):
        envs.step(actions)
    envs.reset(seed=0)
    envs.close()
    envs.close()
    with pytest.raises(WrongOrder, match="closed"):
        envs.step(actions)
    with pytest.raises(WrongOrder, match="closed"):
        envs.reset()


def test_writing_to_what_a_batch_returns_changes_nothing() -> None:
    runs = []
    for is_spoiled in (False, True):
        envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
        envs.reset(seed=2)
        for _ in range(6):
            observation, *_, info = envs.step(envs.action_space.sample())
            if is_spoiled:
                _spoil({"observation": observation, "info": info})
        runs.append(envs.step(envs.action_space.sample()))
    require_same_bits(*runs)


def test_a_printed_batch_shows_its_stack() -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    text = str(envs)
    for part in ("PickCuboid", "3 copies", "LimitStep", "Relative", "SimArmPort"):
        assert part in text
    assert "3 copies" in repr(envs)


@pytest.mark.parametrize("seed", [[1.5, 2.0, 3.0], ["1", "2", "3"], "123", 1.0, [1, 2], 2**63 - 2, [1, 2, -1]])
def test_seeds_that_are_no_whole_numbers_in_range_are_refused(seed: Any) -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    with pytest.raises(InvalidSetup, match="seed"):
        envs.reset(seed=seed)


def test_seeds_may_be_integers_of_numpy() -> None:
    envs, _ = make_pair(AutoresetMode.NEXT_STEP, 1)
    by_array, _ = envs.reset(seed=np.array([4, 5, 6]))
    by_number, _ = envs.reset(seed=np.int64(4))
    require_same_bits(by_array, by_number)


def test_actions_refused_again_and_again_change_nothing() -> None:
    envs, other = (rcs.make_vec("LiftBar", robot="dual_fr3", copies=2) for _ in range(2))
    for each in (envs, other):
        each.action_space.seed(1)
        each.reset(seed=1)
    for _ in range(3):
        bad = envs.action_space.sample()
        other.action_space.sample()
        bad["right"]["joints"][1, 2] = np.nan
        for _ in range(8):
            with pytest.raises(InvalidAction, match="right"):
                envs.step(bad)
        require_same_bits(envs.step(envs.action_space.sample())[:4], other.step(other.action_space.sample())[:4])


@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyboardInterrupt], ids=["error", "Ctrl-C"])
def test_after_an_error_in_a_step_all_copies_start_anew(kind: type[BaseException]) -> None:
    envs, other = (rcs.make_vec("PickCuboid", copies=2) for _ in range(2))

    def fail() -> Any:
        raise kind("a bug")

    envs.reset(seed=1)
    real, envs.simulation.task.evaluate = envs.simulation.task.evaluate, fail
    with pytest.raises(kind):
        envs.step(envs.action_space.sample())
    envs.simulation.task.evaluate = real
    with pytest.raises(WrongOrder, match=kind.__name__):
        envs.step(envs.action_space.sample())
    require_same_bits(envs.reset(seed=5)[0], other.reset(seed=5)[0])
    envs.step(envs.action_space.sample())


def test_two_threads_in_one_batch_are_told_apart() -> None:
    envs = rcs.make_vec("PickCuboid", copies=2)
    envs.reset(seed=1)
    refused: list[BaseException] = []
    evaluate = envs.simulation.task.evaluate

    def step_in_another_thread() -> Any:
        def step() -> None:
            with pytest.raises(WrongOrder, match="another thread") as caught:
                envs.step(envs.action_space.sample())
            refused.append(caught.value)

        thread = threading.Thread(target=step)
        thread.start()
        thread.join(10)
        return evaluate()

    envs.simulation.task.evaluate = step_in_another_thread
    envs.step(envs.action_space.sample())
    assert len(refused) == 1


def test_an_error_while_a_copy_starts_anew_breaks_all_episodes_off(monkeypatch: pytest.MonkeyPatch) -> None:
    envs = rcs.make_vec("Free", copies=2, max_episode_steps=1, autoreset="SameStep")
    envs.reset(seed=0)
    with monkeypatch.context() as broken:

        def fail(*_: Any) -> None:
            raise OSError("no answer")

        broken.setattr(envs.simulation, "begin", fail)
        with pytest.raises(OSError, match="no answer"):
            envs.step(envs.action_space.sample())
    with pytest.raises(WrongOrder, match="OSError broke the episode off"):
        envs.step(envs.action_space.sample())
    envs.reset()
    envs.step(envs.action_space.sample())
