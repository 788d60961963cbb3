"""The virtual servo bus, byte by byte: registers, answers, goals, and what goes wrong."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.virtual import VirtualWorld, read_events, usual_setup
from rcs.virtual.so101_wire import So101Wire, _magnitude, _signed

TORQUE_ON, GOAL, TORQUE_LIMIT, POSITION, LOAD = 40, 42, 48, 56, 60


class Bus:
    """A person's end of the cable."""

    def __init__(self, path: str) -> None:
        self.file = os.open(path, os.O_RDWR | os.O_NOCTTY)

    def ask(self, servo: int, instruction: int, *values: int, answers: int = 1, patience: float = 2.0) -> list[bytes]:
        body = bytes([servo, len(values) + 2, instruction, *values])
        os.write(self.file, b"\xff\xff" + body + bytes([~sum(body) & 0xFF]))
        got, end = b"", time.monotonic() + patience
        while len(packets := split(got)) < answers and time.monotonic() < end:
            if select.select([self.file], [], [], 0.02)[0]:
                got += os.read(self.file, 1000)
        return packets

    def read(self, servo: int, first: int, count: int = 2) -> int:
        (packet,) = self.ask(servo, 2, first, count)
        return int.from_bytes(packet[5:-1], "little")

    def write(self, servo: int, first: int, value: int, size: int = 2) -> None:
        assert self.ask(servo, 3, first, *value.to_bytes(size, "little"))


def split(data: bytes) -> list[bytes]:
    packets = []
    while len(data) >= 4 and len(data) >= 4 + data[3]:
        packets.append(data[: 4 + data[3]])
        data = data[4 + data[3] :]
    return packets


@contextmanager
def bus_of(address: str | None = None, log=None) -> Generator[tuple[Bus, VirtualWorld]]:
    world = VirtualWorld(usual_setup("so101"), wires={"so101": So101Wire}, address=address, log=log)
    thread = threading.Thread(target=world.run)
    thread.start()
    try:
        bus = Bus(world.site()["arms"]["so101"]["address"])
        yield bus, world
        os.close(bus.file)
    finally:
        world.end()
        thread.join()
        world.close()


def wait_until(is_so, patience: float = 5.0) -> None:
    end = time.monotonic() + patience
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_servos_answer_pings_reads_and_writes_with_checksums():
    with bus_of() as (bus, _):
        assert bus.ask(3, 1) == [b"\xff\xff\x03\x02\x00\xfa"]
        assert bus.read(1, 3) == 777
        bus.write(2, TORQUE_LIMIT, 300)
        assert bus.read(2, TORQUE_LIMIT) == 300
        packets = bus.ask(0xFE, 0x82, POSITION, 15, *range(1, 7), answers=6)
        assert [packet[2] for packet in packets] == [1, 2, 3, 4, 5, 6]
        assert all(~sum(packet[2:-1]) & 0xFF == packet[-1] and len(packet) == 21 for packet in packets)


def test_nobody_answers_for_a_servo_that_is_not_there_or_a_packet_that_is_damaged():
    with bus_of() as (bus, _):
        assert bus.ask(7, 1, patience=0.1) == []
        os.write(bus.file, b"\xff\xff\x03\x02\x01\x00")
        assert not select.select([bus.file], [], [], 0.1)[0]
        assert bus.ask(3, 1)


def test_what_is_measured_cannot_be_written():
    with bus_of() as (bus, _):
        before = bus.read(1, POSITION)
        bus.write(1, POSITION, 17)
        assert abs(bus.read(1, POSITION) - before) < 20


def test_a_servo_with_torque_goes_to_its_goal_and_one_without_does_not():
    with bus_of() as (bus, world):
        start = bus.read(5, POSITION)
        bus.write(5, GOAL, start + 200)
        time.sleep(0.1)
        assert abs(bus.read(5, POSITION) - start) < 10
        bus.write(5, TORQUE_ON, 1, 1)
        assert abs(bus.read(5, GOAL) - start) < 10  # the old goal is forgotten with the power off
        body = [5, *(start + 200).to_bytes(2, "little")]
        bus.ask(0xFE, 0x83, GOAL, 2, *body, answers=0)
        wait_until(lambda: abs(bus.read(5, POSITION) - start - 200) < 8)
        assert world.robots["so101"].joints[4] == pytest.approx(200 * 2 * np.pi / 4096, abs=0.02)


def test_an_arm_that_loses_its_power_falls_and_before_it_had_any_it_stands():
    with bus_of() as (bus, world):
        start = world.robots["so101"].joints
        time.sleep(0.2)
        assert np.abs(world.robots["so101"].joints - start).max() < 0.01
        for servo in range(1, 6):
            bus.write(servo, TORQUE_ON, 1, 1)
        for servo in range(1, 6):
            bus.write(servo, TORQUE_ON, 0, 1)
        before = world.robots["so101"].pose_tcp_in_base[2]
        wait_until(lambda: world.robots["so101"].pose_tcp_in_base[2] < before - 0.02)


