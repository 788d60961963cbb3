"""A client of the controller of an FR3 that speaks the protocol and nothing else."""

from __future__ import annotations

import os
import socket

import numpy as np

from rcs.virtual.franka_messages import (
    ARM_COMMAND,
    ARM_HEADER,
    ARM_PORT,
    ARM_STATE,
    REQUESTS,
    Command,
    Controller,
    GeneratorMode,
    Mode,
    MoveStatus,
)

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.51"


class Client:
    """Speaks the protocol of an arm or a hand."""

    def __init__(self, port=ARM_PORT, header=ARM_HEADER, state=ARM_STATE, requests=REQUESTS, version=10) -> None:
        self.header, self.kind, self.requests = header, state, requests
        self.tcp = socket.create_connection((ADDRESS, port), 3.0)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("0.0.0.0", 0))
        self.udp.settimeout(3.0)
        self.number = 0
        self.version = version
        self.peer = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.tcp.close()
        self.udp.close()

    def connect(self) -> bytes:
        return self.ask(0, version=self.version, udp_port=self.udp.getsockname()[1])

    def send(self, command: int, **fields) -> int:
        content = b""
        if command in self.requests:
            request = np.zeros((), self.requests[command])
            for name, value in fields.items():
                request[name] = value
            content = request.tobytes()
        self.number += 1
        header = np.array((command, self.number, self.header.itemsize + len(content)), self.header)
        self.tcp.sendall(header.tobytes() + content)
        return self.number

    def answer(self) -> tuple[int, bytes]:
        header = np.frombuffer(self.take(self.header.itemsize), self.header)[0]
        return int(header["id"]), self.take(int(header["size"]) - self.header.itemsize)

    def take(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self.tcp.recv(count - len(data))
            if not more:
                raise EOFError
            data += more
        return data

    def ask(self, command: int, **fields) -> bytes:
        number = self.send(command, **fields)
        told, content = self.answer()
        assert told == number
        return content

    def state(self):
        """The next state; those that are waiting are passed over."""
        self.udp.setblocking(False)
        try:
            while True:
                self.udp.recv(4096)
        except BlockingIOError:
            pass
        self.udp.settimeout(3.0)
        return self.next_state()

    def next_state(self):
        data, self.peer = self.udp.recvfrom(4096)
        assert len(data) == self.kind.itemsize
        return np.frombuffer(data, self.kind)[0]

    def command(self, state, **fields) -> None:
        command = np.zeros((), ARM_COMMAND)
        command["message_id"] = state["message_id"]
        for name, value in fields.items():
            command[name] = value
        self.udp.sendto(command.tobytes(), self.peer)

    def start(self, controller, generator) -> int:
        number = self.send(Command.MOVE, controller_mode=controller, motion_generator_mode=max(generator - 1, 0))
        assert self.answer() == (number, bytes([MoveStatus.MOTION_STARTED]))
        while (state := self.next_state())["robot_mode"] != Mode.MOVE:
            pass
        assert (state["controller_mode"], state["motion_generator_mode"]) == (controller, generator)
        return number

    def start_torques(self) -> int:
        return self.start(Controller.EXTERNAL, GeneratorMode.NONE)

    def recover(self) -> None:
        assert self.ask(Command.AUTOMATIC_ERROR_RECOVERY) == b"\0"
