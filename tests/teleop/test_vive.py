"""The Vive: OpenVR's structures, and poses that another machine relays."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import DeviceFault, InvalidSetup
from rcs.spatial import tquat_to_matrix
from rcs.teleop import credentials, vive_relay
from rcs.teleop.device import Reading
from rcs.teleop.feed import flaw_of
from rcs.teleop.vive import Vive, hands_of, pose_of
from rcs.teleop.vive_relay import GREETING, LEFT, POSES, RIGHT, TRACKER, WELCOME, Tracked, pack, unpack

STILL = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
MENU, GRIP, PAD = 1 << 1, 1 << 2, 1 << 32


def wand(hand: int = RIGHT, buttons: int = 0, **changes: Any) -> Tracked:
    values = {"is_tracked": True, "matrix": STILL, "trigger": 0.0, "pad": (0.0, 0.0), **changes}
    return Tracked(hand=hand, buttons=buttons, **values)


def test_matrices_become_poses_of_the_level_frame() -> None:
    moved = list(STILL)
    moved[3], moved[7], moved[11] = 1.0, 2.0, 3.0  # to the right, up, back
    assert pose_of(moved) == pytest.approx([-3, -1, 2, 0, 0, 0, 1])
    half = np.sqrt(0.5)
    turned = tquat_to_matrix([0, 0, 0, 0, half, 0, half])[:3].ravel()  # about up
    assert pose_of(turned) == pytest.approx([0, 0, 0, 0, 0, half, half])


@pytest.mark.parametrize(
    "matrix", [(0.0,) * 12, (np.nan,) * 12, (2.0, *STILL[1:]), (-1.0, *STILL[1:]), (np.inf, *STILL[1:])]
)
def test_what_is_no_rotation_is_left_out_and_counted(matrix: tuple[float, ...]) -> None:
    assert np.isnan(pose_of(matrix)).all()
    reading = Reading(time=0.0, hands=hands_of([wand(matrix=matrix)]))
    assert flaw_of(reading, Vive.hands, None, 0.0) == "not finite"


def test_wands_are_hands_by_their_role_with_buttons() -> None:
    hands = hands_of([wand(LEFT, GRIP | MENU), wand(RIGHT, PAD, trigger=0.25, pad=(0.1, 0.9))])
    assert hands["left"].buttons == {"clutch", "start"}
    assert (hands["right"].buttons, hands["right"].opening) == ({"success"}, 0.75)
    for pad, meaning in (((0, 0), "front"), ((0, -1), "failure"), ((-1, 0), "discard"), ((1, 0.2), "reset")):
        assert hands_of([wand(RIGHT, PAD, pad=pad)])["right"].buttons == {meaning}
    assert not hands_of([wand(LEFT)])["right"].is_tracked


def test_a_press_of_the_touchpad_means_one_thing_wherever_the_thumb_slides() -> None:
    presses: dict[int, Any] = {}

    def buttons(*pads: tuple[float, float], is_pressed: bool = True) -> list[Any]:
        return [hands_of([wand(RIGHT, PAD * is_pressed, pad=pad)], presses)["right"].buttons for pad in pads]

    assert buttons((0, 0.9), (0.9, 0.2), (0, 0)) == [{"success"}] * 3
    assert buttons((0.9, 0.2), is_pressed=False) == [frozenset()]
    assert buttons((0.9, 0.2)) == [{"reset"}]


def test_a_single_tracker_without_wands_is_the_right_hand() -> None:
    hand = hands_of([wand(TRACKER)])["right"]
    assert hand.is_tracked and hand.opening is None and hand.buttons == frozenset()
    assert not hands_of([wand(TRACKER), wand(TRACKER)])["right"].is_tracked
    assert hands_of([wand(TRACKER), wand(RIGHT, GRIP)])["right"].buttons == {"clutch"}


class System:
    """The answers of OpenVR's system, in its own structures."""

    def __init__(self, openvr: Any) -> None:
        self.openvr = openvr
        self.poses = (openvr.TrackedDevicePose_t * 64)()
        self.states = {at: openvr.VRControllerState_t() for at in range(64)}
        headset, wand_ = openvr.TrackedDeviceClass_HMD, openvr.TrackedDeviceClass_Controller
        tracker, lighthouse = openvr.TrackedDeviceClass_GenericTracker, openvr.TrackedDeviceClass_TrackingReference
        self.kinds = {0: headset, 1: wand_, 3: wand_, 4: tracker, 5: lighthouse}
        self.roles = {1: LEFT, 3: RIGHT}
        self.events: list[int] = []
        for at in self.kinds:
            pose = self.poses[at]
            pose.bDeviceIsConnected = pose.bPoseIsValid = True
            pose.eTrackingResult = openvr.TrackingResult_Running_OK
            for row in range(3):
                for column in range(4):
                    pose.mDeviceToAbsoluteTracking.m[row][column] = STILL[4 * row + column]

    def getDeviceToAbsoluteTrackingPose(self, universe: Any, predicted: float, array: Any) -> Any:  # noqa: N802
        assert (universe, predicted, array) == (self.openvr.TrackingUniverseStanding, 0.0, None)
        return self.poses

    def pollNextEvent(self, event: Any) -> bool:  # noqa: N802
        if self.events:
            event.eventType = self.events.pop(0)
            return True
        return False

    def getTrackedDeviceClass(self, at: int) -> Any:  # noqa: N802
        return self.kinds[at]

    def getControllerRoleForTrackedDeviceIndex(self, at: int) -> int:  # noqa: N802
        return self.roles[at]

    def getControllerState(self, at: int) -> tuple[bool, Any]:  # noqa: N802
        return True, self.states[at]


