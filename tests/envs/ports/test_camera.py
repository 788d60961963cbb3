"""Real cameras run on threads of their own: a step gets the newest frames with their ages, and learns of stalls."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.files.flags import FrameFlag

import rcs
from rcs.devices import CameraMode, Frame
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper
from rcs.envs.observers.record import record
from rcs.envs.ports.camera import CameraPort, cropped, intrinsics_of
from rcs.errors import DeviceFault, InvalidSetup, MissingDependency
from rcs.hardware import Site
from rcs.hardware.usb import Plug, UsbDevice
from rcs.robots.cameras import REALSENSE_D435
from rcs.setups.lab import lab_of

SIZE = (64, 48)


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end, "waited for 20 s"
        time.sleep(0.01)


def make(camera: FakeCamera, *, on_stale: Any = "fault", stale_after: float = 0.3, **options: Any) -> Any:
    site = Site(
        arms={"fr3": "fake"},
        grippers={"fr3": "fake"},
        cameras={"side": camera},
        on_stale=on_stale,
        stale_after=stale_after,
    )
    return rcs.make(
        "Free", cameras=rcs.Cameras(names=("side",), image_size=SIZE), hardware=site, frequency=100.0, **options
    )


@pytest.fixture
def camera() -> FakeCamera:
    return FakeCamera(CameraMode(640, 480, 30.0, False), name="side")


def stay(env: Any) -> dict[str, Any]:
    return {"joints": np.zeros(7), "gripper": np.ones(1, np.float32)}


def test_a_frame_that_is_seen_again_is_the_same_read_only_array(camera: FakeCamera) -> None:
    env = make(camera)
    observation, _ = env.reset(seed=0)
    frames = [observation["frames"]["side"]["rgb"]]
    for _ in range(30):
        observation, *_, info = env.step(stay(env))
        assert env.observation_space.contains(observation)
        frames.append(observation["frames"]["side"]["rgb"])
        assert 0.0 <= info["ages"]["frames/side"] < 0.3
    assert not frames[0].flags.writeable
    kinds = len({id(frame) for frame in frames})
    assert 1 < kinds < len(frames), "some frames are new and some are seen again"
    env.close()
    assert not camera.is_open


def test_only_the_thread_of_a_camera_replaces_its_frames_once_it_is_read(camera: FakeCamera) -> None:
    env = make(camera, on_stale="flag", stale_after=60.0)
    env.reset(seed=0)
    (feed,) = (feed for port in env.stack.ports if isinstance(port, CameraPort) for feed in port._feeds.values())
    camera.lose_link()
    wait_for(lambda: bool(feed.failure))
    newest = feed.newest
    env.reset(seed=1)
    assert feed.newest is newest
    env.close()


def test_a_camera_that_stalls_ends_the_episode(camera: FakeCamera) -> None:
    env = make(camera, on_stale="fault")
    env.reset(seed=0)
    camera.freeze()
    info: dict[str, Any] = {}
    for _ in range(200):
        *_, truncated, info = env.step(stay(env))
        if truncated:
            break
    assert info["end"] == "fault"
    assert "no new frame" in info["faults"]["side"]
    with pytest.raises(DeviceFault, match="no new frame"):
        env.reset(seed=0)
    env.close()


def test_a_camera_that_stalls_has_all_devices_hold_until_it_goes_on(camera: FakeCamera) -> None:
    env = make(camera, on_stale="hold")
    env.reset(seed=0)
    camera.lose_link()
    go = {"joints": np.full(7, 0.01), "gripper": np.ones(1, np.float32)}
    wait_for(lambda: "refused" in env.step(go)[-1])
    for _ in range(5):
        *_, info = env.step(go)
        assert "side" in info["refused"]
    before = env.step(go)[0]["joints"]
    np.testing.assert_allclose(env.step(go)[0]["joints"], before, atol=1e-9)
    camera.restore()
    wait_for(lambda: "refused" not in env.step(stay(env))[-1])
    env.close()


def test_a_camera_that_cannot_be_opened_again_says_why(camera: FakeCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.RECONNECT", 0.01)

    class Portless(FakeCamera):
        def _open(self) -> None:
            if not self.body.has_link:
                raise OSError("no such port")

    portless = Portless(camera.mode, name="side")
    env = make(portless, stale_after=0.5)
    env.reset(seed=0)
    portless.lose_link()
    told: list[str] = []
    wait_for(lambda: bool(told.append(str(env.step(stay(env))[-1].get("faults", ""))) or told[-1]))
    assert "no such port" in told[-1]
    env.close()


def test_a_camera_that_stalls_can_only_be_flagged(camera: FakeCamera, tmp_path: Path) -> None:
    env = make(camera, on_stale="flag", stale_after=0.05)
    with record(env, tmp_path / "takes") as takes:
        takes.start(at_reset=True)
        env.reset(seed=0)
        camera.freeze()
        wait_for(lambda: env.step(stay(env))[-1]["ages"]["frames/side"] > 0.1)
        takes.finish(None)
    env.close()
    episode = Dataset.open(tmp_path / "takes").episodes[0]
    assert FrameFlag.STALE in FrameFlag(int(episode.column("flags/frames/side")[-1]))
    assert episode.info.origin["platform"] == {"fr3": "fake", "fr3/franka_hand": "fake", "side": "FakeCamera"}
    assert np.isfinite(episode.column("time/joints")).all()


def test_without_a_first_frame_nothing_stays_open(camera: FakeCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.FIRST_FRAME", 0.2)

    class Dark(FakeCamera):
        def _read(self) -> Frame:
            raise OSError("no picture")

    dark = Dark(camera.mode, name="side")
    env = make(dark)
    with pytest.raises(DeviceFault, match=r"'side' has given no frame.*read failed: OSError: no picture"):
        env.reset(seed=0)
    assert not dark.is_open
    assert all(port.device is None or not port.device.is_open for port in env.stack.ports)
    env.close()


class StuckCamera(FakeCamera):
    """A camera whose driver does not return from a call, until it is told to."""

    def __init__(self, size: tuple[int, int] = (640, 480), fps: float = 30.0) -> None:
        super().__init__(CameraMode(*size, fps, False), name="side")
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.opens = threading.Event()
        self.opens.set()

    def _open(self) -> None:
        self.opens.wait(60.0)

    def _read(self) -> Frame:
        self.goes_on.wait(60.0)
        return super()._read()


@pytest.fixture
def stuck(monkeypatch: pytest.MonkeyPatch) -> Iterator[StuckCamera]:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.FIRST_FRAME", 0.3)
    monkeypatch.setattr("rcs.envs.ports.camera_thread.LONGEST_CALL", 0.2)
    camera = StuckCamera()
    yield camera
    camera.goes_on.set()
    camera.opens.set()
    wait_for(lambda: "camera side" not in [thread.name for thread in threading.enumerate()])
    assert not camera.is_open


def no_arm_is_open(env: Any) -> bool:
    return all(getattr(port, "device", None) is None or not port.device.is_open for port in env.stack.ports)


def test_a_camera_that_does_not_return_keeps_nobody_from_closing(
    stuck: StuckCamera, caplog: pytest.LogCaptureFixture
) -> None:
    env = make(stuck)
    env.reset(seed=0)
    stuck.goes_on.clear()
    wait_for(lambda: env.step(stay(env))[3])
    begin = time.monotonic()
    env.close()
    env.close()
    assert time.monotonic() - begin < 20.0
    assert no_arm_is_open(env)
    assert "camera side has not returned" in caplog.text
    assert stuck.is_open, "its thread has it until the call returns"


def test_cameras_that_never_return_keep_close_waiting_for_a_second_and_a_half_in_all() -> None:
    cameras = {"wrist": StuckCamera((848, 480)), "side": StuckCamera()}
    skin = StuckCamera((320, 240), 60.0)
    site = Site(arms={"fr3": "fake"}, grippers={"fr3": "fake"}, cameras=cameras, tactile={"fr3_left": skin})
    sizes = {"wrist": (424, 240), "side": (64, 48)}
    env = rcs.make("Free", cameras=rcs.Cameras(names=tuple(cameras), image_size=sizes), hardware=site, tactile="digit")
    observation, _ = env.reset(seed=0)
    assert {name: frame["rgb"].shape for name, frame in observation["frames"].items() if name in sizes} == {
        "wrist": (240, 424, 3),
        "side": (48, 64, 3),
    }
    every = [*cameras.values(), skin]
    for camera in every:
        camera.goes_on.clear()
    wait_for(lambda: env.step(stay(env))[3])
    begin = time.monotonic()
    env.close()
    assert time.monotonic() - begin < 1.5
    for camera in every:
        camera.goes_on.set()
    wait_for(lambda: not any(camera.is_open for camera in every))


def test_a_recording_says_how_its_devices_measured(camera: FakeCamera, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.RECONNECT", 0.01)
    env = make(camera, on_stale="flag")
    with record(env, tmp_path / "takes") as takes:
        takes.start(at_reset=True)
        env.reset(seed=0)
        for _ in range(100):
            env.step(stay(env))
        camera.lose_link()
        wait_for(lambda: env.step(stay(env))[-1]["ages"]["frames/side"] > 0.2)
        camera.restore()
        wait_for(lambda: env.step(stay(env))[-1]["ages"]["frames/side"] < 0.05)
        takes.finish(None)
    env.close()
    episode = Dataset.open(tmp_path / "takes").episodes[0]
    side, joints = (episode.timing["devices"][key] for key in ("frames/side", "joints"))
    assert 0 < side["rate"] < 31 and side["gaps"] > 0 and side["repeats"] > 50
    assert 0 <= side["age_p50"] <= side["age_p99"] <= side["age_max"] and side["age_max"] > 0.2
    assert abs(joints["clock"]["drift"]) < 0.01, "the fake's own clock is the host's"
    assert np.isfinite(episode.column("time/device/joints")).all()
    assert episode.outcome["reconnections"]["frames/side"] >= 1


@pytest.mark.parametrize("call", ["opens", "goes_on"])
def test_a_first_call_that_does_not_return_leaves_no_arm_open(stuck: StuckCamera, call: str) -> None:
    getattr(stuck, call).clear()
    env = make(stuck)
    for words in ("has given no frame within 0.3 s", "still in a call of its driver"):
        with pytest.raises(DeviceFault, match=words):
            env.reset(seed=0)
        assert no_arm_is_open(env)
    getattr(stuck, call).set()
    wait_for(lambda: "camera side" not in [thread.name for thread in threading.enumerate()])
    env.reset(seed=0)
    assert env.step(stay(env))[-1]["ages"]["frames/side"] < 20.0
    env.close()


def test_why_a_camera_cannot_be_opened_is_what_reset_raises(camera: FakeCamera) -> None:
    class Unplugged(FakeCamera):
        def _open(self) -> None:
            raise OSError("no such camera")

    env = make(Unplugged(camera.mode, name="side"))
    with pytest.raises(DeviceFault, match=r"'side' cannot be opened: .*open failed: OSError: no such camera"):
        env.reset(seed=0)
    assert no_arm_is_open(env)
    env.close()


def test_two_cameras_that_are_one_device_are_refused_before_any_device_is_opened(
    camera: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Plugged(FakeCamera):
        def plug(self) -> Plug:
            return Plug(device=UsbDevice(path="1-2", serial="A1", speed=480), needs=1)

    opened: list[str] = []
    for kind in (FakeArm, FakeGripper, FakeCamera):
        monkeypatch.setattr(kind, "_open", lambda self: opened.append(self.name))
    cameras = {"wrist": Plugged(CameraMode(848, 480, 30.0, False)), "side": Plugged(camera.mode)}
    asked = rcs.Cameras(names=tuple(cameras), image_size={"wrist": (424, 240), "side": SIZE})
    site = Site(arms={"fr3": "fake"}, grippers={"fr3": "fake"}, cameras=cameras)
    with (
        rcs.make("Free", cameras=asked, hardware=site) as env,
        pytest.raises(InvalidSetup, match=r"'wrist' and 'side' are both a device \(A1\)"),
    ):
        env.reset(seed=0)
    assert opened == []


@pytest.mark.parametrize("kind", [InvalidSetup, MissingDependency])
def test_a_mode_or_control_that_a_camera_lacks_is_no_fault(camera: FakeCamera, kind: type[Exception]) -> None:
    class Lacking(FakeCamera):
        def _open(self) -> None:
            raise kind("it has 640x480 at 30")

    env = make(Lacking(camera.mode, name="side"))
    for _ in range(2):
        with pytest.raises(kind, match="it has 640x480 at 30"):
            env.reset(seed=0)
        assert no_arm_is_open(env)
    env.close()


@pytest.mark.parametrize("ahead", [3600.0, 1.7e9, np.inf])
def test_frames_from_the_future_are_a_fault_and_not_fresh_for_ever(
    monkeypatch: pytest.MonkeyPatch, camera: FakeCamera, ahead: float
) -> None:
    class Stamping(FakeCamera):
        ahead = 0.0

        def _read(self) -> Frame:
            frame = super()._read()
            return Frame(frame.rgb, number=frame.number, time=time.monotonic() + self.ahead)

    monkeypatch.setattr("rcs.envs.ports.camera_thread.FIRST_FRAME", 0.3)
    stamping = Stamping(camera.mode, name="side")
    env = make(stamping, max_episode_steps=None)
    env.reset(seed=0)
    stamping.ahead = ahead
    infos: list[dict[str, Any]] = []
    wait_for(lambda: (infos.append(env.step(stay(env))[-1]), infos[-1]["end"] == "fault")[1])
    assert "ahead of the host's monotonic clock" in infos[-1]["faults"]["side"]
    env.close()
    with pytest.raises(DeviceFault, match="ahead of the host's monotonic clock"):
        make(stamping).reset(seed=0)


@pytest.mark.parametrize("size", [(640, 480), (320, 240), (224, 224), (64, 48)])
def test_cut_and_scaled_frames_have_the_matrix_of_simulated_ones(size: tuple[int, int]) -> None:
    camera = FakeCamera(CameraMode(640, 480, 30.0, False))
    expected = REALSENSE_D435.intrinsics(*size)
    np.testing.assert_allclose(intrinsics_of(camera, REALSENSE_D435, size).matrix, expected, rtol=0.01)
    rows, columns = cropped((640, 480), size)
    assert (columns.stop - columns.start) / (rows.stop - rows.start) == pytest.approx(size[0] / size[1], rel=0.01)


def test_of_frames_of_another_shape_it_says_where_its_figures_are_from() -> None:
    of_the_lab = lab_of("fr3").cameras["wrist"].calibration
    with pytest.raises(InvalidSetup) as told:
        intrinsics_of(FakeCamera(CameraMode(640, 480, 30.0, False)), REALSENSE_D435, (640, 480), of_the_lab)
    assert "was calibrated" not in str(told.value)
    for words in ("848 x 480 px", "640 x 480 px", "data sheet", "calibrate"):
        assert words in str(told.value)


@pytest.mark.gl
def test_matrices_are_those_of_the_simulated_cameras() -> None:
    options: dict[str, Any] = {"cameras": rcs.Cameras(names=("wrist", "side"), image_size=(320, 240))}
    real = rcs.make("Free", hardware={"fr3": "fake", "wrist": "fake", "side": "fake"}, **options)
    simulated = rcs.make("Free", **options)
    assert real.observation_space == simulated.observation_space
    measured, _ = real.reset(seed=0)
    drawn, _ = simulated.reset(seed=0)
    for name in options["cameras"]:
        for key in ("intrinsics", "extrinsics"):
            np.testing.assert_allclose(
                measured["frames"][name][key], drawn["frames"][name][key], atol=1e-6, err_msg=f"{name} {key}"
            )
    real.close()
    simulated.close()
