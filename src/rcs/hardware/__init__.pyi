from rcs.hardware.device_clock import DeviceClock as DeviceClock
from rcs.hardware.driver import Driver as Driver
from rcs.hardware.driver import HostTimes as HostTimes
from rcs.hardware.fake import FakeDriver as FakeDriver
from rcs.hardware.link import Link as Link
from rcs.hardware.site import DeviceAddress as DeviceAddress
from rcs.hardware.site import Site as Site
