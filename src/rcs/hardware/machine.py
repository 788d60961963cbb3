"""Whether a machine is fit to control robots: kernel, processors, permissions, and the network to each robot."""

from __future__ import annotations

import ipaddress
import os
import platform
import re
import resource
import select
import socket
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from rcs.hardware.finding import Finding
from rcs.hardware.plugged_in import lasting_name
from rcs.hardware.serial_port import group_of
from rcs.hardware.usb import BY_PATH

PACKETS = 1000
"""Number of packets that are sent to an address."""
LONGEST_ANSWER = 0.5
"""Time after which an answer counts as lost [s]."""
MOST_LOSS, MOST_DELAY = 0.002, 1e-3
"""Loss [1] above which a controller of 1 kHz breaks off sooner or later, and delay at 99 % [s] above which it may."""
RATES = {"franka": 1000.0, "ur": 500.0, "xarm": 250.0}
"""Rate at which a driver's arm gets commands [1/s]; 100 for others."""
NAMED = (*RATES, "robotiq")
"""Drivers whose address may be the name of a host."""
_ECHO, _ANSWER = 8, 0
_NUMBERED = re.compile(r"/dev/tty(USB|ACM)\d+")


def examine_machine(root: Path = Path("/sys")) -> list[Finding]:
    """Return findings about kernel, processors and permissions of this machine."""
    found = [Finding(part="machine", status="ok", message=f"{platform.platform()}, {os.cpu_count()} processors")]
    governors = {
        file.read_text().strip() for file in (root / "devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    }
    if governors - {"performance"}:
        found.append(
            Finding(
                part="machine",
                status="warning",
                message=f"processors change their clock (governor {', '.join(sorted(governors))}), which delays loops",
                remedy="sudo cpupower frequency-set -g performance",
            )
        )
    if not _is_real_time(root):
        found.append(
            Finding(
                part="machine",
                status="warning",
                message="the kernel has no PREEMPT_RT; arms at 1 kHz may lose single packets under load",
                remedy="install a real-time kernel, such as linux-image-rt-amd64 on Debian",
            )
        )
    if resource.getrlimit(resource.RLIMIT_RTPRIO)[1] == 0 and os.geteuid() != 0:
        found.append(
            Finding(
                part="machine",
                status="warning",
                message="this user may not run threads with real-time priority",
                remedy="add `@realtime - rtprio 99` to /etc/security/limits.conf, join the group, and log in again",
            )
        )
    return found


def examine_file(part: str, path: str) -> list[Finding]:
    """Return findings about a file in `/dev` that a device needs: it exists, lasts, and this user may use it."""
    if not os.path.exists(path):
        remedy = "plug it in; `rcs list --devices` shows what is there"
        return [Finding(part=part, status="fault", message=f"{path} does not exist", remedy=remedy)]
    if os.access(path, os.R_OK | os.W_OK):
        if not _NUMBERED.fullmatch(path):
            return []
        message = f"the number in {path} changes with the order of plugging"
        remedy = f"write {lasting_name(path) or 'its serial number or place'} in its stead in the site file"
        return [Finding(part=part, status="warning", message=message, remedy=remedy)]
    return [
        Finding(
            part=part,
            status="fault",
            message=f"{path} may not be used by this user",
            remedy=f"sudo usermod -aG {group_of(path)} $USER, then log in again",
        )
    ]


def host_of(address: str, driver: str) -> str:
    """Return the host of a device; empty for one that is on no network.

    Args:
        address: Address of the device in a site: an IP address, a URL, or for drivers in `NAMED` a name; a port may
            follow.
        driver: Name of its driver.
    """
    is_url = "://" in address
    if address.startswith(BY_PATH):
        return ""
    try:
        host = urlsplit(address if is_url else f"//{address}").hostname or ""
        if not is_url and driver not in NAMED:
            ipaddress.ip_address(host)
    except ValueError:  # a serial number, such as that of a camera
        return ""
    return host


def examine_network(host: str, driver: str, packets: int = PACKETS) -> list[Finding]:
    """Send packets to a host at the rate of its arm and return findings about loss and delay.

    Args:
        host: IP address or name; there is nothing to find for an empty one.
        driver: Name of its driver, for the rate.
        packets: How many packets.
    """
    if not host:
        return []
    part, rate = f"network {host}", RATES.get(driver, 100.0)
    try:
        address = socket.gethostbyname(host)
    except OSError as err:
        remedy = "correct the name, or give the IP address in its place; look at the name server (resolvectl status)"
        return [Finding(part=part, status="fault", message=f"no address of this name: {err.strerror}", remedy=remedy)]
    try:
        delays = ping(address, packets, rate)
    except PermissionError:
        remedy = "sudo sysctl -w net.ipv4.ping_group_range='0 2147483647'"
        return [Finding(part=part, status="warning", message="this user may not measure delays", remedy=remedy)]
    except OSError as err:
        remedy = "give this machine an address in the same network; look at cable and interface (ip addr)"
        return [Finding(part=part, status="fault", message=f"no route: {err.strerror or err}", remedy=remedy)]
    if not delays:
        remedy = "switch it on, and check cable and address"
        return [Finding(part=part, status="fault", message=f"no answer to {packets} packets", remedy=remedy)]
    loss, late = 1.0 - len(delays) / packets, float(np.percentile(delays, 99))
    told = (
        f"{packets} packets at {rate:g} Hz: {100 * loss:.1f} % lost, delay {1e3 * float(np.median(delays)):.2f} ms, "
        f"99 % below {1e3 * late:.2f} ms"
    )
    if loss > MOST_LOSS or late > MOST_DELAY:
        remedy = "connect the robot by a cable of its own, without Wi-Fi, switch or USB adapter in between"
        status = "fault" if loss > 10 * MOST_LOSS else "warning"
        return [Finding(part=part, status=status, message=told, remedy=remedy)]
    return [Finding(part=part, status="ok", message=told)]


def ping(address: str, packets: int, rate: float) -> list[float]:
    """Send echo requests at a rate and return the delays of their answers [s].

    Raises:
        PermissionError: This user may not.
        OSError: There is no way to the address.
    """
    with _echo_socket() as echo:
        echo.setblocking(False)
        sent: dict[int, float] = {}
        delays: list[float] = []
        begin = time.monotonic()
        for number in range(packets):
            head = struct.pack(">BBHHH", _ECHO, 0, 0, os.getpid() & 0xFFFF, number & 0xFFFF)
            packet = head[:2] + struct.pack(">H", _checksum(head)) + head[4:]
            sent[number & 0xFFFF] = time.monotonic()
            echo.sendto(packet, (address, 0))
            _collect(echo, sent, delays, begin + (number + 1) / rate)
        until = time.monotonic() + LONGEST_ANSWER
        while sent and time.monotonic() < until:
            _collect(echo, sent, delays, min(time.monotonic() + 0.05, until))
        return delays


def _echo_socket() -> socket.socket:
    try:
        return socket.socket(socket.AF_INET, socket.SOCK_DGRAM, socket.IPPROTO_ICMP)
    except PermissionError:
        return socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_ICMP)


def _collect(echo: socket.socket, sent: dict[int, float], delays: list[float], until: float) -> None:
    """Take answers until a time [s, monotonic]."""
    while (rest := until - time.monotonic()) > 0:
        if not select.select([echo], [], [], rest)[0]:
            return
        answer = echo.recv(2048)
        now = time.monotonic()
        if echo.type == socket.SOCK_RAW:  # with the header of IP
            answer = answer[4 * (answer[0] & 0xF) :]
        kind, _, _, identifier, number = struct.unpack(">BBHHH", answer[:8])
        # A raw socket gets the answers to all programs; of a datagram socket, the kernel chooses the identifier.
        is_ours = echo.type != socket.SOCK_RAW or identifier == os.getpid() & 0xFFFF
        if kind == _ANSWER and is_ours and number in sent:
            delays.append(now - sent.pop(number))


def _checksum(packet: bytes) -> int:
    total = sum(struct.unpack(f">{len(packet) // 2}H", packet))
    total = (total >> 16) + (total & 0xFFFF)
    return ~(total + (total >> 16)) & 0xFFFF


def _is_real_time(root: Path) -> bool:
    file = root / "kernel/realtime"
    return (file.exists() and file.read_text().strip() == "1") or "PREEMPT_RT" in platform.version()


def worst(findings: Sequence[Finding]) -> str:
    """Return the worst status of findings."""
    found = {one.status for one in findings}
    return "fault" if "fault" in found else "warning" if "warning" in found else "ok"
