"""Real devices by name: a site says which drivers reach them and where."""

from rcs.hardware.driver import Driver
from rcs.hardware.fake import FakeDriver
from rcs.hardware.site import DeviceAddress, Devices, Site

__all__ = ["DeviceAddress", "Devices", "Driver", "FakeDriver", "Site"]