@pytest.mark.extras
def test_structures_of_openvr_are_read() -> None:
    openvr = pytest.importorskip("openvr", reason="pip install 'robot-control-stack[vive]'")
    system = System(openvr)
    system.poses[3].mDeviceToAbsoluteTracking.m[0][3] = 0.5
    system.states[3].ulButtonPressed = 1 << openvr.k_EButton_Grip | 1 << openvr.k_EButton_SteamVR_Touchpad
    system.states[3].rAxis[1].x = 0.75
    system.states[3].rAxis[0].x, system.states[3].rAxis[0].y = -0.9, 0.1
    system.poses[1].eTrackingResult = openvr.TrackingResult_Running_OutOfRange
    left, right, tracker = vive_relay.tracked(system, openvr)
    assert (left.hand, left.is_tracked, tracker.hand) == (LEFT, False, TRACKER)
    hand = hands_of([left, right, tracker])["right"]
    assert hand.pose == pytest.approx([0, -0.5, 0, 0, 0, 0, 1])
    assert (hand.buttons, hand.opening) == ({"clutch", "discard"}, 0.25)
    system.poses[3].bDeviceIsConnected = False
    assert len(vive_relay.tracked(system, openvr)) == 2
    system.events = [100, openvr.VREvent_Quit]
    assert [vive_relay.has_ended(system, openvr) for _ in range(2)] == [True, False]


@pytest.mark.extras
def test_without_steamvr_the_fault_names_both_ways() -> None:
    pytest.importorskip("openvr", reason="pip install 'robot-control-stack[vive]'")
    with pytest.raises(DeviceFault, match=r"start it.*vive:0.0.0.0:7700"):
        Vive().open()


# --- The relay ---


@pytest.fixture
def vive() -> Iterator[Vive]:
    with Vive("127.0.0.1:0") as device:
        device.open()
        yield device


def next_of(device: Vive, seconds: float = 10.0) -> Reading:
    end = time.monotonic() + seconds
    while (reading := device.read()) is None:
        assert time.monotonic() < end
    return reading


def port_of(device: Vive) -> int:
    return int(device.instructions.split()[-2].split(":")[1])


