"""The network interface of the Franka Hand: TCP port 1338, version 3, and its state by UDP 30 times a second."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import Any

import numpy as np

from rcs.virtual.franka_client import Client, Listener
from rcs.virtual.franka_messages import (
    HAND_HEADER,
    HAND_PORT,
    HAND_REQUESTS,
    HAND_STATE,
    HAND_VERSION,
    HandCommand,
    HandStatus,
)
from rcs.virtual.virtual_robot import VirtualRobot

STATE_TICKS = 33
"""Ticks between two states."""
SETTLING_TICKS = 100
"""Ticks for which the fingers must stand still for a motion to have ended."""
TEMPERATURE = 35
"""Temperature in every state [°C]."""


class FrankaHandWire:
    """Implements the interface of a hand."""

    def __init__(self, robot: VirtualRobot, address: str, arm: Listener) -> None:
        """Listen; if the port is taken, close the arm's port, too."""
        assert robot.gripper is not None, "there is a hand"
        self._robot, self._about = robot, robot.gripper
        try:
            self._listener = Listener(robot.line, address, HAND_PORT, HAND_HEADER, HAND_REQUESTS)
        except Exception:
            arm.close()
            raise
        self._ticks = self._still = 0
        self._running: tuple[int, int, Any] | None = None
        self._is_grasped = False

    def files(self) -> Sequence[socket.socket]:
        """Return the sockets to read from."""
        return self._listener.files()

    def receive(self, file: socket.socket) -> None:
        """Process requests."""
        for command, number, request in self._listener.receive(file):
            if self._listener.client is not None:
                self._answer(self._listener.client, command, number, request)

    def tick(self) -> None:
        """Check whether a motion has ended, and send the state."""
        self._ticks += 1
        self._still = self._still + 1 if self._robot.is_grip_still else 0
        if self._running is not None and self._still > SETTLING_TICKS:
            self._finish(self._status())
        client = self._listener.client
        if client is not None and client.is_connected and self._ticks % STATE_TICKS == 0:
            client.sent += 1
            width = self._robot.width
            state = np.array((client.sent, width, self._about.max_width, self._is_grasped, TEMPERATURE), HAND_STATE)
            client.send_datagram(state.tobytes())

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()

    def _answer(self, client: Client, command: int, number: int, request: Any) -> None:
        if command == HandCommand.CONNECT:
            fits = int(request["version"]) == HAND_VERSION
            client.reply(command, number, bytes([0 if fits else 1, 0]) + HAND_VERSION.to_bytes(2, "little"))
            if fits:
                client.connect(int(request["udp_port"]))
            return
        self._finish(HandStatus.ABORTED)
        if command == HandCommand.STOP:
            self._robot.move(self._robot.width)
            client.reply(command, number, bytes([HandStatus.SUCCESS, 0]))
            return
        self._running, self._still, self._is_grasped = (command, number, request), 0, False
        if command == HandCommand.HOMING:
            self._robot.move(self._about.max_width)
        elif (
            not all(np.isfinite(float(request[name])) and request[name] >= 0 for name in request.dtype.names)
            or request["width"] > self._about.max_width
        ):
            self._finish(HandStatus.FAIL)
        elif command == HandCommand.MOVE:
            self._robot.move(float(request["width"]), float(request["speed"]))
        else:
            self._robot.grasp(0.0, float(request["speed"]), float(request["force"]))

    def _status(self) -> HandStatus:
        assert self._running is not None
        command, _, request = self._running
        width = self._robot.width
        if command == HandCommand.GRASP:
            self._is_grasped = bool(request["width"] - request["inner"] < width < request["width"] + request["outer"])
            return HandStatus.SUCCESS if self._is_grasped else HandStatus.UNSUCCESSFUL
        if command == HandCommand.MOVE:
            is_there = abs(width - float(request["width"])) < 2e-3
            return HandStatus.SUCCESS if is_there else HandStatus.UNSUCCESSFUL
        return HandStatus.SUCCESS

    def _finish(self, status: HandStatus) -> None:
        if self._running is not None and self._listener.client is not None:
            command, number, _ = self._running
            self._listener.client.reply(command, number, bytes([status, 0]))
        self._running = None
