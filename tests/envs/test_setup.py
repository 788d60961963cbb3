from __future__ import annotations

import dataclasses
import json
import pickle
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.robots.camera import CameraMount, looking
from rcs.sim.randomisation import Randomisation


def _made(control: Any, relative: Any, names: Any, image_size: Any, fps: Any, depth: bool, **options: Any) -> Setup:
    relative = "last_step" if control == "twist" else relative
    sizes = dict.fromkeys(names, image_size) if depth else image_size
    cameras = Cameras(names=names, image_size=sizes, fps=fps, depth=depth)
    return Setup(control=control, relative=relative, cameras=cameras, **options)


SETUPS = st.builds(
    _made,
    task=st.sampled_from(["PickCuboid", "Free"]),
    end_effector=st.none() | st.just("franka_hand") | st.just({"left": "robotiq_2f85"}),
    names=st.lists(st.sampled_from(["wrist", "side"]), unique=True).map(tuple),
    image_size=st.tuples(st.integers(1, 4096), st.integers(1, 4096)),
    fps=st.none() | st.floats(1.0, 90.0) | st.integers(1, 90),
    depth=st.booleans(),
    render_quality=st.sampled_from(["fast", "full"]),
    control=st.sampled_from(["joints", "tquat", "xyzrpy", "twist"]),
    relative=st.sampled_from(["last_step", "origin", "absolute"]),
    binary_gripper=st.booleans(),
    frequency=st.floats(0.1, 100.0),
    stepping=st.sampled_from(["async", "sync", "realtime"]),
    sync_time_limit=st.floats(0.1, 1000.0),
    max_episode_steps=st.none() | st.integers(1, 10**6),
    physics_step=st.floats(1e-4, 0.01),
    randomisation=st.none() | st.builds(Randomisation, friction=st.tuples(st.floats(0.1, 1.0), st.floats(1.0, 2.0))),
)


@settings(max_examples=100, deadline=None)
@given(setup=SETUPS)
def test_json_and_pickle_give_the_same_setup_back(setup: Setup) -> None:
    assert Setup.from_json(json.loads(json.dumps(setup.to_json(), allow_nan=False))) == setup
    assert pickle.loads(pickle.dumps(setup)) == setup
    assert hash(pickle.loads(pickle.dumps(setup))) == hash(setup)


def test_a_setup_is_frozen_and_changed_with_replace() -> None:
    setup = Setup()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setup.frequency = 10.0  # pyright: ignore[reportAttributeAccessIssue]
    assert dataclasses.replace(setup, frequency=10.0).frequency == 10.0
    with pytest.raises(InvalidSetup):
        dataclasses.replace(setup, frequency=0.0)


@pytest.mark.parametrize(("given", "relative"), [(True, "last_step"), (False, "absolute"), ("origin", "origin")])
def test_relative_may_be_a_boolean(given: Any, relative: str) -> None:
    assert Setup(relative=given).relative == relative


@pytest.mark.parametrize("relative", [False, "absolute", "origin"])
def test_a_twist_is_relative_to_nothing_else_than_the_last_target(relative: Any) -> None:
    with pytest.raises(InvalidSetup, match="always moves the last target; leave relative out"):
        Setup(control="twist", relative=relative)


@pytest.mark.parametrize(
    ("given", "ranges"),
    [
        (True, Randomisation()),
        (False, None),
        ({"friction": [0.5, 2.0]}, Randomisation.off(friction=(0.5, 2.0))),
        ("strong", Randomisation.of("strong")),
        ("none", None),
    ],
)
def test_randomisation_may_be_a_boolean_or_json(given: Any, ranges: Randomisation | None) -> None:
    assert Setup(randomisation=given).randomisation == ranges


def test_a_size_may_be_one_number() -> None:
    assert Cameras(image_size=96).image_size == (96, 96)
    assert Cameras(names=("wrist", "side"), image_size={"side": 96}).size_of("side") == (96, 96)
    assert Cameras(names=("wrist", "side"), image_size={"side": 96}).size_of("wrist") == (224, 224)


def test_a_camera_mode_sets_the_size() -> None:
    cameras = Cameras(mode="848x480")
    assert cameras.image_size == (848, 480)
    assert Cameras.from_json(json.loads(json.dumps(cameras.to_json()))) == cameras
    assert Cameras(mode="848x480", image_size=(848, 480)) == cameras
    with pytest.raises(InvalidSetup, match="give one of the two"):
        Cameras(mode="848x480", image_size=(84, 84))