class Sender:
    """Another machine, packet by packet."""

    def __init__(self, device: Vive) -> None:
        self.device, self.code = device, credentials.code()
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link.connect(("127.0.0.1", port_of(device)))
        self.link.settimeout(5)
        self.session = b""

    def greet(self) -> None:
        self.link.send(pack(GREETING, bytes(range(8)), 0, 0.0, [], self.code))
        assert self.device.read() is None
        kind = GREETING
        while kind == GREETING:  # what asked for it
            kind, self.session, number, _, _ = unpack(self.link.recv(2048), self.code)
        assert (kind, number) == (WELCOME, int.from_bytes(bytes(range(4)), "little"))

    def packet(self, number: int, at: float, *devices: Tracked, code: str | None = None) -> bytes:
        return pack(POSES, self.session, number, at, list(devices), self.code if code is None else code)


def test_the_relay_is_a_program_by_itself_and_connects_again(vive: Vive, tmp_path: Path) -> None:
    program = [sys.executable, "-S", str(Path(__file__).parent / "relay_alone.py"), vive_relay.__file__]
    words = vive.instructions.split()[-2:]
    relay = subprocess.Popen([*program, *words], env={**os.environ, "PYTHONPATH": ""}, stdout=subprocess.DEVNULL)
    try:
        readings = [next_of(vive) for _ in range(100)]
        hand = readings[-1].hands["right"]
        assert (hand.buttons, hand.opening) == ({"clutch"}, 0.5)
        times = np.array([reading.time for reading in readings])
        places = np.array([-reading.hands["right"].pose[1] for reading in readings])
        speed = np.polyfit(times - times[0], places, 1)[0]
        assert speed == pytest.approx(0.1, rel=0.1)  # times are those of the measurement
        assert (np.diff(times) > 0).all()
        vive.close()
        vive = Vive(words[0])
        vive.open()
        assert next_of(vive).hands["right"].buttons == {"clutch"}
    finally:
        vive.close()
        relay.kill()
        relay.communicate()


def test_packets_of_another_code_and_recorded_ones_are_left_out(vive: Vive) -> None:
    sender = Sender(vive)
    sender.link.send(sender.packet(1, 0.0, wand(), code="another"))
    sender.session = bytes(8)
    sender.link.send(sender.packet(1, 0.0, wand()))
    assert vive.read() is None
    sender.greet()
    recorded = sender.packet(1, 0.0, wand())
    sender.link.send(recorded)
    assert next_of(vive).hands["right"].is_tracked
    sender.link.send(recorded)
    assert vive.read() is None
    sender.greet()
    sender.link.send(recorded)
    assert vive.read() is None
    sender.link.send(sender.packet(2, 1.0, wand()))
    assert next_of(vive).counts == {"damaged or of another code": 1, "disordered": 3}


def test_damaged_packets_are_no_packets() -> None:
    random_ = random.Random(2)
    good = pack(POSES, bytes(8), 1, 0.0, [wand(), wand(LEFT)], "code")
    for _ in range(20_000):
        at = random_.randrange(len(good))
        changed = good[:at] + bytes([good[at] ^ 1 << random_.randrange(8)]) + good[at + 1 :]
        cut = good[: random_.randrange(len(good))]
        assert unpack(changed, "code") is None
        assert unpack(cut, "code") is None
        assert unpack(random_.randbytes(random_.randrange(300)), "code") is None
    signed = good[: vive_relay.HEAD.size + 5]
    assert unpack(signed + vive_relay.seal(signed, "code"), "code") is None
    assert unpack(good, "code") is not None


def test_hostile_numbers_of_a_known_sender_are_left_out() -> None:
    rng = np.random.default_rng(1)
    for scale in (1e-3, 1.0, 1e30, np.inf, np.nan):
        for _ in range(200):
            matrix = tuple((rng.normal(size=12) * scale).tolist())
            hands = hands_of([wand(matrix=matrix, trigger=scale, pad=(scale, -scale), buttons=(1 << 64) - 1)])
            assert flaw_of(Reading(time=0.0, hands=hands), Vive.hands, None, 0.0) == "not finite"


def test_a_port_that_is_taken_is_refused(vive: Vive) -> None:
    with pytest.raises(InvalidSetup, match="free port"):
        Vive(f"127.0.0.1:{port_of(vive)}").open()