def test_the_grippers_goal_is_its_opening():
    with bus_of() as (bus, world):
        calibration = world.wires["so101"].calibration()["gripper"]
        bus.write(6, TORQUE_ON, 1, 1)
        bus.write(6, GOAL, (calibration["range_min"] + calibration["range_max"]) // 2)
        wait_until(lambda: abs(world.robots["so101"].body.opening[0] - 0.5) < 0.02)


def test_an_overload_takes_the_torque_until_it_is_switched_off():
    with bus_of() as (bus, world):
        for servo in range(1, 6):
            bus.write(servo, TORQUE_ON, 1, 1)
        world.tell(["so101", "overload", "shoulder_lift"])
        wait_until(lambda: bus.ask(2, 1)[0][4] == 32)
        assert bus.ask(1, 1)[0][4] == 0
        world.tell(["so101", "clear"])
        assert bus.ask(2, 1)[0][4] == 32
        bus.write(2, TORQUE_ON, 0, 1)
        wait_until(lambda: bus.ask(2, 1)[0][4] == 0)


def test_a_servo_that_presses_for_long_goes_into_overload(tmp_path):
    with bus_of(log=tmp_path / "log") as (bus, world):
        bus.write(2, 34, 1, 1)
        bus.write(2, 36, 1, 1)  # it counts as much from 1 % of its torque
        bus.write(2, 35, 20, 1)  # for 0.2 s
        bus.write(2, TORQUE_ON, 1, 1)
        wait_until(lambda: bus.ask(2, 1)[0][4] == 32)
    assert [event["servo"] for event in read_events(tmp_path / "log") if event["event"] == "torque"] == [
        "shoulder_lift"
    ]


def test_a_servo_without_load_or_torque_is_never_overloaded():
    with bus_of() as (bus, _):
        for servo in (1, 2):
            bus.write(servo, 35, 5, 1)  # protection after 0.05 s
        bus.write(2, 36, 1, 1)  # that counts from 1 % of its torque
        time.sleep(0.3)
        assert bus.read(2, LOAD) & 1023 > 10, "on the stand, it carries the arm"
        assert bus.ask(2, 1)[0][4] == 0
        bus.write(1, TORQUE_ON, 1, 1)  # the base turns about the vertical and carries nothing
        time.sleep(0.5)
        assert [bus.ask(servo, 1)[0][4] for servo in (1, 2)] == [0, 0]


def test_undervoltage_and_codes_are_told_by_all_until_they_are_cleared():
    with bus_of() as (bus, world):
        world.tell(["", "undervoltage"])
        wait_until(lambda: [bus.ask(servo, 1)[0][4] for servo in (1, 6)] == [1, 1])
        assert bus.read(4, 62, 1) == 36
        world.tell(["", "clear"])
        world.tell(["", "code", "4"])
        wait_until(lambda: bus.ask(1, 1)[0][4] == 4)
        world.tell(["", "version", "1284"])
        assert bus.read(1, 3) == 1284
        for words in (["", "version", "65536"], ["", "version", "1e9"], ["", "code", "128"]):
            with pytest.raises(InvalidSetup, match="valid is a whole number from 0 to"):
                world.tell(words)
        assert bus.read(1, 3) == 1284


def test_a_port_has_the_path_that_is_asked_for_and_none_that_is_taken(tmp_path):
    path = tmp_path / "arm"
    with bus_of(str(path)) as (bus, _):
        assert bus.ask(1, 1)
        with pytest.raises(InvalidSetup, match="another address"):
            VirtualWorld(usual_setup("so101"), wires={"so101": So101Wire}, address=str(path))
    assert not path.is_symlink()
    path.symlink_to("/dev/pts/gone")
    with bus_of(str(path)) as (bus, _):
        assert bus.ask(1, 1)


def test_negative_numbers_are_an_amount_and_a_sign():
    with bus_of() as (bus, world):
        offsets = [motor["homing_offset"] for motor in world.wires["so101"].calibration().values()]
        assert min(offsets) < 0
        raw = bus.read(1, 31)
        assert raw >> 11 == 1
        assert raw & 2047 == -offsets[0]


@pytest.mark.parametrize("value", [0, 1, -1, 2046, -2047])
def test_a_register_keeps_an_amount_and_a_sign(value):
    assert _signed(_magnitude(value, 11), 11) == value


def test_an_amount_that_a_register_cannot_hold_is_its_greatest():
    assert _magnitude(2048, 11) == 0b0_111_1111_1111
    assert _magnitude(-750_000, 11) == 0b1_111_1111_1111
