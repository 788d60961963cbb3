"""`rcs doctor` finds what is wrong with a virtual lab, over the wires of its arm and camera, and moves nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.hardware import Site
from rcs.hardware.finding import Finding
from rcs.hardware.site import KINDS, DeviceAddress
from rcs.robots.so101 import SO101
from rcs.rollout import examine as module
from rcs.rollout.examine import examine, setup_for
from rcs.rollout.exercise import move
from rcs.virtual import VirtualProcess, read_points, read_ticks

pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[VirtualProcess, Path]]:
    log = tmp_path_factory.mktemp("lab") / "log"
    with (
        pytest.MonkeyPatch.context() as patch,
        VirtualProcess("so101", log=log, cameras=("wrist", "diagonal")) as process,
    ):
        patch.setattr(module, "RATE", 15)  # a busy machine draws no faster
        yield process, log


def examined(site: Site) -> list[Finding]:
    return examine(site, setup_for(site, "so101"), seconds=2.0, packets=20)


def faults(site: Site) -> list[str]:
    return [f"{one.part}: {one.message} -> {one.remedy}" for one in examined(site) if one.status == "fault"]


def changed(site: Site, kind: str, name: str, **change: Any) -> Site:
    """Return a site with another entry, or without it."""
    kinds: dict[str, dict[str, Any]] = {one: dict(getattr(site, one)) for one in KINDS}
    given = kinds[kind].get(name)
    base = {} if given is None else {"driver": given.driver, "address": given.address, "options": dict(given.options)}
    options = {**base.get("options", {}), **change.pop("options", {})}
    kinds[kind][name] = DeviceAddress(**{**base, **change, "options": options})
    return Site(**kinds)


def test_a_sound_lab_has_no_fault_and_the_robot_gets_no_command(lab: tuple[VirtualProcess, Path]) -> None:
    virtual, log = lab
    found = examined(virtual.site)
    assert not [one for one in found if one.status == "fault"], found
    assert {one.part for one in found if one.status == "ok"} >= {"so101", "so101/gripper", "wrist", "diagonal"}
    assert len(read_points(log, "so101")) == 0


@pytest.mark.parametrize(
    ("told", "part", "words"),
    [
        (("cut",), "so101", ""),
        (("freeze", 20), "so101", ""),
        (("undervoltage",), "so101", "power supply"),
        (("version", 5), "so101", "5"),
        (("code", 4), "so101", ""),
        (("wrist/freeze", 20), "wrist", "no picture"),
        (("wrist/black",), "wrist", "cover"),
        (("wrist/tear",), "wrist", "damaged"),
        (("wrist/unplug", 20), "wrist", ""),
        (("wrist/swap", "diagonal"), "wrist", "another camera answers"),
        (("wrist/drop", 0.6), "wrist", ""),
    ],
)
def test_a_fault_is_found_named_and_nothing_else(
    lab: tuple[VirtualProcess, Path], told: tuple[object, ...], part: str, words: str
) -> None:
    virtual, log = lab
    virtual.tell(*told)
    try:
        found = faults(virtual.site)
    finally:
        sensor = str(told[0]).partition("/")[0] if "/" in str(told[0]) else ""
        virtual.tell(f"{sensor}/clear" if sensor else "clear")
    assert found, told
    assert all(one.startswith(part) for one in found), found
    assert words in " ".join(found), found
    assert len(read_points(log, "so101")) == 0


def test_what_is_wrong_in_the_site_is_found(lab: tuple[VirtualProcess, Path]) -> None:
    site = lab[0].site
    wrong = {
        "not 'another'": changed(site, "cameras", "wrist", options={"serial": "another"}),
        "no camera answers": changed(site, "cameras", "wrist", address="http://127.0.0.1:9/wrist"),
        "ceiling": changed(site, "cameras", "ceiling", driver="webcam", address="http://127.0.0.1:9/x"),
        "webcams": changed(site, "cameras", "wrist", driver="webcams"),
        "zoom": changed(site, "cameras", "wrist", options={"zoom": 2}),
        "/dev/ttyACM77 does not exist": changed(site, "arms", "so101", address="/dev/ttyACM77"),
    }
    for words, one in wrong.items():
        found = faults(one)
        assert words in " ".join(found), (words, found)


def test_the_arm_keeps_the_contract_at_5_percent_of_its_speed(lab: tuple[VirtualProcess, Path]) -> None:
    patient = changed(lab[0].site, "arms", "so101", options={"timeout": 0.6}).arms  # the machine may be busy
    site = Site(arms=patient)
    (found,) = move(site, setup_for(site, "so101"), lambda _: True)
    assert found.status == "ok", found
    points, ticks = read_points(lab[1], "so101"), read_ticks(lab[1], "so101")
    assert len(points) > 0
    fast = np.abs(ticks["velocities"]).max(axis=0)
    assert (fast < 0.25 * np.array(SO101.velocity_limit)).all(), fast