def test_cameras_may_have_frame_rates_of_their_own() -> None:
    cameras = Cameras(names=("wrist", "side", "top"), fps={"wrist": 30, "side": 15.5})
    setup = Setup(cameras=cameras)
    assert [cameras.fps_of(name) for name in cameras] == [30, 15.5, None]
    assert Setup.from_json(json.loads(json.dumps(setup.to_json()))) == setup
    assert pickle.loads(pickle.dumps(setup)) == setup
    assert hash(pickle.loads(pickle.dumps(setup))) == hash(setup)
    assert Cameras(fps=30).fps_of("wrist") == 30
    assert Cameras().fps_of("wrist") is None


def test_a_frame_rate_for_a_camera_that_is_not_there_is_refused() -> None:
    with pytest.raises(InvalidSetup, match=r"fps names the cameras \['wirst'\]; this setup has \['wrist'\]"):
        Cameras(names=("wrist",), fps={"wirst": 30})


MOUNT = CameraMount(camera="realsense_d435", optical=looking((0.9, 0.0, 0.6), (0.4, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (("wrist", "side"), ("wrist", "side")),
        (["wrist"], ("wrist",)),
        ("wrist", ("wrist",)),
        ("all", ("all",)),
        (True, ("all",)),
        ("none", ()),
        (False, ()),
        (None, ()),
        ({"top": MOUNT}, ("top",)),
        (Cameras(names="wrist", mounts={"top": MOUNT}), ("wrist", "top")),
    ],
)
def test_cameras_have_short_forms(given: Any, names: tuple[str, ...]) -> None:
    setup = Setup(cameras=given)
    assert setup.cameras.names == names
    assert Setup.from_json(json.loads(json.dumps(setup.to_json()))) == setup


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fps": 10}, "Use frequency"),
        ({"gripper": "robotiq_2f85"}, "Use end_effector"),
        ({"num_envs": 4}, r"rcs\.make_vec\(task, copies="),
        ({"image_size": 64}, r"Use cameras=rcs\.Cameras\(image_size="),
        ({"camera_fps": 30}, r"Use cameras=rcs\.Cameras\(fps="),
        ({"seed": 1}, r"env\.reset\(seed="),
        ({"randomize": True}, "Use randomisation"),
        ({"control": "pose"}, "Use 'xyzrpy' or 'tquat'"),
        ({"control": "cartesian"}, "Use 'xyzrpy' or 'tquat'"),
        ({"control": "joint"}, "Did you mean 'joints'"),
    ],
)
def test_a_word_of_other_libraries_is_answered_with_the_one_here(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        Setup.from_json(options)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("mode", value) for value in ("large", "848", 848, (848, 480), "0x480", "9999x10")),
        *(
            ("image_size", value)
            for value in ({"wrist": 0}, {"wrist": (1, 2, 3)}, {3: 64}, {"wirst": 64}, [1], 0, -1, (224,), (1, 2, 3),
                          (0, 5), (5000, 5), 2.5, (2.5, 2.5), "224", True, None)
        ),
        *(("fps", value) for value in (0, -30, float("nan"), float("inf"), True, "30", [30], {"wrist": 0})),
        *(("depth", value) for value in (1, None, "yes")),
    ],
)  # fmt: skip
def test_a_value_of_cameras_that_makes_no_sense_is_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(InvalidSetup, match=field):
        Cameras(**{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("task", value) for value in (None, 3)),
        *(("robot", value) for value in (None, ["fr3"])),
        *(("end_effector", value) for value in (3, ("franka_hand",), {"left": 3}, {3: "none"})),
        *(("cameras", value) for value in (("wrist", "wrist"), (1,), 5)),
        *(("render_quality", value) for value in ("best", None, True)),
        *(("control", value) for value in ("joint", "", None, 7)),
        *(("relative", value) for value in ("last", None, 3)),
        *(("binary_gripper", value) for value in (1, None)),
        *(("frequency", value) for value in (0, -1.0, 501.0, float("nan"), float("inf"), "30", None, True)),
        *(("stepping", value) for value in ("fast", None)),
        *(("max_episode_steps", value) for value in (0, -5, 2.5, "10", True)),
        *(("randomisation", value) for value in (1.0, "yes", {"friktion": (1.0, 2.0)}, {"friction": 2.0})),
        *(("physics_step", value) for value in (0, -0.001, 0.02, float("nan"), "0.002", None)),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(InvalidSetup, match=field):
        Setup(**{field: value})


def test_an_unknown_field_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InvalidSetup) as caught:
        Setup.from_json({"frequenzy": 30.0})
    assert "frequenzy" in str(caught.value)
    assert "frequency" in str(caught.value)
