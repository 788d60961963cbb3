"""Refusals of the driver of the xArm7 before anything moves: options, addresses, and peers that are no xArm."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.xarm import XarmDriver
from rcs.kinematics import kinematics_of
from rcs.robots import FRANKA_HAND, XARM7
from rcs.spatial import Pose

pytestmark = pytest.mark.hardware
pytest.importorskip("xarm", reason="the extra `xarm` is not installed")

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.99"


def test_what_a_driver_cannot_do_it_refuses() -> None:
    for options, match in (
        ({"rate": 1000}, "30 to 250"),
        ({"speed": 0}, "0.01 to 1"),
        ({"tcp_speed": 1.5}, "0.001 to 0.95"),
        ({"tcp": [0, 0, 1]}, "a sequence of 7"),
        ({"rat": 100}, "Did you mean 'rate'"),
    ):
        with pytest.raises(InvalidSetup, match=match):
            XarmDriver().arm("192.0.2.1", XARM7, options)
    with pytest.raises(InvalidSetup, match="Robotiq"):
        XarmDriver().gripper("192.0.2.1", FRANKA_HAND, {})


def test_at_the_usual_speed_no_pose_has_the_tcp_too_fast() -> None:
    arm = XarmDriver().arm("192.0.2.1", XARM7, {})
    chain, tool = kinematics_of(XARM7), Pose((0.0, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0))
    rng = np.random.default_rng(5)
    step = 1e-3 * np.array(arm.limits.joint_velocity)
    for _ in range(3000):
        joints = rng.uniform(XARM7.joint_lower, XARM7.joint_upper)
        there = joints + step * rng.choice([-1.0, 1.0], 7)
        way = (chain.forward(there) * tool).translation - (chain.forward(joints) * tool).translation
        assert np.linalg.norm(way) <= 1e-3 * 0.95


def test_wrong_addresses_are_faults_with_what_to_look_at() -> None:
    begin = time.monotonic()
    with pytest.raises(DeviceFault, match=r"127\.1\.1\.1: nothing listens on port 502"):
        XarmDriver().arm("127.1.1.1", XARM7, {}).open()
    assert time.monotonic() - begin < 3.0


ANSWER = """
import socket, sys, time
client, _ = socket.socket(fileno=int(sys.argv[1])).accept()
client.sendall(sys.argv[2].encode())
time.sleep(60)
"""


@pytest.mark.parametrize(("answer", "reason"), [(b"", "sends nothing"), (b"HTTP/1.1 400 Bad", "this is not an xArm")])
def test_a_mute_peer_and_another_device_are_told_of_in_time(answer: bytes, reason: str) -> None:
    try:
        peer = socket.create_server((ADDRESS, 502))
    except PermissionError:
        pytest.skip("this machine lets no user listen on port 502")
    with peer:
        program = subprocess.Popen(
            [sys.executable, "-c", ANSWER, str(peer.fileno()), answer.decode()], pass_fds=[peer.fileno()]
        )
        try:
            begin = time.monotonic()
            with pytest.raises(DeviceFault, match=reason):
                XarmDriver().arm(peer.getsockname()[0], XARM7, {}).open()
            assert time.monotonic() - begin < 3.0
        finally:
            program.kill()
            program.wait()
