"""A Robotiq 2F-85 over both of its transports, against a virtual UR5e that carries one."""

from __future__ import annotations

import os
import pty
import time
from collections.abc import Generator, Iterator
from typing import Any

import pytest

from rcs.devices import Gripper
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.hardware.robotiq import SILENCE, RobotiqDriver, RobotiqGripper
from rcs.hardware.robotiq_lines import ModbusLine, RobotiqStatus, status_of
from rcs.robots import ROBOTIQ_2F85
from rcs.testing import GripperContract
from rcs.virtual import VirtualProcess

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.1"


class RobotiqContract(GripperContract):
    """The contract, with the virtual robot of a test class."""

    max_age = 0.3
    address: str
    virtual: VirtualProcess

    def make_device(self) -> Gripper:
        return RobotiqDriver().gripper(self.address, ROBOTIQ_2F85, {})

    def provoke_fault(self, device: Gripper) -> None:
        self.virtual.tell("gripper", 14)
        wait_for_fault(device)

    def lose_link(self, device: Gripper) -> None:
        self.virtual.tell("cut")
        wait_for_fault(device)
        time.sleep(0.5)  # until what was measured is too old to be given

    def restore_link(self, device: Gripper) -> None:
        self.virtual.tell("clear")

    @pytest.fixture(autouse=True)
    def _opened(self, served: VirtualProcess) -> None:
        """Begin each test with an activated gripper that is open."""
        type(self).virtual = served
        type(self).address = str(served.site.grippers["ur5e"].address)  # type: ignore[union-attr]
        served.tell("clear")
        with self.make_device() as gripper:
            gripper.recover()
            gripper.command_opening(1.0)
            self.move(gripper)


@pytest.mark.hardware
@pytest.mark.slow
class TestOverTheSocket(RobotiqContract):
    """The URCap's socket on port 63352."""

    @pytest.fixture(scope="class")
    @staticmethod
    def served() -> Generator[VirtualProcess]:
        with VirtualProcess("ur5e", address=ADDRESS) as virtual:
            yield virtual


@pytest.mark.hardware
@pytest.mark.slow
class TestOverModbus(RobotiqContract):
    """Modbus RTU on a pseudo-terminal."""

    @pytest.fixture(scope="class")
    @staticmethod
    def served(tmp_path_factory: pytest.TempPathFactory) -> Generator[VirtualProcess]:
        pytest.importorskip("pymodbus", reason="the extra `robotiq` is not installed")
        pytest.importorskip("serial", reason="the extra `robotiq` is not installed")
        line = tmp_path_factory.mktemp("serial") / "gripper"
        with VirtualProcess("ur5e", address=f"{ADDRESS[:-1]}2,{line}") as virtual:
            yield virtual


@pytest.fixture(scope="module")
def virtual() -> Generator[VirtualProcess]:
    with VirtualProcess("ur5e", address=f"{ADDRESS[:-1]}3") as virtual:
        yield virtual


@pytest.fixture
def gripper(virtual: VirtualProcess) -> Iterator[Gripper]:
    """Give a gripper that is open and activated."""
    virtual.tell("clear")
    with RobotiqDriver().gripper(f"{ADDRESS[:-1]}3", ROBOTIQ_2F85, {}) as gripper:
        gripper.recover()
        go(gripper, 1.0)
        yield gripper


@pytest.mark.hardware
@pytest.mark.parametrize(("code", "word"), [(8, "85"), (10, "supply"), (14, "current"), (0, "lost its activation")])
def test_codes_become_words_and_recover_moves_nothing(
    code: int, word: str, gripper: Gripper, virtual: VirtualProcess
) -> None:
    go(gripper, 0.5)
    time.sleep(0.1)
    before = gripper.state().opening
    virtual.tell("gripper", code)
    assert word in wait_for_fault(gripper)
    with pytest.raises(DeviceFault, match=word):
        gripper.command_opening(1.0)
    virtual.tell("clear")
    gripper.recover()
    time.sleep(0.3)
    assert gripper.state().opening == pytest.approx(before, abs=0.02)
    go(gripper, 1.0)
    assert gripper.state().opening > 0.97


@pytest.mark.hardware
def test_a_force_that_the_gripper_cannot_be_limited_to_is_refused(gripper: Gripper) -> None:
    before = gripper.state().opening
    with pytest.raises(InvalidAction, match="force is 5 N; valid is 20 to 235"):
        gripper.command_opening(0.0, force=5.0)
    time.sleep(0.2)
    assert gripper.state().opening == pytest.approx(before, abs=0.01)


@pytest.mark.hardware
def test_the_first_command_activates_a_gripper_and_open_does_not(gripper: Gripper, virtual: VirtualProcess) -> None:
    virtual.tell("gripper", 0)
    wait_for_fault(gripper)
    gripper.close()
    gripper.open()
    gripper.recover()
    before = gripper.state().opening
    time.sleep(0.3)
    assert gripper.state().opening == pytest.approx(before, abs=0.01)
    gripper.command_opening(0.9)
    least = 1.0
    until = time.monotonic() + 10.0
    while not gripper.has_arrived():
        assert time.monotonic() < until
        least = min(least, gripper.state().opening)
        time.sleep(0.01)
    assert least < 0.1  # an activation closes and opens the fingers
    assert gripper.state().opening == pytest.approx(0.9, abs=0.02)


