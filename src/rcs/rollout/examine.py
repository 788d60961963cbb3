"""The examination of a lab: every device of a site is opened, read for some seconds, held and closed."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rcs.devices import Arm, Camera, Gripper
from rcs.envs.cameras import Cameras
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, MissingDependency, RcsError
from rcs.hardware.devices import Devices
from rcs.hardware.finding import Finding
from rcs.hardware.machine import examine_file, examine_machine, examine_network
from rcs.hardware.site import KINDS, DeviceAddress, Site
from rcs.hardware.usb import require_plugs
from rcs.setups.resolve import devices_of, resolve

READING = 10.0
"""How long a device is read [s]."""
LIMIT = 20.0
"""Time beyond that after which a device counts as one whose driver does not return [s]."""
RATE = 30
"""Rate at which cameras are read [frames/s]."""
SETTLING = 1.0
"""Time after opening that does not count [s]."""
LEAST_RATE = 0.8
"""Share of its rate that a camera must deliver."""
BLACK = 3.0
"""Mean of a picture below which it is black [of 255]."""


def setup_for(site: Site, robot: str) -> Setup:
    """Return a setup with the robot, the end effectors, the cameras and the sensors of a site."""
    cameras = Cameras(names=tuple(site.cameras), fps=RATE if site.cameras else None)
    return Setup(task="Free", robot=robot, cameras=cameras, tactile="digit" if site.tactile else None)


def examine(site: Site, setup: Setup, *, seconds: float = READING, packets: int = 1000) -> list[Finding]:
    """Examine this machine, the network, and every device of a site. Nothing moves.

    Args:
        site: The site.
        setup: A setup with its robots and cameras.
        seconds: How long each device is read [s]; all are read together.
        packets: Number of packets to each address.
    """
    found = examine_machine()
    places = {
        (one.address, one.driver)
        for kind in KINDS
        for one in getattr(site, kind).values()
        if isinstance(one, DeviceAddress)
    }
    names = {
        (one.address, name)
        for kind in KINDS
        for name, one in getattr(site, kind).items()
        if isinstance(one, DeviceAddress)
    }
    for address, driver in sorted(places):
        found += examine_network(address, driver, packets)
    for address, name in sorted(names):
        if address.startswith("/dev/"):
            found += examine_file(name, address)
    try:
        parts = resolve(setup)
        found += _entries(site, parts)
        devices = devices_of(site, parts)
        require_plugs({**devices.cameras, **devices.tactile})
    except RcsError as err:
        return [*found, Finding(part="site", status="fault", message=str(err), remedy="correct the site file")]
    return [*found, *_read_all(devices, seconds)]


def _entries(site: Site, parts: Parts) -> list[Finding]:
    """Return a fault for each entry of a site whose name is that of no part."""
    known = {
        "arms": [robot.name for robot in parts.robots],
        "cameras": [camera.name for camera in parts.cameras],
        "tactile": [sensor.name for sensor in parts.tactile],
    }
    return [
        Finding(part=name, status="fault", message=f"no {kind} has this name", remedy=f"valid: {', '.join(valid)}")
        for kind, valid in known.items()
        for name in getattr(site, kind)
        if name not in valid
    ]


def _read_all(devices: Devices, seconds: float) -> list[Finding]:
    """Open, read, hold and close all devices together, each on a thread."""
    stale = {"arm": devices.arm_stale_after, "other": devices.stale_after}
    every: dict[str, tuple[Any, float]] = {name: (arm, stale["arm"]) for name, arm in devices.arms.items()}
    for name, one in devices.effectors.items():
        every[f"{name}/{'gripper' if isinstance(one, Gripper) else 'hand'}"] = (one, stale["other"])
    every |= {name: (one, stale["other"]) for name, one in {**devices.cameras, **devices.tactile}.items()}
    results: dict[str, list[Finding]] = {}

    def work(name: str, device: Any, stale_after: float) -> None:
        results[name] = _examine(name, device, seconds, stale_after)

    threads = {
        name: threading.Thread(target=work, args=(name, *given), name=f"examination of {name}", daemon=True)
        for name, given in every.items()
    }
    for thread in threads.values():
        thread.start()
    until = time.monotonic() + seconds + LIMIT
    found: list[Finding] = []
    for name, thread in threads.items():
        thread.join(max(until - time.monotonic(), 0.0))
        late = Finding(
            part=name,
            status="fault",
            message=f"its driver has not returned from a call for {LIMIT:g} s",
            remedy="unplug it and plug it in again; end programs that use it",
        )
        found += results.get(name, [late])
    return found


def _examine(name: str, device: Any, seconds: float, stale_after: float) -> list[Finding]:
    """Open, read, hold and close a device."""
    found: list[Finding] = []
    try:
        device.open()
        found = _watch(name, device, seconds, stale_after)
        if not isinstance(device, Camera) and not device.fault:
            device.hold()
    except MissingDependency as err:
        found.append(Finding(part=name, status="fault", message=str(err), remedy=str(err).rpartition(": ")[2]))
    except Exception as err:  # noqa: BLE001  whatever a driver raises is what was looked for
        found.append(Finding(part=name, status="fault", message=str(err), remedy=_remedy(str(err))))
    finally:
        try:
            device.close()
        except Exception as err:  # noqa: BLE001  the same
            if not any(one.status == "fault" for one in found):
                message = f"it does not close: {err}"
                found.append(Finding(part=name, status="fault", message=message, remedy=_remedy(message)))
    return found


def _watch(name: str, device: Any, seconds: float, stale_after: float) -> list[Finding]:
    """Read an open device and return how it measured."""
    begin, times, calls, ages, last = time.monotonic(), list[float](), list[float](), list[float](), None
    while time.monotonic() - begin < min(SETTLING, 0.5 * seconds):  # its threads are starting
        _ = device.read() if isinstance(device, Camera) else device.state()
        time.sleep(0.002)
    while time.monotonic() - begin < seconds:
        called = time.monotonic()
        last = device.read() if isinstance(device, Camera) else device.state()
        calls.append(time.monotonic() - called)
        ages.append(time.monotonic() - last.time)
        mark = last.device_time if last.device_time == last.device_time else last.time
        if not times or mark != times[-1]:
            times.append(mark)
        time.sleep(0.002)
    gaps = np.diff(times)
    rate = 1.0 / float(np.mean(gaps)) if len(gaps) else 0.0
    gap = float(gaps.max()) if len(gaps) else seconds
    told = f"{rate:.1f} measurements/s, longest gap {1e3 * gap:.0f} ms, longest call {1e3 * max(calls):.0f} ms"

    def fault(message: str, remedy: str) -> list[Finding]:
        return [Finding(part=name, status="fault", message=f"{message}; {told}", remedy=remedy)]

    if device.fault:
        return fault(device.fault, _remedy(device.fault))
    if gap > stale_after:
        return fault(f"nothing new for {gap:.2f} s, more than {stale_after:g} s", "check its cable, network and load")
    if (age := float(np.median(ages))) > stale_after:
        return fault(f"measurements are {age:.2f} s old, more than {stale_after:g} s", "check its network and load")
    if isinstance(device, Camera):
        wanted = device.mode.fps
        if rate < LEAST_RATE * wanted:
            remedy = "give it more light or a shorter exposure, a port of its own, or ask for a lower rate"
            return fault(f"{rate:.1f} of {wanted:g} frames/s", remedy)
        assert last is not None, "it was read at least once"
        if float(np.mean(last.rgb)) < BLACK:
            return fault("its pictures are black", "take off the cover, switch on the light, set a longer exposure")
    elif isinstance(device, Arm):
        joints = np.array(device.state().joints)
        limits = device.limits
        beyond = (joints < np.array(limits.joint_lower)) | (joints > np.array(limits.joint_upper))
        if beyond.any():
            numbers = ", ".join(str(i + 1) for i in np.flatnonzero(beyond))
            message = f"joints {numbers} are out of their range; {told}"
            remedy = "move them back by hand, or calibrate"
            return [Finding(part=name, status="warning", message=message, remedy=remedy)]
    return [Finding(part=name, status="ok", message=told)]


_REMEDIES: Sequence[tuple[str, str]] = (
    ("another camera answers", "exchange the cables, or correct the address or serial number in the site"),
    ("Permission denied", "join the group of the file: sudo usermod -aG dialout,video $USER, then log in again"),
    ("is held by", "end that program"),
    ("version", "install the version of the library that fits the controller, or update the controller"),
    ("no camera answers", "switch the camera on, and check the address in the site"),
    ("does not offer", "choose one of the listed modes: image_size, fps"),
    ("stop", "release the stop on the device, then recover()"),
    ("reflex", "free the arm, then recover()"),
    ("brake", "unlock the brakes in the controller's interface"),
    ("volt", "check the power supply"),
    ("overload", "relieve the joint, switch it off and on"),
    ("refused", "switch the controller on, and check the address in the site"),
)
"""Words of a message, and what to do about it."""


def _remedy(message: str) -> str:
    for words, remedy in _REMEDIES:
        if words in message:
            return remedy
    return "check its power, cable and address, and that no other program uses it"


def read_site(path: Path) -> Site:
    """Read a site of addresses.

    Raises:
        InvalidSetup: The file is not that of a site, or the site is empty.
    """
    site = Site.read(path)
    if not any(getattr(site, kind) for kind in KINDS):
        raise InvalidSetup(f"{path} has no devices.")
    return site
