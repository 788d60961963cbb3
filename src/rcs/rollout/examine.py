"""The examination of a lab: every device of a site is opened, read for some seconds, held and closed."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rcs.devices import Arm, Camera, Gripper
from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, MissingDependency, RcsError, UnknownName
from rcs.hardware.devices import Devices
from rcs.hardware.finding import Finding
from rcs.hardware.machine import examine_file, examine_machine, examine_network, host_of, worst
from rcs.hardware.site import KINDS, AnyDevice, DeviceAddress, Site
from rcs.hardware.usb import require_plugs
from rcs.setups.resolve import devices_of, resolve, with_camera_names

READING = 10.0
"""How long a device is read [s]."""
LEAST_READING = 0.5
"""Shortest time for which a device is read [s]."""
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
LOOK_AT_IT = "check its power, cable and address, and that no other program uses it"
"""Remedy for a device in whose fault no words of `_REMEDIES` are."""
CORRECT_IT = "correct its entry in the site file, or name end effector or setup of the lab (--end-effector, --setup)"
"""Remedy for an entry of a site that no device can be made of."""


def setup_for(robot: str, end_effector: str | None = None) -> Setup:
    """Return a setup for an examination.

    Args:
        robot: Name of the robot, or of the lab with several.
        end_effector: Name of the gripper or hand; None for the usual one.
    """
    return Setup(task="Free", robot=robot, end_effector=end_effector, cameras=Cameras(fps=RATE))


def examine(site: Site, setup: Setup, *, seconds: float = READING, packets: int = 1000) -> list[Finding]:
    """Examine this machine, the network, and every device of a site. Nothing moves.

    Args:
        site: The site.
        setup: A setup with its robots; cameras and sensors of the site are added.
        seconds: How long each device is read [s]; all are read together.
        packets: Number of packets to each address.

    Raises:
        InvalidSetup: The setup or `seconds` is not valid.
        UnknownName: A name in the setup does not exist.
    """
    if not LEAST_READING <= seconds < math.inf:
        raise InvalidSetup(f"seconds is {seconds!r}; valid is a finite number, at least {LEAST_READING:g}.")
    setup = with_camera_names(setup)
    resolve(setup)
    found = examine_machine()
    hosts = {
        (host_of(one.address, one.driver), one.driver)
        for kind in KINDS
        for one in getattr(site, kind).values()
        if isinstance(one, DeviceAddress)
    }
    for host, driver in sorted(hosts):
        found += examine_network(host, driver, packets)
    sound, faults = _entries(site, setup)
    return [*found, *faults, *_read_all(devices_of(sound, resolve(_with_views(setup, sound))), seconds)]


def _entries(site: Site, setup: Setup) -> tuple[Site, list[Finding]]:
    """Return a site with the entries that a device can be made of, and a fault for each of the others."""
    sound: dict[str, dict[str, AnyDevice]] = {kind: {} for kind in KINDS}
    views: dict[str, Camera] = {}
    found: list[Finding] = []
    for kind in KINDS:
        for name, entry in getattr(site, kind).items():
            part = f"{name}/{kind[:-1]}" if kind in ("grippers", "hands") else name
            is_file = isinstance(entry, DeviceAddress) and entry.address.startswith("/dev/")
            files = examine_file(part, entry.address) if is_file else []
            found += files
            if worst(files) == "fault":
                continue
            alone = replace(site, **{**{one: {} for one in KINDS}, kind: {name: entry}})
            try:
                parts = resolve(_with_views(setup, alone))
                if kind == "tactile" and name not in (valid := [one.name for one in parts.tactile]):
                    raise UnknownName("tactile sensor of this setup", name, valid)
                devices = devices_of(alone, parts)
                more = {**devices.cameras, **devices.tactile}
                require_plugs({**views, **more})
            except RcsError as err:
                found.append(_fault(part, err, CORRECT_IT))
            else:
                views |= more
                sound[kind][name] = entry
    return replace(site, **sound), found


def _with_views(setup: Setup, site: Site) -> Setup:
    """Return a setup that has the cameras of a site, too, and tactile sensors if the site has any."""
    names = tuple(dict.fromkeys((*setup.cameras.names, *site.cameras)))
    tactile = (setup.tactile or "digit") if site.tactile else None
    return replace(setup, cameras=replace(setup.cameras, names=names), tactile=tactile)


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
    except Exception as err:  # noqa: BLE001  whatever a driver raises is what was looked for
        found.append(_fault(name, err))
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
    newest = time.monotonic()
    while not calls or time.monotonic() - begin < seconds:
        called = time.monotonic()
        last = device.read() if isinstance(device, Camera) else device.state()
        calls.append(time.monotonic() - called)
        ages.append(time.monotonic() - last.time)
        mark = last.device_time if last.device_time == last.device_time else last.time
        if not times or mark != times[-1]:
            times.append(mark)
            newest = time.monotonic()
        time.sleep(0.002)
    gaps = np.diff(times)
    rate = 1.0 / float(np.mean(gaps)) if len(gaps) else 0.0
    gap = max(float(gaps.max()), time.monotonic() - newest) if len(gaps) else seconds
    text = f"{rate:.1f} measurements/s, longest gap {1e3 * gap:.0f} ms, longest call {1e3 * max(calls):.0f} ms"

    def fault(message: str, remedy: str) -> list[Finding]:
        return [Finding(part=name, status="fault", message=f"{message}; {text}", remedy=remedy)]

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
            message = f"joints {numbers} are out of their range; {text}"
            remedy = "move them back by hand, or calibrate"
            return [Finding(part=name, status="warning", message=message, remedy=remedy)]
    return [Finding(part=name, status="ok", message=text)]


_REMEDIES: Sequence[tuple[str, str]] = (
    ("Plugged in: ", "plug it in, or correct its address in the site file; `rcs list --devices` shows what is there"),
    ("another camera answers", "exchange the cables, or correct the address or serial number in the site"),
    ("Permission denied", "join the group of the file: sudo usermod -aG dialout,video $USER, then log in again"),
    ("is held by", "end that program"),
    ("version", "install the version of the library that fits the controller, or update the controller"),
    ("no camera answers", "switch the camera on, and check the address in the site"),
    ("is not the expected one", "connect the arm of this entry, or correct its address or calibration"),
    ("overheating", "let it cool down, and look for what it has to hold"),
    ("does not offer", "choose one of the listed modes: image_size, fps"),
    ("stop", "release the stop on the device, then recover()"),
    ("reflex", "free the arm, then recover()"),
    ("brake", "unlock the brakes in the controller's interface"),
    ("volt", "check the power supply"),
    ("overload", "relieve the joint, switch it off and on"),
    ("refused", "switch the controller on, and check the address in the site"),
)
"""Words of a message, and what to do about it."""


def _remedy(message: str, usual: str = LOOK_AT_IT) -> str:
    return next((remedy for words, remedy in _REMEDIES if words in message), usual)


def _fault(part: str, err: Exception, usual: str = LOOK_AT_IT) -> Finding:
    """Return the fault of a part that an error reports; that of a missing package says the remedy itself."""
    message = str(err)
    remedy = message.rpartition(": ")[2] if isinstance(err, MissingDependency) else _remedy(message, usual)
    return Finding(part=part, status="fault", message=message, remedy=remedy)