@pytest.mark.hardware
def test_an_answer_that_is_late_or_lost_is_no_wrong_value(gripper: Gripper, virtual: VirtualProcess) -> None:
    go(gripper, 0.5)
    virtual.tell("late", "50/10")
    for _ in range(30):
        assert gripper.state().opening == pytest.approx(0.5, abs=0.03)
        time.sleep(0.02)
    assert gripper.fault == ""


@pytest.mark.hardware
def test_it_holds_though_its_thread_was_kept_from_reading(gripper: Gripper) -> None:
    assert isinstance(gripper, RobotiqGripper)
    gripper._speed = 0  # the slowest, which takes 4 s to close
    gripper.command_opening(0.0)
    time.sleep(0.1)
    gripper._is_ending = True
    assert gripper._thread is not None
    gripper._thread.join()
    time.sleep(1.1)
    gripper.hold()
    assert not gripper.fault
    assert gripper._transport is not None
    time.sleep(0.2)
    stands = gripper._transport.read().position
    time.sleep(0.3)
    assert gripper._transport.read().position == pytest.approx(stands, abs=3)
    assert 10 < stands < 200


@pytest.mark.hardware
def test_hold_does_not_wait_for_a_silent_line_and_is_sent_when_it_answers(
    gripper: Gripper, virtual: VirtualProcess
) -> None:
    for silence in (0.02, 0.15):  # the thread waits for an answer, or has waited in vain
        go(gripper, 1.0)
        gripper.command_opening(0.0)
        time.sleep(0.1)
        virtual.tell("freeze", "0.25")
        time.sleep(silence)
        begin = time.monotonic()
        gripper.hold()
        assert time.monotonic() - begin < 0.14
        time.sleep(0.5)
        stands = gripper.state().opening
        time.sleep(0.3)
        assert gripper.state().opening == pytest.approx(stands, abs=0.01)
        assert 0.3 < stands < 0.95
        assert gripper.fault == ""


def test_a_wrong_address_is_a_fault_with_what_to_look_at() -> None:
    for address, word in (("127.1.1.1", "URCap"), ("/dev/nothing", "Plugged in"), ("usb:1-99", "Plugged in")):
        if not address.startswith("127"):
            pytest.importorskip("pymodbus", reason="the extra `robotiq` is not installed")
            pytest.importorskip("serial", reason="the extra `robotiq` is not installed")
        with pytest.raises((DeviceFault, InvalidSetup), match=word):
            RobotiqDriver().gripper(address, ROBOTIQ_2F85, {}).open()


@pytest.mark.hardware
def test_a_line_that_the_library_closes_after_some_silence_is_opened_again() -> None:
    pytest.importorskip("pymodbus", reason="the extra `robotiq` is not installed")
    ends = pty.openpty()
    line = ModbusLine(os.ttyname(ends[1]))
    for _ in range(7):
        with pytest.raises(DeviceFault, match="no gripper answers"):
            line.read()
    line.close()
    for end in ends:
        os.close(end)


class Line:
    """A line to an active gripper that stands open, until it is cut."""

    def __init__(self, lines: list[Line]) -> None:
        self.is_cut, self.is_active = False, True
        self.written: list[dict[str, Any]] = []
        lines.append(self)

    def read(self) -> RobotiqStatus:
        if self.is_cut:
            raise DeviceFault("cut")
        return status_of(((3 if self.is_active else 0) << 12, 0, 3 << 8), time.monotonic())

    def write(self, **registers: Any) -> None:
        self.written.append(registers)

    def close(self) -> None:
        self.is_cut = True


def test_recover_connects_anew_where_the_old_line_is_dead() -> None:
    lines: list[Line] = []
    with RobotiqGripper("192.0.2.1", ROBOTIQ_2F85, {}, transport=lambda address: Line(lines)) as gripper:
        lines[0].is_cut = True
        wait_for_fault(gripper)
        gripper.recover()
        assert len(lines) == 2
        assert gripper.state().opening == 1.0


def test_a_hold_after_a_gap_activates_no_gripper_that_has_lost_its_power_meanwhile() -> None:
    lines: list[Line] = []
    with RobotiqGripper("192.0.2.1", ROBOTIQ_2F85, {}, transport=lambda address: Line(lines)) as gripper:
        gripper.command_opening(0.0)
        until = time.monotonic() + 3.0
        while not lines[0].written:
            assert time.monotonic() < until
            time.sleep(0.005)
        gripper._is_ending = True
        assert gripper._thread is not None
        gripper._thread.join()
        lines[0].is_active = False
        time.sleep(2 * SILENCE + 0.1)
        gripper.hold()
        assert not lines[0].written[-1]["activate"]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"speed": 1.0}, "0.02 to 0.15"),
        ({"force": True}, "20 to 235"),
        ({"open": 200, "closed": 100}, "open is 200"),
        ({"widht": 1}, "widht"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], match: str) -> None:
    with pytest.raises(InvalidSetup, match=match):
        RobotiqDriver().gripper("192.0.2.1", ROBOTIQ_2F85, options)


def go(gripper: Gripper, opening: float) -> None:
    gripper.command_opening(opening)
    until = time.monotonic() + 15.0
    while not gripper.has_arrived():
        assert time.monotonic() < until, gripper.fault
        time.sleep(0.01)


def wait_for_fault(gripper: Gripper, seconds: float = 3.0) -> str:
    """Wait until a thread of the gripper has found a fault, and return it."""
    until = time.monotonic() + seconds
    while not gripper.fault:
        assert time.monotonic() < until, "no fault was found"
        time.sleep(0.005)
    return gripper.fault
