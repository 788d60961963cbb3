"""Leader arms, over serial lines to servos in processes of their own."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import DeviceFault, InvalidSetup, Refused
from rcs.robots.fr3 import FR3
from rcs.robots.so101 import SO101
from rcs.teleop.gello import Answers, DynamixelBus, checksum, gello, packet
from rcs.teleop.leader import LeaderCalibration, calibrate_leader
from rcs.teleop.so101_leader import So101Bus, so101_leader, uncalibrated
from tests.teleop.leaders import COUNTS, STEP, Bus, bus_of, calibrated, leader_at, saved

# They need pyserial and Feetech's library, which `make test-hardware` installs.
pytestmark = pytest.mark.hardware
pytest.importorskip("serial", reason="serial lines need pyserial: pip install 'robot-control-stack[leader]'")
pytest.importorskip("scservo_sdk", reason="an SO101 needs feetech-servo-sdk: pip install 'robot-control-stack[leader]'")


@pytest.fixture
def feetech() -> Iterator[Bus]:
    with bus_of("feetech", 6) as bus:
        yield bus


@pytest.fixture
def dynamixel() -> Iterator[Bus]:
    with bus_of("dynamixel", 8) as bus:
        yield bus


def joints_of(device: Any) -> np.ndarray:
    return device.read().hands["right"].joints


def test_an_so101_leader_says_its_joints_and_is_without_torque(feetech: Bus) -> None:
    with so101_leader(feetech.path) as device:
        device.open()
        feetech.put(2048, 2148, 1948, 2048, 3071, 2048)
        reading = device.read()
        hand = reading.hands["right"]
        middle = 2047.5
        assert hand.joints == pytest.approx([0.0, 100 * STEP, -100 * STEP, 0.0, (3071 - middle) * STEP], abs=1e-9)
        assert hand.opening == pytest.approx(0.5)
        assert hand.pose is None and hand.twist is None
        assert set(feetech.tell()["torque"].values()) == {False}
        assert device.hands == ("right",) and not device.has_clutch and device.motion == ("joints", 5)
        assert device.read().time > reading.time


def test_a_leader_is_read_a_hundred_times_a_second(feetech: Bus) -> None:
    with so101_leader(feetech.path) as device:
        device.open()
        device.read()
        begin = time.monotonic()
        for _ in range(20):
            device.read()
        assert 0.19 <= time.monotonic() - begin < 1.0


@pytest.mark.parametrize("kind", ["feetech", "dynamixel"])
def test_answers_that_are_lost_damaged_or_late_are_asked_for_again(kind: str, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path) as device:
        device.open()
        before = joints_of(device)
        for fault in ("lose", "corrupt"):
            bus.tell(**{fault: 1})
            assert np.array_equal(joints_of(device), before)
        assert device.read().counts["repeated"] >= 2


@pytest.mark.parametrize("kind", ["feetech", "dynamixel"])
def test_a_servo_that_says_nothing_is_a_fault_that_names_it(kind: str, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path) as device:
        device.open()
        bus.tell(mute=[3])
        with pytest.raises(DeviceFault, match="3"):
            device.read()
        bus.tell(mute=[])
        device.close()
        device.open()
        assert joints_of(device) is not None


@pytest.mark.parametrize("kind", ["feetech", "dynamixel"])
def test_a_leader_that_is_unplugged_is_a_fault(kind: str, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path) as device:
        device.open()
        bus.close()
        with pytest.raises(DeviceFault):
            device.read()
        device.close()
        with pytest.raises(DeviceFault, match=r"There is no|none of the servos"):
            device.open()


def test_a_port_in_use_is_refused(dynamixel: Bus, tmp_path: Path) -> None:
    path = saved(calibrated(dynamixel.path), tmp_path)
    with gello(path) as first, gello(path) as second:
        first.open()
        with pytest.raises(DeviceFault, match="end that first"):
            second.open()
        assert joints_of(first) is not None


def test_a_gello_keeps_its_zero_over_power_cycles(dynamixel: Bus, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = saved(calibrated(dynamixel.path), tmp_path)
    positions = rng.integers(0, 4096, 8)
    seen = []
    for _ in range(4):
        turns = rng.integers(-3, 4, 8) * 4096  # what it has forgotten, or counted before
        dynamixel.put(*(positions + turns).tolist())
        with gello(path) as device:
            device.open()
            seen.append(joints_of(device))
    assert np.ptp(seen, axis=0).max() < 1e-9
    assert np.abs(seen[0]).max() <= pi


def test_a_joint_goes_past_the_end_of_a_turn_without_a_jump(dynamixel: Bus, tmp_path: Path) -> None:
    with gello(saved(calibrated(dynamixel.path, offsets=(-pi,) + (0.0,) * 6), tmp_path)) as device:
        dynamixel.put(*[4000] * 8)
        device.open()
        before = joints_of(device)
        for position in range(4000, 4400, 40):
            dynamixel.put(*[position % 4096] * 8)
            now = joints_of(device)
            assert np.abs(now - before).max() < 41 * STEP
            before = now
        assert before[0] == pytest.approx(4360 * STEP - pi)


def test_negative_positions_and_the_header_within_values_are_read(dynamixel: Bus, tmp_path: Path) -> None:
    assert packet(1, 0x55, b"\x00\xff\xff\xfd\x00").count(b"\xfd\xfd") == 1
    with gello(saved(calibrated(dynamixel.path, near=(0.0,) * 7), tmp_path)) as device:
        dynamixel.put(-100, 2048, 0xFDFFFF, *[0] * 5)  # bytes ff ff fd 00, which begin a packet
        device.open()
        joints = joints_of(device)
        assert joints[0] == pytest.approx(-100 * STEP)
        assert joints[2] == pytest.approx((0xFDFFFF % 4096 - 4096) * STEP)


def test_the_checksum_is_that_of_the_manual() -> None:
    # ROBOTIS, protocol 2.0: the examples of a ping of servo 1, and of reading position of servo 1.
    assert packet(1, 1) == bytes.fromhex("fffffd0001030001194e")
    assert packet(1, 2, bytes([132, 0, 4, 0])) == bytes.fromhex("fffffd0001070002840004001d15")
    assert checksum(b"") == 0


def test_answers_may_come_in_any_pieces() -> None:
    sent = (
        b"\xff" + packet(1, 0x55, b"\x00abcd") + b"\xff\xff" + packet(2, 0x55, b"\x00\xff\xff\xfd\x01") + packet(1, 1)
    )
    whole = Answers().feed(sent)
    assert whole == [(1, b"abcd"), (2, b"\xff\xff\xfd\x01")]
    answers = Answers()
    assert [one for at in range(len(sent)) for one in answers.feed(sent[at : at + 1])] == whole


def test_calibration_finds_signs_and_offsets(dynamixel: Bus, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    signs, offsets, home = rng.choice([-1, 1], 7), rng.uniform(-3, 3, 7), np.array(FR3.home)
    turned: list[tuple[int, float]] = []  # the joint that the person turns, and since when

    def put(joints: np.ndarray, gripper: int) -> None:
        dynamixel.put(*np.round(signs * (joints - offsets) / STEP).astype(int).tolist(), gripper)

    def ask(text: str) -> None:
        turned.clear()
        put(home, 1500 if "Open the gripper" in text else 2000)

    def show(text: str) -> None:
        at = next(index for index, name in enumerate(FR3.joints) if f"turn {name} " in text)
        turned.append((at, time.monotonic() + 0.05))

    class Turning:
        """The servos in the hands of a person."""

        failures = 0

        def __init__(self, calibration: LeaderCalibration) -> None:
            self.bus = DynamixelBus(calibration)

        def angles(self) -> np.ndarray:
            if turned:
                at, since = turned[-1]
                joints = home.copy()
                joints[at] += min(max(time.monotonic() - since, 0.0), 0.5)
                put(joints, 2000)
            return self.bus.angles()

        def close(self) -> None:
            self.bus.close()

    draft = calibrated(dynamixel.path, signs=(1,) * 7, offsets=(0.0,) * 7, closed=0.0, opened=1.0)
    found = calibrate_leader(draft, FR3, Turning, ask=ask, show=show)
    assert found.signs == tuple(signs)
    assert np.array(found.offsets) == pytest.approx(offsets, abs=2 * STEP)
    path = saved(found, tmp_path)
    assert LeaderCalibration.read(path) == found
    with gello(path) as device:
        device.open()
        put(home + 0.3, 1750)
        assert joints_of(device) == pytest.approx(home + 0.3, abs=2 * STEP)
        assert device.read().hands["right"].opening == pytest.approx(0.5)


def test_a_leader_that_is_not_held_still_is_refused(dynamixel: Bus) -> None:
    class Shaking:
        failures = 0
        at = 0.0

        def angles(self) -> np.ndarray:
            self.at += 0.01
            return np.full(8, self.at)

        def close(self) -> None:
            pass

    with pytest.raises(Refused, match="moved by"):
        calibrate_leader(calibrated(dynamixel.path), FR3, lambda _: Shaking(), ask=lambda _: None, show=lambda _: None)


def test_a_leader_with_another_number_of_joints_is_refused(feetech: Bus) -> None:
    with pytest.raises(InvalidSetup, match="7, and one for the gripper"):
        calibrate_leader(uncalibrated(feetech.path), FR3, So101Bus, ask=lambda _: None, show=lambda _: None)
    assert len(SO101.joints) == 5


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"signs": (1, 1)}, "2 signs"),
        ({"signs": (1, 2, 1, 1, 1, 1, 1)}, "signs"),
        ({"offsets": (float("nan"),) * 7}, "offsets"),
        ({"closed": 1.0, "opened": 1.0}, "calibrate it anew"),
        ({"servos": (1, 1, 3, 4, 5, 6, 7, 8)}, "number of its own"),
    ],
)
def test_a_wrong_calibration_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidSetup, match=says):
        replace(calibrated("/dev/null"), **changes)


def test_addresses_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    for make, address in ((so101_leader, None), (gello, None), (gello, "/dev/ttyUSB0"), (gello, "/none/leader.json")):
        with pytest.raises(InvalidSetup, match=r"leader:/dev/ttyACM1|calibrate leader"):
            make(address)
    (tmp_path / "bad.json").write_text("[1, 2")
    with pytest.raises(InvalidSetup, match="cannot be read"):
        gello(str(tmp_path / "bad.json"))
    seven = saved(calibrated("/dev/null"), tmp_path)
    with pytest.raises(InvalidSetup, match="not for an SO101"):
        so101_leader(seven)


def test_the_command_needs_a_terminal_and_a_place_for_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rcs.cli.calibrate.leader import LeaderCommand

    with pytest.raises(InvalidSetup, match="terminal"):
        LeaderCommand(port="/dev/null").run()
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    with pytest.raises(InvalidSetup, match="servos"):
        LeaderCommand(port="/dev/null", servos=(1, 1), out=tmp_path / "leader.json").run()
    with pytest.raises(DeviceFault, match="There is no use of the serial port"):
        LeaderCommand(port="/dev/none", out=tmp_path / "leader.json").run()
    assert not (tmp_path / "leader.json").exists()
