"""Virtual worlds: a wire leads a robot in real time, and what it is told goes wrong."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import pytest

import rcs
from rcs.devices import lookup
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, UnknownName
from rcs.virtual import Fault, VirtualRobot, VirtualWorld, Wire, read_events, read_ticks, running, tell, usual_setup


class WaveWire(Wire):
    """Leads the first joint along a wave, and answers each datagram with how often it has been asked."""

    rate = 500
    faults = {"stumble": "JOINT"}

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        self.robot, self.time, self.asked, self.fault = robot, 0.0, 0, ""
        self.start, self.pushes, self.is_still = robot.joints, None, False
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((address, 0))

    def site(self):
        host, port = self.socket.getsockname()
        return {"arms": {"driver": "wave", "address": f"{host}:{port}"}}

    def files(self):
        return [self.socket]

    def receive(self, file):
        packet, sender = file.recvfrom(100)
        self.asked += 1
        self.robot.line.send(b"%d" % self.asked, lambda reply: self.socket.sendto(reply, sender))

    def tick(self, robot):
        if self.pushes is not None:
            return robot.push(self.pushes)
        if self.is_still:
            return robot.brake()
        self.time += robot.period
        joints, speeds, accelerations = self.start.copy(), np.zeros(robot.about.dof), np.zeros(robot.about.dof)
        joints[0] += 0.2 * (1 - np.cos(3 * self.time))
        speeds[0], accelerations[0] = 0.6 * np.sin(3 * self.time), 1.8 * np.cos(3 * self.time)
        return robot.lead(joints, speeds, accelerations)

    def tell(self, fault: Fault) -> None:
        self.fault = self.robot.about.joints[self.robot.joint_of(fault.value)]

    def clear(self) -> None:
        self.fault = ""

    def close(self) -> None:
        self.socket.close()


WIRES = dict.fromkeys(("so101", "fr3"), WaveWire)


@contextmanager
def world_of(robot: str = "so101", **options) -> Generator[VirtualWorld]:
    world = VirtualWorld(usual_setup(robot), wires=WIRES, **options)
    thread = threading.Thread(target=world.run)
    thread.start()
    try:
        yield world
    finally:
        world.end()
        thread.join()
        world.close()


def wait_until(is_so, patience: float = 5.0) -> None:
    end = time.monotonic() + patience
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)


def ask(world: VirtualWorld, patience: float = 0.1) -> str:
    host, port = world.site()["arms"]["so101"]["address"].split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.settimeout(patience)
        own.sendto(b"?", (host, int(port)))
        try:
            return own.recv(100).decode()
        except TimeoutError:
            return ""


def test_a_led_arm_is_where_it_is_led_at_the_rate_of_the_wire(tmp_path):
    with world_of(log=tmp_path / "log.jsonl"):
        time.sleep(0.5)
    ticks = read_ticks(tmp_path / "log.jsonl")
    assert np.abs(ticks["commanded"] - ticks["joints"])[20:].max() < 5e-3
    assert np.ptp(ticks["commanded"][:, 0]) > 0.1
    assert np.allclose(np.diff(ticks["due"]), 0.002)
    assert len(ticks) >= 200
    end = read_events(tmp_path / "log.jsonl")[-1]
    assert (end["event"], end["ticks"]) == ("end", len(ticks))


def test_the_objects_are_where_an_environment_has_them_with_the_same_seed():
    env = rcs.make("PickCuboid", robot="so101")
    with world_of(seed=3) as world:
        for seed in (3, 8):
            tell(world.name, ("reset", str(seed)))
            _, info = env.reset(seed=seed)
            cuboid = world._simulation.task.describe()["cuboid"]
            assert np.allclose(cuboid[:2], info["cuboid"][:2], atol=1e-3)


def test_a_reset_leaves_the_robot_where_it_is():
    with world_of() as world:
        robot = world.robots["so101"]
        wait_until(lambda: robot.joints[0] > 0.1)  # away from home
        world.wires["so101"].is_still = True
        time.sleep(0.4)
        before = robot.joints
        assert before[0] > 0.05
        tell(world.name, ("reset", "5"))
        for _ in range(10):
            assert np.allclose(robot.joints, before, atol=2e-3)
            time.sleep(0.005)


def test_a_push_presses_on_the_tcp_until_it_is_cleared():
    with world_of("fr3") as world:
        robot = world.robots["fr3"]
        applied = robot._data.xfrc_applied
        tell(world.name, ("push", "3", "-4", "0.5"))
        wait_until(lambda: applied.any())
        assert np.allclose(applied.sum(axis=0)[:3], [3.0, -4.0, 0.5])
        tell(world.name, ("clear",))
        wait_until(lambda: not applied.any())
        for words in (("push", "3"), ("push", "1", "2", "x"), ("push", "1", "2", "inf"), ("push", "1", "2", "3", "4")):
            with pytest.raises(InvalidSetup, match="FX FY FZ"):
                tell(world.name, words)


def test_a_frozen_controller_answers_nothing_until_it_goes_on():
    with world_of() as world:
        assert ask(world) == "1"
        tell(world.name, ("freeze", "0.2"))
        assert ask(world) == ""
        time.sleep(0.15)
        assert ask(world) == "3"  # what came meanwhile waited


def test_an_arm_that_follows_torques_brakes_while_its_controller_is_frozen():
    with world_of("fr3") as world:
        robot = world.robots["fr3"]
        world.wires["fr3"].pushes = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        wait_until(lambda: robot.velocities[6] > 0.3)
        tell(world.name, ("freeze", "5"))
        begin = robot.joints
        wait_until(lambda: np.abs(robot.velocities).max() < 1e-3, 2.0)
        time.sleep(0.3)
        assert np.abs(robot.joints - begin).max() < 0.2


@pytest.mark.parametrize(("fault", "lost"), [(("lose", "2"), 2), (("cut",), 4)])
def test_a_lost_packet_never_comes(fault, lost):
    with world_of() as world:
        tell(world.name, fault)
        answers = [ask(world, 0.03) for _ in range(4)]
        assert answers.count("") == lost
        tell(world.name, ("clear",))
        assert ask(world) == "5"


def test_a_late_packet_comes_late_and_a_corrupt_one_damaged():
    with world_of() as world:
        tell(world.name, ("late", "60"))
        begin = time.monotonic()
        assert ask(world) == "1"
        assert time.monotonic() - begin >= 0.06
        tell(world.name, ("clear",))
        tell(world.name, ("corrupt", "1"))
        assert ask(world) != "2"
        assert ask(world) == "3"


def test_a_fault_of_the_wire_reaches_it_and_is_cleared():
    with world_of() as world:
        tell(world.name, ("stumble", "elbow_flex"))
        assert world.wires["so101"].fault == "elbow_flex"
        tell(f"{world.name}/so101", ("clear",))
        assert world.wires["so101"].fault == ""


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("sneeze",), "Valid: freeze S, cut, late MS or MS/N, lose N or 1/N"),
        (("freez", "1"), "freeze"),
        (("freeze",), "valid is 'freeze S'"),
        (("freeze", "-1"), "valid is S"),
        (("cut", "1"), "valid is 'cut'"),
        (("lose", "1/0"), "valid is N or 1/N"),
        (("stumble", "knee"), "shoulder_pan"),
        (("reset", "-1"), "valid is SEED"),
    ],
)
def test_a_fault_that_is_none_is_refused_with_the_valid_ones(words, told):
    with world_of() as world:
        with pytest.raises(InvalidSetup, match=told.replace("/", "/")):
            tell(world.name, words)
        assert ask(world) == "1"


def test_one_that_does_not_run_is_refused_with_those_that_do():
    with world_of() as world:
        assert world.name in running()
        with pytest.raises(UnknownName, match=world.name):
            tell(world.name + "x", ("cut",))


def test_two_of_a_kind_have_two_names():
    with world_of() as first, world_of() as second:
        assert first.name != second.name


def test_two_robots_share_a_world_at_two_addresses():
    with world_of("dual_fr3") as world:
        places = {entry["address"].split(":")[0] for entry in world.site()["arms"].values()}
        assert places == {"127.0.0.1", "127.0.0.2"}
        left, _ = world.site()["arms"]
        tell(f"{world.name}/{left}", ("lose", "1"))
        assert json.dumps(world.site())


def test_torques_push_and_braking_stops_within_the_limits(tmp_path):
    with world_of(log=tmp_path / "log.jsonl") as world:
        robot, wire = world.robots["so101"], world.wires["so101"]
        before = robot.joints
        wire.pushes = [0.5, 0, 0, 0, 0]
        time.sleep(0.3)
        assert robot.joints[0] > before[0] + 0.05
        wire.pushes, wire.is_still = None, True
        time.sleep(0.4)
        assert np.abs(robot.velocities).max() < 0.02
    ticks = read_ticks(tmp_path / "log.jsonl")
    pushed = np.isnan(ticks["commanded"][:, 0])
    led = ticks["commanded"][np.flatnonzero(pushed)[-1] + 1 :]
    assert np.abs(np.diff(led, 2, axis=0)).max() / 0.002**2 <= 1.01 * max(robot.about.acceleration_limit)


def test_an_arm_that_is_led_to_no_number_brakes_within_the_limits(tmp_path):
    with world_of(log=tmp_path / "log.jsonl") as world:
        robot, wire = world.robots["so101"], world.wires["so101"]
        time.sleep(0.3)
        wire.time = np.nan
        time.sleep(0.4)
        assert np.abs(robot.velocities).max() < 0.02
    led = read_ticks(tmp_path / "log.jsonl")["commanded"]
    assert np.abs(np.diff(led, 2, axis=0)[5:]).max() / 0.002**2 <= 1.01 * max(robot.about.acceleration_limit)
    events = [event["event"] for event in read_events(tmp_path / "log.jsonl")]
    assert events.count("not_finite") == 1


def test_the_gripper_moves_at_its_speed_and_grasps_with_its_force():
    with world_of() as world:
        robot = world.robots["so101"]
        begin, quarter = world.world.time.item(), robot.gripper.grasp_force / 4
        robot.move(0.03, 0.05)
        wait_until(lambda: world.world.time.item() > begin + 0.4)
        way = 0.05 * (world.world.time.item() - begin)
        assert robot.width == pytest.approx(robot.gripper.max_width - way, abs=0.01)
        assert not robot.is_grip_still
        robot.move(0.03)
        wait_until(lambda: robot.is_grip_still)
        assert robot.width == pytest.approx(0.03, abs=3e-3)
        forces = []
        robot.grasp(0.1, None, quarter)  # as fast as this force can
        for _ in range(20):
            time.sleep(0.01)
            forces.append(robot.grip_force)
        assert np.median(forces) == pytest.approx(quarter, rel=0.1)


def test_an_arm_without_a_wire_is_refused(monkeypatch: pytest.MonkeyPatch):
    entries = lookup._entries
    monkeypatch.setattr(lookup, "_entries", lambda kind: {} if kind == "wire" else entries(kind))
    with pytest.raises(UnknownName, match="wire"):
        VirtualWorld(Setup(robot="fr3"), wires={"so101": WaveWire})


def test_whether_the_task_was_done_stays_known_until_the_objects_are_placed_anew(monkeypatch: pytest.MonkeyPatch):
    with world_of() as world:
        assert tell(world.name, ("judge",)) == "not done"
        evaluate, times = world._simulation.evaluate, []

        def done_once():
            judgement = evaluate()
            times.append(world.world.time.item())
            judgement.success = np.bool_(len(times) == 3)
            return judgement

        monkeypatch.setattr(world._simulation, "evaluate", done_once)
        wait_until(lambda: len(times) > 5)
        assert np.diff(times[:5]) == pytest.approx(1 / world.setup.frequency, abs=0.003)
        assert tell(f"{world.name}/so101", ("judge",)) == "done"
        tell(world.name, ("reset", "5"))
        assert tell(world.name, ("judge",)) == "not done"


def test_where_nothing_is_to_be_done_no_verdict_is_known():
    world = VirtualWorld(Setup(task="Free", robot="so101"), wires=WIRES)
    assert world.tell(["", "judge"]) == "not known"
    world.close()


def test_a_world_says_where_its_robots_are_and_what_its_scene_is():
    with world_of() as world:
        about = json.loads(tell(world.name, ("about",)))
        assert (about["name"], about["site"]) == (world.name, world.site())
        assert Setup.from_json(about["setup"]) == world.setup
