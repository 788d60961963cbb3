"""`rcs doctor` finds what is wrong with a virtual lab, over the wires of its arm and camera, and moves nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.hardware import Site
from rcs.hardware.finding import Finding
from rcs.hardware.site import KINDS, DeviceAddress
from rcs.hardware.so101 import So101Driver
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.rollout import examine as module
from rcs.rollout.examine import examine, setup_for
from rcs.rollout.exercise import move
from rcs.virtual import VirtualProcess, read_points, read_ticks

pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]

LOOK, CORRECT = "power, cable and address", "entry in the site file"
"""Words of remedies."""
WIRES: tuple[tuple[tuple[object, ...], str, str, str], ...] = (
    (("cut",), "so101", "none of the servos answers", LOOK),
    (("freeze", 20), "so101", "none of the servos answers", LOOK),
    (("late", 500), "so101", "none of the servos answers", LOOK),
    (("undervoltage",), "so101", r"undervoltage at .*3\.6 V", "power supply"),
    (("version", 5), "so101", "has the model number 5", "calibration"),
    (("code", 4), "so101", "overheating at", "cool down"),
    (("overload", "gripper"), "so101/gripper", "overload at gripper", "relieve"),
    (("wrist/freeze", 20), "wrist", "no picture from", LOOK),
    (("wrist/black",), "wrist", "pictures are black", "cover"),
    (("wrist/tear",), "wrist", "were damaged", LOOK),
    (("wrist/unplug", 20), "wrist", "has ended the stream", LOOK),
    (("wrist/swap", "diagonal"), "wrist", "another camera answers", "exchange the cables"),
    (("wrist/drop", 0.6), "wrist", "of 15 frames/s|nothing new", "light|cable"),
    (("left/swap", "right"), "so101_left", "another camera answers", "exchange the cables"),
)
"""Faults, each with the part, the words of the fault, and those of the remedy."""
NOWHERE = "http://127.0.0.1:9/x"
SITES: tuple[tuple[str, str, dict[str, Any], str, str], ...] = (
    ("cameras", "wrist", {"options": {"serial": "another"}}, "not 'another'", "exchange the cables"),
    ("cameras", "wrist", {"address": NOWHERE}, "no camera answers", "switch the camera on"),
    ("cameras", "ceiling", {"driver": "webcam", "address": NOWHERE}, "no camera in the lab", CORRECT),
    ("cameras", "wrist", {"driver": "webcams"}, "no driver named 'webcams'", CORRECT),
    ("cameras", "wrist", {"options": {"zoom": 2}}, "option of a webcam named 'zoom'", CORRECT),
    ("arms", "so101", {"address": "/dev/ttyACM77"}, "/dev/ttyACM77 does not exist", "rcs list --devices"),
)
"""Entries of the site that are wrong: kind, name and change, then as above."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[VirtualProcess, Path]]:
    log = tmp_path_factory.mktemp("lab") / "log"
    with (
        pytest.MonkeyPatch.context() as patch,
        VirtualProcess("so101", log=log, cameras=("wrist", "diagonal"), tactile=True) as process,
    ):
        patch.setattr(module, "RATE", 15)  # a busy machine draws no faster
        yield process, log


def examined(site: Site) -> list[Finding]:
    return examine(site, setup_for("so101"), seconds=2.0, packets=20)


def sound_site(virtual: VirtualProcess, part: str = "so101") -> Site:
    """Return the site without its tactile sensors, or that of one of these alone: a busy machine draws no more."""
    skins = virtual.site.tactile
    return Site(tactile={part: skins[part]}) if part in skins else replace(virtual.site, tactile={})


def require_fault(site: Site, part: str, words: str, remedy: str) -> None:
    """Check that a fault of a part is found, with these words and this remedy, and no other; a bus is that of two."""
    faults = [one for one in examined(site) if one.status == "fault"]
    parts = {one.part for one in faults}
    assert part in parts and parts <= {part, f"{part}/gripper"}, faults
    for one in faults:
        assert re.search(words, one.message), one
        assert re.search(remedy, one.remedy), one


def mend(virtual: VirtualProcess, told: tuple[object, ...]) -> None:
    sensor, slash, _ = str(told[0]).rpartition("/")
    virtual.tell(f"{sensor}{slash}clear")
    if told[0] == "overload":  # it lasts until the motor is switched off
        entry: Any = virtual.site.grippers["so101"]
        with So101Driver().gripper(entry.address, SO101_GRIPPER, entry.options) as gripper:
            gripper.recover()


def changed(site: Site, kind: str, name: str, **change: Any) -> Site:
    """Return a site with another entry, or with one more."""
    kinds: dict[str, dict[str, Any]] = {one: dict(getattr(site, one)) for one in KINDS}
    given = kinds[kind].get(name)
    base = {} if given is None else {"driver": given.driver, "address": given.address, "options": dict(given.options)}
    options = {**base.get("options", {}), **change.pop("options", {})}
    kinds[kind][name] = DeviceAddress(**{**base, **change, "options": options})
    return Site(**kinds)


def test_a_sound_lab_has_no_fault_and_the_robot_gets_no_command(lab: tuple[VirtualProcess, Path]) -> None:
    virtual, log = lab
    found = examined(sound_site(virtual))
    assert not [one for one in found if one.status == "fault"], found
    assert {one.part for one in found if one.status == "ok"} >= {"so101", "so101/gripper", "wrist", "diagonal"}
    assert [one.part for one in found].count("network 127.0.0.1") == 1, "both cameras are on this machine"
    assert len(read_points(log, "so101")) == 0


@pytest.mark.parametrize(("told", "part", "words", "remedy"), WIRES)
def test_a_fault_is_found_and_named_with_its_remedy_and_nothing_else(
    lab: tuple[VirtualProcess, Path], told: tuple[object, ...], part: str, words: str, remedy: str
) -> None:
    virtual, log = lab
    virtual.tell(*told)
    try:
        require_fault(sound_site(virtual, part), part, words, remedy)
    finally:
        mend(virtual, told)
    assert len(read_points(log, "so101")) == 0


@pytest.mark.parametrize(("kind", "name", "change", "words", "remedy"), SITES)
def test_what_is_wrong_in_the_site_is_found_and_nothing_else(
    lab: tuple[VirtualProcess, Path], kind: str, name: str, change: dict[str, Any], words: str, remedy: str
) -> None:
    require_fault(changed(sound_site(lab[0]), kind, name, **change), name, words, remedy)


def test_twenty_faults_are_tried() -> None:
    assert len(WIRES) + len(SITES) == 20


def test_the_arm_keeps_the_contract_at_5_percent_of_its_speed(lab: tuple[VirtualProcess, Path]) -> None:
    patient = changed(lab[0].site, "arms", "so101", options={"timeout": 0.6}).arms  # the machine may be busy
    site = Site(arms=patient)
    (found,) = move(site, setup_for("so101"), lambda _: True)
    assert found.status == "ok", found
    points, ticks = read_points(lab[1], "so101"), read_ticks(lab[1], "so101")
    assert len(points) > 0
    fast = np.abs(ticks["velocities"]).max(axis=0)
    assert (fast < 0.25 * np.array(SO101.velocity_limit)).all(), fast
