"""Servos of a leader on a pseudo-terminal: `feetech` or `dynamixel`, as a program of its own.

Prints the path of the port, and after each line of its input which servos have torque, where they are to go, and what
bounds their torque. A servo with torque goes to its goal by up to `PACE` between two answers, unless it is held:
`{"held": [2]}`. Each line of its input is JSON: positions by servo, or a fault: `{"mute": [3]}` has servos
say nothing, `{"lose": 2}` and `{"corrupt": 2}` damage the next answers, `{"late": 0.05}` delays all of them [s], and
`{"noise": 3}` has each follow so many damaged copies of it, with one wrong bit behind the head, if it has a body.
Positions are what the encoders count, 4096 a turn, those of Dynamixel servos with whole turns; in permanent memory, all
servos of Feetech are calibrated to 0 … 4095 with the middle at 2048, but for the ends of the range.
"""

from __future__ import annotations

import json
import os
import pty
import select
import sys
import time
import tty
from typing import Any

LOWEST, HIGHEST, MODEL, TORQUE, GOAL, LIMIT, POSITION = 9, 11, 3, 40, 42, 48, 56
PACE = 20
"""Positions that a servo goes between two answers."""


class Servos:
    """The parts that both kinds share: positions, faults, and the torque that is on until a program switches it off."""

    def __init__(self, count: int) -> None:
        self.positions = dict.fromkeys(range(1, count + 1), 2048)
        self.has_torque = dict.fromkeys(self.positions, True)
        self.goals: dict[int, int] = {}
        self.limits: dict[int, int] = {}
        self.noise: dict[int, int] = {}
        self.faults: dict[str, Any] = {}

    def take(self, line: str) -> None:
        given = json.loads(line)
        self.positions |= {int(servo): position for servo, position in given.pop("positions", {}).items()}
        self.faults |= given

    def state(self) -> dict[str, Any]:
        own = {
            "torque": self.has_torque, "goals": self.goals, "limits": self.limits, "positions": self.positions,
            "noise": self.noise,
        }  # fmt: skip
        return {name: {str(servo): value for servo, value in one.items()} for name, one in own.items()}

    def move(self) -> None:
        for servo, goal in self.goals.items():
            if self.has_torque[servo] and servo not in self.faults.get("held", ()):
                way = goal - self.positions[servo]
                self.positions[servo] += max(-PACE, min(PACE, way))

    def sent(self, servo: int, answer: bytes) -> bytes:
        if servo in self.faults.get("mute", ()):
            return b""
        for fault in ("lose", "corrupt"):
            if self.faults.get(fault, 0) > 0:
                self.faults[fault] -= 1
                return b"" if fault == "lose" else answer[:-3] + bytes([answer[-3] ^ 4]) + answer[-2:]
        before = self.noise.setdefault(servo, 0)
        self.noise[servo] += self.faults.get("noise", 0) if len(answer) > 7 else 0
        wrong = [divmod(bit % (8 * (len(answer) - 7)), 8) for bit in range(before, self.noise[servo])]
        copies = [answer[: 7 + at] + bytes([answer[7 + at] ^ 1 << bit]) + answer[8 + at :] for at, bit in wrong]
        return b"".join([*copies, answer])


class Feetech(Servos):
    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.rest = b""

    def answers(self, data: bytes) -> list[bytes]:
        self.rest += data
        found: list[bytes] = []
        while (start := self.rest.find(b"\xff\xff")) >= 0:
            self.rest = self.rest[start:]
            if len(self.rest) < 4 or len(self.rest) < (end := 4 + self.rest[3]):
                break
            body, self.rest = self.rest[2 : end - 1], self.rest[end:]
            found += self.answer(body[0], body[2], body[3:])
        return found

    def answer(self, servo: int, instruction: int, values: bytes) -> list[bytes]:
        if instruction == 3:
            self.put(servo, values[0], values[1:])
            return [self.framed(servo, b"")]
        if instruction == 0x83:  # sync write
            register, size = values[0], values[1]
            for at in range(2, len(values), size + 1):
                self.put(values[at], register, values[at + 1 : at + 1 + size])
            return []
        if instruction == 0x82:
            first, count = values[0], values[1]
            if first == POSITION:
                self.move()
            return [self.framed(one, self.block(one)[first : first + count]) for one in values[2:]]
        return []

    def put(self, servo: int, register: int, values: bytes) -> None:
        if register == TORQUE:
            self.has_torque[servo] = bool(values[0])
        elif register == GOAL:
            self.goals[servo] = int.from_bytes(values, "little")
        elif register == LIMIT:
            self.limits[servo] = int.from_bytes(values, "little")

    def block(self, servo: int) -> bytes:
        own = bytearray(128)
        own[MODEL : MODEL + 2] = (777).to_bytes(2, "little")
        lowest, highest = (1000, 3096) if servo != 5 else (0, 4095)
        own[LOWEST : LOWEST + 2], own[HIGHEST : HIGHEST + 2] = (
            lowest.to_bytes(2, "little"),
            highest.to_bytes(2, "little"),
        )
        own[16:18] = (1000).to_bytes(2, "little")
        own[TORQUE] = self.has_torque[servo]
        own[POSITION : POSITION + 2] = self.positions[servo].to_bytes(2, "little")
        own[62] = 74
        return bytes(own)

    def framed(self, servo: int, values: bytes) -> bytes:
        body = bytes([servo, len(values) + 2, 0, *values])
        return self.sent(servo, b"\xff\xff" + body + bytes([~sum(body) & 0xFF]))


