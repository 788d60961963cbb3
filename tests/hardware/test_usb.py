"""USB devices have names that last, are found by them only, and two cameras must fit on their bus."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from rcs.errors import InvalidSetup
from rcs.hardware.usb import Plug, capacity, find, require_plugs, usb_devices


def plug_in(root: Path, path: str, *, nodes: tuple[tuple[str, str], ...] = (), bus: int = 1, **about: str) -> None:
    """Add a device to a tree like that of `/sys`; nodes are pairs of class and name."""
    folder = root / "devices/pci0" / path
    interface = folder / f"{path}:1.0"
    interface.mkdir(parents=True)
    about = {"idVendor": "046d", "idProduct": "0825", "busnum": str(bus), "speed": "480", **about}
    for name, value in about.items():
        (folder / name).write_text(f"{value}\n")
    (root / "bus/usb/devices").mkdir(parents=True, exist_ok=True)
    (root / "bus/usb/devices" / path).symlink_to(folder)
    for number, (kind, name) in enumerate(nodes):
        entry = root / "class" / kind / name
        entry.mkdir(parents=True)
        (entry / "index").write_text(f"{number}\n")
        (entry / "device").symlink_to(interface)


@pytest.fixture
def sys(tmp_path: Path) -> Path:
    video = (("video4linux", "video2"), ("video4linux", "video1"))
    plug_in(tmp_path, "1-2", serial="A1", product="Webcam", nodes=video)
    plug_in(tmp_path, "1-3.1", product="Nameless webcam", nodes=(("video4linux", "video0"),))
    plug_in(tmp_path, "2-1", serial="D20001", product="DIGIT", bus=2, speed="5000", idVendor="2833")
    plug_in(tmp_path, "1-3", bDeviceClass="09", product="hub")
    return tmp_path


def test_devices_have_serial_numbers_or_places_and_their_files(sys: Path) -> None:
    found = {one.address: one for one in usb_devices(sys)}
    assert list(found) == ["A1", "usb:1-3.1", "D20001"], "hubs are no devices"
    assert found["A1"].nodes == ("video2", "video1"), "the first gives pictures, whatever its number"
    assert found["D20001"].speed == 5000
    assert str(replace(found["A1"], product="")) == "a device (A1) at USB 1-2, 480 Mbit/s"
    assert usb_devices(sys / "nothing") == []


def test_one_is_found_by_serial_number_or_place_and_never_by_number(sys: Path) -> None:
    devices = usb_devices(sys)
    assert find("A1", devices, "webcam") is find("usb:1-2", devices, "webcam")
    for absent in ("B2", "/dev/video0", "0", "", "usb:"):
        with pytest.raises(InvalidSetup) as told:
            find(absent, devices, "webcam")
        assert "A1" in str(told.value) and "usb:1-3.1" in str(told.value), "those that are there"


def test_two_with_one_serial_number_are_told_apart_by_their_places(sys: Path) -> None:
    plug_in(sys, "1-4", serial="A1")
    with pytest.raises(InvalidSetup, match=r"2 devices .* usb:1-2"):
        find("A1", usb_devices(sys), "webcam")
    assert find("usb:1-4", usb_devices(sys), "webcam").path == "1-4"


class Camera:
    def __init__(self, plug: Plug | None) -> None:
        self._plug = plug

    def plug(self) -> Plug | None:
        return self._plug


def test_cameras_that_are_one_device_or_too_much_for_a_bus_are_refused(sys: Path) -> None:
    a, b, fast = usb_devices(sys)

    def check(*plugs: Plug | None) -> None:
        require_plugs({f"camera {number}": Camera(plug) for number, plug in enumerate(plugs)} | {"other": object()})

    check(Plug(device=a, needs=200), Plug(device=b, needs=180), Plug(device=fast, needs=900), None, None)
    with pytest.raises(InvalidSetup, match="'camera 0' and 'camera 1' are both Webcam"):
        check(Plug(device=a, needs=1), Plug(device=a, needs=1))
    with pytest.raises(InvalidSetup, match=r"bus 1 need 400 Mbit/s of 384 at 480 .* camera 0 200 .* USB 3"):
        check(Plug(device=a, needs=200), Plug(device=b, needs=200))
    with pytest.raises(InvalidSetup, match="need 5000 Mbit/s of 3200"):
        check(Plug(device=fast, needs=5000))
    assert capacity(480) == pytest.approx(384)
