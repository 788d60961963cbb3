"""A site says which devices are real; what it leaves out is simulated."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper
from rcs.errors import DeviceFault, InvalidSetup, UnknownName
from rcs.hardware import DeviceAddress, Driver, FakeDriver, Site
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND

HOME = np.array(FR3.home)


def home_arm(**options: Any) -> FakeArm:
    return FakeArm(FR3.arm_limits, start=HOME, **options)


def test_a_site_is_what_its_file_says(tmp_path: Path) -> None:
    site = Site(
        arms={"fr3": "fake:192.0.2.1"}, cameras={"wrist": {"driver": "fake", "options": {"a": 1}}}, stale_after=1.0
    )
    assert site.arms["fr3"] == DeviceAddress(driver="fake", address="192.0.2.1")
    site.write(tmp_path / "lab.json")
    assert Site.read(tmp_path / "lab.json") == site
    assert pickle.loads(pickle.dumps(site)) == site
    assert json.loads((tmp_path / "lab.json").read_text())["cameras"]["wrist"]["options"] == {"a": 1}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "cannot be read"),
        ('{"arm": {}}', "Valid fields"),
        ('{"arms": []}', "mapping"),
        ('{"arms": {"fr3": 3}}', "'fr3' is given as 3"),
        ('{"arms": {"fr3": {"adress": "x"}}}', "'driver', 'address'"),
        ('{"on_stale": "cry"}', "'flag', 'hold', 'fault'"),
        ('{"stale_after": 0}', "above 0"),
        ('{"stale_after": NaN}', "above 0"),
        ('{"stale_after": Infinity}', "above 0"),
        ('{"stale_after": true}', "above 0"),
        ('{"arms": {"fr3": {"driver": "fake", "address": 5}}}', "'fr3': The address of a device is 5; valid"),
        ('{"arms": {"fr3": {"driver": 5}}}', "'fr3': The driver of a device is 5"),
        ('{"arms": {"fr3": {"driver": "fake", "options": [1]}}}', "mapping from names to values"),
        ('{"arms": ' * 100_000, "cannot be read"),
        ('{"valid_for": 0}', "valid_for is 0 s"),
        ('{"arm_stale_after": -1}', "arm_stale_after is -1 s"),
        (
            '{"arms": {"left": "ur:192.0.2.1", "right": "ur:192.0.2.1"}}',
            "'left' and 'right' are both at ur:192.0.2.1; give 'right' its own",
        ),
        (
            '{"cameras": {"wrist": "v4l:0", "side": {"driver": "v4l", "address": "0", "options": {"x": 1}}}}',
            "'wrist' and 'side' are both at v4l:0",
        ),
    ],
)
def test_a_file_that_is_no_site_is_refused(text: str, match: str, tmp_path: Path) -> None:
    (tmp_path / "lab.json").write_text(text)
    with pytest.raises(InvalidSetup, match=match):
        Site.read(tmp_path / "lab.json")


def test_options_of_a_device_are_in_the_hash_of_its_site() -> None:
    def hash_of(**options: Any) -> str | None:
        arm = {"driver": f"{__name__}:WithOptions", "address": "a", "options": options}
        with rcs.make("Free", end_effector="none", hardware=Site(arms={"fr3": arm})) as env:
            return env.site

    assert hash_of() == hash_of()
    assert len({hash_of(), hash_of(mass=1.0), hash_of(mass=2.0), None}) == 4
    with rcs.make("Free") as env:
        assert env.site is None


def test_a_device_itself_goes_into_no_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="fr3"):
        Site(arms={"fr3": home_arm()}).write(tmp_path / "lab.json")


@pytest.mark.parametrize(
    ("hardware", "error", "match"),
    [
        ({"fr4": "fake"}, UnknownName, "Did you mean 'fr3'"),
        ({"fr3": "fack"}, UnknownName, "Did you mean 'fake'"),
        ("no.such.module:Driver", UnknownName, "driver"),
        (3, InvalidSetup, "hardware is 3"),
        (Site(hands={"fr3": "fake"}), InvalidSetup, "carries franka_hand"),
        (Site(arms={"left": "fake"}), UnknownName, "left"),
        ({"fr3": FakeArm(FR3.arm_limits.__class__([-1.0], [1.0], [1.0]))}, InvalidSetup, "1 joints"),
        ("nowhere.json", InvalidSetup, "cannot be read"),
        ({"fr3": FakeGripper()}, InvalidSetup, "Expected a device of rcs.devices.Arm"),
        ({"fr3": {"driver": "rcs.errors:WrongOrder"}}, InvalidSetup, "subclass of rcs.hardware.Driver"),
        ({"fr3": {"driver": "numpy:ndarray"}}, InvalidSetup, "subclass of rcs.hardware.Driver"),
        ("rcs.errors:WrongOrder:192.0.2.1", InvalidSetup, "subclass of rcs.hardware.Driver"),
        ("rcs.hardware.fake:FakeDrover:x", UnknownName, "Did you mean 'FakeDriver'"),
        (
            {"fr3": {"driver": "fake", "options": {"calibratoin": "x"}}},
            InvalidSetup,
            "no option of a fake device named",
        ),
        ({"fr3": {"driver": "sim", "options": {"dealy": 0.1}}}, InvalidSetup, "Did you mean 'delay'"),
        ({"fr3/gripper": {"driver": "sim", "options": {"delay": 0.1}}}, InvalidSetup, "no option of a fake device"),
    ],
)
def test_hardware_that_makes_no_sense_is_refused(hardware: Any, error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        rcs.make("Free", hardware=hardware)


def test_a_camera_or_tactile_sensor_has_no_host() -> None:
    given = {"driver": "fake", "options": {"host": "maybe"}}
    for site in (Site(cameras={"side": given}), Site(tactile={"fr3_left": given})):
        with pytest.raises(InvalidSetup, match="no option of a fake device named 'host'"):
            rcs.make("Free", cameras=("side",), tactile="digit", hardware=site)


def test_one_arm_is_not_two() -> None:
    with pytest.raises(InvalidSetup, match=r"'left' and 'right' are both at fake:192\.0\.2\.1"):
        rcs.make("Free", robot="dual_fr3", hardware="fake:192.0.2.1")
    arm = home_arm()
    with pytest.raises(InvalidSetup, match="'left' and 'right' are both the device"):
        Site(arms={"left": arm, "right": arm})
    assert Site(arms={"left": "fake", "right": "fake"}, grippers={"left": "fake:a"}, cameras={"wrist": "fake:a"})


@pytest.mark.parametrize(
    ("text", "driver", "address"),
    [
        ("fake", "fake", ""),
        ("fake:a:b", "fake", "a:b"),
        ("my_vendor:192.0.2.1:30004", "my_vendor", "192.0.2.1:30004"),
        ("rcs.hardware:FakeDriver", "rcs.hardware:FakeDriver", ""),
        ("rcs.hardware:FakeDriver:192.0.2.1:30004", "rcs.hardware:FakeDriver", "192.0.2.1:30004"),
        ("rcs.hardware.fake:FakeDriver:/dev/ttyACM0", "rcs.hardware.fake:FakeDriver", "/dev/ttyACM0"),
    ],
)
def test_a_class_in_a_module_is_a_driver_wherever_a_name_is(text: str, driver: str, address: str) -> None:
    assert DeviceAddress.parse(text, "fr3") == DeviceAddress(driver=driver, address=address)


class WithOptions(FakeDriver):
    """Takes any option."""

    def arm(self, address: str, about: Any, options: Any) -> FakeArm:
        return super().arm(address, about, {})


@pytest.mark.parametrize(("driver", "shared"), [("ur", {"host": False}), ("so101", {"host": False, "timeout": 0.5})])
def test_an_option_of_an_arm_is_its_grippers_where_the_driver_says_so(driver: str, shared: dict[str, Any]) -> None:
    given = {"driver": driver, "address": "a", "options": {"host": False, "timeout": 0.5}}
    site = Site.of({"fr3": given}, {"fr3": (FR3, FRANKA_HAND)})
    assert site.arms["fr3"] == DeviceAddress.parse(given, "fr3")
    assert site.grippers["fr3"] == DeviceAddress(driver=driver, address="a", options=shared)


class Bare(Driver):
    """Has nothing."""


class CountingDriver(FakeDriver):
    """Counts its objects."""

    made = 0

    def __init__(self) -> None:
        super().__init__()
        type(self).made += 1


def test_one_object_of_a_driver_makes_all_devices_of_a_site(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CountingDriver, "made", 0)
    name = f"{__name__}:CountingDriver"
    for count in (1, 2):
        rcs.make("Free", robot="dual_fr3", hardware={"left": f"{name}:a", "right": f"{name}:b"}).close()
        assert CountingDriver.made == count


def test_real_tactile_sensors_feel_in_the_place_of_simulated_ones() -> None:
    right = FakeCamera(rcs.devices.CameraMode(640, 480, 60.0))
    hardware = {"fr3": "fake:a", "fr3_left": "fake:D1", "fr3_right": right}
    with rcs.make("Free", tactile="digit", hardware=hardware, frequency=50) as env:
        simulated = rcs.make("Free", tactile="digit")
        assert env.observation_space["frames"] == simulated.observation_space["frames"]
        simulated.close()
        assert env.platform["fr3_left"] == "fake"
        assert not env.is_simulated
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation)
        *_, info = env.step({"joints": np.zeros(7), "gripper": np.ones(1)})
        assert {"frames/fr3_left", "frames/fr3_right"} <= info["ages"].keys()


def test_a_tactile_sensor_that_is_not_real_is_simulated() -> None:
    site = Site(tactile={"fr3_left": "fake:D1", "another": "fake:D2"})
    with rcs.make("Free", tactile="digit", hardware=site, frequency=50) as env:
        assert (env.platform["fr3_left"], env.platform["fr3_right"]) == ("fake", "simulation")
        observation, _ = env.reset(seed=0)
        assert list(observation["frames"]) == ["fr3_right", "fr3_left"]


def test_a_driver_says_what_it_does_not_have() -> None:
    with pytest.raises(InvalidSetup, match="Bare makes no arms"):
        Bare().arm("", FR3, {})
    with pytest.raises(InvalidSetup, match="Bare makes no tactile sensors"):
        rcs.make("Free", tactile="digit", hardware=Site(tactile={"fr3_left": f"{__name__}:Bare"}))
    assert FakeDriver().arm("a", FR3, {}).name == "a"


def test_nothing_is_connected_before_reset_and_nothing_moves_in_it() -> None:
    arm = home_arm()
    env = rcs.make("Free", hardware={"fr3": arm}, end_effector="none")
    assert not arm.is_open
    assert "fr3 7" in str(env.limits())
    observation, _ = env.reset(seed=0)
    assert arm.is_open
    np.testing.assert_array_equal(observation["joints"], HOME)
    env.close()
    assert not arm.is_open


def test_an_arm_moves_as_told_and_its_body_in_the_world_follows() -> None:
    env = rcs.make("Free", robot="dual_fr3", hardware={"left": "fake"}, frequency=100)
    right = {"right": "simulation", "right/franka_hand": "simulation"}
    assert env.platform == {"left": "fake", "left/franka_hand": "fake", **right}
    start, _ = env.reset(seed=0)
    step = {"joints": np.full(7, 0.005), "gripper": np.zeros(1, np.float32)}
    for _ in range(20):
        observation, *_ = env.step({"left": step, "right": step})
    left, right = (robot.joints for robot in env.simulation.robots)
    for side in ("left", "right"):
        assert np.abs(observation[side]["joints"] - start[side]["joints"] - 0.1).max() < 0.05
    assert np.abs(left - observation["left"]["joints"]).max() < 0.05
    assert np.abs(right - left).max() < 0.05
    env.close()


def test_synchronous_steps_are_not_mixed() -> None:
    with pytest.raises(InvalidSetup, match="realtime"):
        rcs.make("Free", robot="dual_fr3", hardware={"left": "fake"}, stepping="sync")


def test_a_fault_of_one_device_ends_the_episode_and_recover_brings_it_back() -> None:
    arm = home_arm()
    env = rcs.make("Free", hardware={"fr3": arm, "fr3/gripper": "fake"}, frequency=100)
    env.reset(seed=0)
    arm.trip("collision")
    *_, truncated, info = env.step(env.action_space.sample())
    assert truncated
    assert info["end"] == "fault"
    assert "collision" in info["faults"]["fake arm"]
    with pytest.raises(DeviceFault, match="collision"):
        env.reset(seed=0)
    env.recover()
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