class Dynamixel(Servos):
    """Protocol 2.0, written after the manual and not after the library under test."""

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.rest = b""
        self.modes = dict.fromkeys(self.positions, 4)
        self.watchdogs: dict[int, int] = {}
        self.heard = time.monotonic()
        self.table = [self.entry(number) for number in range(256)]

    @staticmethod
    def entry(number: int) -> int:
        value = number << 8
        for _ in range(8):
            value = value << 1 ^ (0x8005 if value & 0x8000 else 0)
        return value & 0xFFFF

    def checksum(self, data: bytes) -> int:
        value = 0
        for byte in data:
            value = (value << 8 ^ self.table[(value >> 8 ^ byte) & 0xFF]) & 0xFFFF
        return value

    def answers(self, data: bytes) -> list[bytes]:
        self.rest += data
        found: list[bytes] = []
        while (start := self.rest.find(b"\xff\xff\xfd\x00")) >= 0:
            self.rest = self.rest[start:]
            if len(self.rest) < 7 or len(self.rest) < (end := 7 + self.rest[5] + 256 * self.rest[6]):
                break
            body, self.rest = self.rest[:end], self.rest[end:]
            if self.checksum(body[:-2]) == body[-2] + 256 * body[-1]:
                for servo, periods in self.watchdogs.items():
                    if periods and time.monotonic() - self.heard > 0.02 * periods:
                        self.limits[servo], self.watchdogs[servo] = 0, -1
                self.heard = time.monotonic()
                found += self.answer(body[4], body[7], body[8:-2])
        return found

    def answer(self, servo: int, instruction: int, values: bytes) -> list[bytes]:
        if instruction == 3 and servo in self.positions:
            self.put(servo, values[0], values[2:])
            return [self.framed(servo, b"")]
        if instruction == 2 and servo in self.positions and values[:2] == bytes([11, 0]):
            return [self.framed(servo, bytes([self.modes[servo]]))]
        if instruction == 0x83:  # sync write
            register, size = values[0], values[2]
            for at in range(4, len(values), size + 1):
                self.put(values[at], register, values[at + 1 : at + 1 + size])
            return []
        if instruction == 0x82 and values[:4] == bytes([132, 0, 4, 0]):
            self.move()
            known = [one for one in values[4:] if one in self.positions]
            return [self.framed(one, self.positions[one].to_bytes(4, "little", signed=True)) for one in known]
        return []

    def put(self, servo: int, register: int, values: bytes) -> None:
        value = int.from_bytes(values, "little", signed=True)
        if register == 64:
            self.has_torque[servo] = bool(value)
        elif register == 11 and not self.has_torque[servo] and not self.faults.get("modeless"):
            self.modes[servo] = value
        elif register == 98 and (value == 0 or self.watchdogs.get(servo) != -1):
            self.watchdogs[servo] = value
        elif register == 102 and self.watchdogs.get(servo) != -1:
            self.limits[servo] = value
        elif register == 116 and self.watchdogs.get(servo) != -1 and self.modes[servo] == 5:
            self.goals[servo] = value

    def framed(self, servo: int, values: bytes) -> bytes:
        stuffed = values.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        data = b"\xff\xff\xfd\x00" + bytes([servo, len(stuffed) + 4, 0, 0x55, 0]) + stuffed
        return self.sent(servo, data + self.checksum(data).to_bytes(2, "little"))


def main(kind: str, count: str) -> None:
    servos = {"feetech": Feetech, "dynamixel": Dynamixel}[kind](int(count))
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)  # noqa: T201
    lines = b""
    while True:
        ready, _, _ = select.select([master, 0], [], [])
        if master in ready:  # first, so that what was written before a line is known to the answer
            answer = b"".join(servos.answers(os.read(master, 4096)))
            time.sleep(servos.faults.get("late", 0.0))
            os.write(master, answer)
        if 0 in ready:
            if not (data := os.read(0, 4096)):
                return
            *whole, lines = (lines + data).split(b"\n")
            for line in whole:
                servos.take(line.decode())
                print(json.dumps(servos.state()), flush=True)  # noqa: T201


if __name__ == "__main__":
    main(*sys.argv[1:])
