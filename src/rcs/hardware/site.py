"""Sites: the devices of a place and their addresses. A setup, in contrast, defines the experiment.

A site file is JSON, with an entry per real device under the name of its robot or camera; all others are simulated:

    {"arms": {"fr3": {"driver": "fake", "address": "192.0.2.1"}},
     "grippers": {"fr3": {"driver": "fake", "address": "192.0.2.1"}},
     "cameras": {"wrist": {"driver": "fake", "address": "0123456789"}},
     "tactile": {"fr3_left": {"driver": "fake", "address": "D20001"}},
     "stale_after": 0.5, "on_stale": "fault"}
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import json
import math
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from rcs.devices import Arm, Camera, CameraMode, Gripper, Hand, lookup
from rcs.errors import InvalidSetup, UnknownName
from rcs.hardware.devices import Devices, OnStale
from rcs.hardware.driver import Driver, driver_named
from rcs.hardware.hosted import Place, hosted, is_hosted
from rcs.robots.camera import CameraDescription
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription, GripperDescription, HandDescription
from rcs.robots.tactile import TactileDescription

KINDS = ("arms", "grippers", "hands", "cameras", "tactile")
_CLASSES = {"arm": Arm, "gripper": Gripper, "hand": Hand, "camera": Camera, "tactile": Camera}


@dataclass(frozen=True, kw_only=True)
class DeviceAddress:
    """The driver, address and options of a device."""

    driver: str
    """Name of a driver: an entry point of `rcs.drivers`, or `module:Class`."""
    address: str = ""
    """IP address, serial port or serial number, in the form that the driver takes."""
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Options of the driver, as JSON values. `host` (true or false) selects whether an arm, gripper or hand runs in a
    separate process; by default, the driver decides."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: Driver or address is not a string, or the options are not a mapping.
        """
        for name, kind in (("driver", str), ("address", str), ("options", Mapping)):
            if not isinstance(given := getattr(self, name), kind):
                valid = "a string" if kind is str else "a mapping from names to values"
                raise InvalidSetup(f"The {name} of a device is {given!r}; valid is {valid}.")

    @staticmethod
    def parse(given: Any, name: str) -> DeviceAddress:
        """Return an address from `driver:address`, `module:Class:address`, or a mapping with fields of this class.

        Raises:
            InvalidSetup: The value has none of these forms.
        """
        if isinstance(given, DeviceAddress):
            return given
        if isinstance(given, str):
            driver, address = _parted(given)
            given = {"driver": driver, "address": address}
        try:
            return DeviceAddress(**given)
        except InvalidSetup as err:
            raise InvalidSetup(f"The device {name!r}: {err}") from err
        except TypeError as err:
            raise InvalidSetup(
                f"The device {name!r} is given as {given!r}; valid is 'driver:address', 'module:Class:address', "
                "a mapping with 'driver', 'address' and 'options', or a device."
            ) from err


AnyDevice = DeviceAddress | Arm | Gripper | Hand | Camera


@dataclass(frozen=True, kw_only=True)
class Site:
    """The real devices of a place. Robots, end effectors, cameras and sensors without an entry are simulated."""

    arms: Mapping[str, AnyDevice] = field(default_factory=dict[str, AnyDevice])
    """Arms by robot name, as addresses or devices."""
    grippers: Mapping[str, AnyDevice] = field(default_factory=dict[str, AnyDevice])
    """Grippers by the name of their robot."""
    hands: Mapping[str, AnyDevice] = field(default_factory=dict[str, AnyDevice])
    """Hands by the name of their robot."""
    cameras: Mapping[str, AnyDevice] = field(default_factory=dict[str, AnyDevice])
    """Cameras by the name of their mount in the lab."""
    tactile: Mapping[str, AnyDevice] = field(default_factory=dict[str, AnyDevice])
    """Cameras of tactile sensors by the name of the sensor, such as `fr3_left` on the left finger of `fr3`."""
    valid_for: float | None = None
    """Time for which a command is valid without a new one [s]; afterwards arms, grippers and hands hold. None for three
    control periods. Synchronous steps may take longer: they send their targets again in every period."""
    stale_after: float = 0.5
    """Age of a frame, or of a measurement of a gripper or hand, from which the device counts as stale [s]."""
    arm_stale_after: float = 0.25
    """Age of an arm's measurement from which the arm counts as stale [s]. A stale arm, gripper or hand enters its fault
    state."""
    on_stale: OnStale = "fault"
    """Reaction to a stale camera: `flag` only marks frames, `hold` holds all devices until a new frame arrives, `fault`
    ends the episode."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A field has an invalid value.
        """
        for kind in KINDS:
            given: Any = getattr(self, kind)
            if not isinstance(given, Mapping):
                raise InvalidSetup(f"{kind} is {given!r}; valid is a mapping from names to devices.")
            made = {
                str(name): one if isinstance(one, Arm | Gripper | Hand | Camera) else DeviceAddress.parse(one, name)
                for name, one in given.items()
            }
            _require_places(kind, made)
            object.__setattr__(self, kind, made)
        if self.on_stale not in get_args(OnStale):
            raise InvalidSetup(f"on_stale is {self.on_stale!r}; valid: {', '.join(map(repr, get_args(OnStale)))}.")
        for name in ("valid_for", "stale_after", "arm_stale_after"):
            seconds = getattr(self, name)
            is_number = isinstance(seconds, int | float) and not isinstance(seconds, bool) and 0 < seconds < math.inf
            if not is_number and (name, seconds) != ("valid_for", None):
                raise InvalidSetup(f"{name} is {seconds!r} s; valid is a finite number above 0.")

    @staticmethod
    def read(path: str | Path) -> Site:
        """Read a site from a JSON file.

        Raises:
            InvalidSetup: The file cannot be read or does not describe a site.
        """
        try:
            content = json.loads(Path(path).read_text("utf-8"))
            return Site(**content)
        except InvalidSetup as err:
            raise InvalidSetup(f"The site file {path}: {err}") from err
        except (OSError, ValueError, RecursionError) as err:
            raise InvalidSetup(f"The site file {path} cannot be read: {err}.") from err
        except TypeError as err:
            fields = [one.name for one in dataclasses.fields(Site)]
            raise InvalidSetup(f"{path} is not a site file: {err}. Valid fields: {fields}.") from err

    def write(self, path: str | Path) -> None:
        """Write the site to a JSON file.

        Raises:
            InvalidSetup: The site contains device objects, which have no address.
        """
        for kind in KINDS:
            if objects := [name for name, one in getattr(self, kind).items() if not isinstance(one, DeviceAddress)]:
                raise InvalidSetup(
                    f"The {kind} {objects} are device objects, which cannot be written to a file; give their addresses."
                )
        Path(path).write_text(json.dumps(dataclasses.asdict(self), indent=2) + "\n", "utf-8")

    @staticmethod
    def of(
        hardware: Any,
        robots: Mapping[str, tuple[ArmDescription, Any]],
        cameras: Collection[str] = (),
        tactile: Collection[str] = (),
    ) -> Site:
        """Return the site for the argument `hardware` of `rcs.make`.

        Args:
            hardware: A site, the path of its file, `driver:address` for all arms and end effectors, or a mapping from
                names of robots (with their end effectors), `robot/gripper`, `robot/hand`, cameras and tactile sensors
                to addresses or devices.
            robots: Arm and end effector of every robot, by name.
            cameras: Names of the cameras of the setup.
            tactile: Names of its tactile sensors.

        Raises:
            InvalidSetup: `hardware` is none of these.
            UnknownName: A name is not that of a robot, camera or sensor.
        """
        if isinstance(hardware, Site):
            return hardware
        if isinstance(hardware, Path) or (isinstance(hardware, str) and hardware.endswith(".json")):
            return Site.read(hardware)
        if isinstance(hardware, str):
            hardware = dict.fromkeys(robots, hardware)
        if not isinstance(hardware, Mapping):
            raise InvalidSetup(
                f"hardware is {hardware!r}; valid is a Site, the path of its JSON file, 'driver:address', or a mapping "
                "from names of robots and cameras to these."
            )
        found: dict[str, dict[str, Any]] = {kind: {} for kind in KINDS}
        for name, given in hardware.items():
            robot, _, part = str(name).partition("/")
            if name in cameras:
                found["cameras"][name] = given
            elif name in tactile:
                found["tactile"][name] = given
            elif robot in robots and part in ("gripper", "hand"):
                found[f"{part}s"][robot] = given
            elif name in robots:
                found["arms"][name] = given
                effector = robots[name][1]
                if effector is not None and not isinstance(given, Arm):
                    kind = "grippers" if isinstance(effector, GripperDescription) else "hands"
                    found[kind].setdefault(name, _beside_arm(given, name))
            else:
                raise UnknownName("robot or camera of this setup", str(name), {*robots, *cameras, *tactile})
        arms, grippers, hands, views, skins = (found[kind] for kind in KINDS)
        return Site(arms=arms, grippers=grippers, hands=hands, cameras=views, tactile=skins)

    def devices(
        self,
        robots: Mapping[str, tuple[ArmDescription, GripperDescription | HandDescription | None]],
        cameras: Mapping[str, tuple[CameraDescription, CameraMode]],
        tactile: Mapping[str, TactileDescription] | None = None,
        compliance: Mapping[str, Compliance] | None = None,
    ) -> Devices:
        """Create the devices of a setup without connecting; a single instance of each driver makes all of its devices.

        Args:
            robots: Arm and end effector of every robot, by name.
            cameras: Description and requested mode of every camera, by name.
            tactile: Description of every tactile sensor, by name; None for none.
            compliance: Complete compliance of arms, by robot; None for stiff arms.

        Raises:
            UnknownName: A driver is not installed, or a robot is not part of the setup.
            InvalidSetup: A driver does not make such devices, a robot has no such end effector, or an arm does not
                support compliance.
        """
        arms: dict[str, Arm] = {}
        effectors: dict[str, Gripper | Hand] = {}
        views: dict[str, Camera] = {}
        skins: dict[str, Camera] = {}
        used: dict[str, AnyDevice] = {}
        drivers: dict[str, Driver] = {}
        for kind in ("arms", "grippers", "hands"):
            for name, given in getattr(self, kind).items():
                if name not in robots:
                    raise UnknownName("robot of this setup", name, robots)
                arm, effector = robots[name]
                if kind == "arms":
                    pliant = _giving_way(drivers, given, name, (compliance or {}).get(name))
                    arms[name] = _made(drivers, pliant, "arm", arm)
                    used[name] = given
                    continue
                wanted = GripperDescription if kind == "grippers" else HandDescription
                if not isinstance(effector, wanted):
                    raise InvalidSetup(
                        f"The site has {kind} for {name!r}, which carries {getattr(effector, 'name', None)}."
                    )
                effectors[name] = _made(drivers, given, kind[:-1], effector)
                used[f"{name}/{effector.name}"] = given
        # A site may have more cameras and sensors than a setup uses.
        for name, (about, mode) in cameras.items():
            if (given := self.cameras.get(name)) is not None:
                views[name] = _made(drivers, given, "camera", about, mode)
                used[name] = given
        for name, skin in (tactile or {}).items():
            if (given := self.tactile.get(name)) is not None:
                skins[name] = _made(drivers, given, "tactile", skin, CameraMode(*skin.frame_size, skin.rate, False))
                used[name] = given
        return Devices(
            arms=arms,
            tcp={
                name: given.options["tcp"]
                for name, given in self.arms.items()
                if isinstance(given, DeviceAddress) and "tcp" in given.options
            },
            effectors=effectors,
            cameras=views,
            tactile=skins,
            platform={name: _platform(given) for name, given in used.items()},
            site=self._hash(used) if used else None,
            valid_for=self.valid_for,
            stale_after=self.stale_after,
            arm_stale_after=self.arm_stale_after,
            on_stale=self.on_stale,
        )

    def _hash(self, used: Mapping[str, AnyDevice]) -> str:
        """Return the SHA-256 of all that the site says of the devices that a setup uses, by their names."""
        told = {
            name: dataclasses.asdict(given) if isinstance(given, DeviceAddress) else _platform(given)
            for name, given in used.items()
        }
        times = self.valid_for, self.stale_after, self.arm_stale_after, self.on_stale
        return hashlib.sha256(json.dumps([told, times], sort_keys=True, default=repr).encode()).hexdigest()


def places_of(site: Site) -> list[Place]:
    """Return the unique addresses of a site's devices that run in hosts."""
    drivers: dict[str, Driver] = {}
    given = [one for kind in KINDS[:3] for one in getattr(site, kind).values() if isinstance(one, DeviceAddress)]
    hosts = [one for one in given if is_hosted(_driver(drivers, one.driver), one.options)]
    return list(dict.fromkeys(_place(_driver(drivers, one.driver), one) for one in hosts))


def _place(driver: Driver, given: DeviceAddress) -> Place:
    return Place(driver=given.driver, address=given.address, library=driver.library(given.options))


def _made(drivers: dict[str, Driver], given: AnyDevice, kind: str, *about: Any) -> Any:
    """Return a device, made by the single instance of its driver."""
    device: Any = given
    if isinstance(given, DeviceAddress):
        driver = _driver(drivers, given.driver)
        runs_here = kind in ("camera", "tactile")  # so that the option `host` has no meaning, and the driver refuses it
        options = {name: value for name, value in given.options.items() if runs_here or name != "host"}
        device = getattr(driver, kind)(given.address, *about, options)
        if isinstance(device, Arm | Gripper | Hand) and is_hosted(driver, given.options):
            device = hosted(device, _place(driver, given), about[0], options, driver.host_times)
    if not isinstance(device, _CLASSES[kind]):
        raise InvalidSetup(f"Expected a device of rcs.devices.{_CLASSES[kind].__name__}; got {device!r}.")
    return device


def _giving_way(drivers: dict[str, Driver], given: AnyDevice, robot: str, compliance: Compliance | None) -> AnyDevice:
    """Return an arm's device with the compliance added to its options."""
    if not isinstance(given, DeviceAddress):
        if compliance is not None:
            raise InvalidSetup(
                f"The arm of {robot!r} is a device object, which takes no compliance; give its address, or leave "
                "compliance out."
            )
        return given
    can_give_way = _driver(drivers, given.driver).gives_way
    if can_give_way and "compliance" in given.options:
        raise InvalidSetup(f"The site has the option compliance for {robot!r}; set it in the setup instead.")
    if compliance is None:
        return given
    if not can_give_way:
        raise InvalidSetup(
            f"The setup has a compliance, but {robot!r} does not support it with the driver {given.driver!r}; valid "
            "are simulated arms and those of the driver 'franka'. Leave compliance out for a stiff arm."
        )
    return dataclasses.replace(given, options={**given.options, "compliance": compliance})


def _beside_arm(given: Any, name: str) -> Any:
    """Return the entry of an end effector that has none of its own, from that of its arm."""
    if not isinstance(given, Mapping | DeviceAddress):
        return given
    arm = DeviceAddress.parse(given, name)
    shares = getattr(lookup.find("driver", arm.driver), "shares_options", False)
    shared: Collection[str] = arm.options if shares else {"host"}
    return dataclasses.replace(arm, options={one: value for one, value in arm.options.items() if one in shared})


def _driver(drivers: dict[str, Driver], name: str) -> Driver:
    """Return the single instance of a driver."""
    if name not in drivers:
        drivers[name] = driver_named(name)
    return drivers[name]


def _parted(text: str) -> tuple[str, str]:
    """Return driver and address of `driver:address` or `module:Class:address`."""
    driver, _, rest = text.partition(":")
    if not rest or driver in lookup.names("driver") or not _is_module(driver):
        return driver, rest
    name, _, address = rest.partition(":")
    return f"{driver}:{name}", address


def _is_module(name: str) -> bool:
    """Return True if the name can be that of a module; nothing is imported."""
    top = name.partition(".")[0]
    return top in sys.modules or (top.isidentifier() and importlib.util.find_spec(top) is not None)


def _require_places(kind: str, devices: Mapping[str, AnyDevice]) -> None:
    """Check that the devices of a kind are different.

    Raises:
        InvalidSetup: Two are the same object or have the same address.
    """
    first: dict[Any, str] = {}
    for name, one in devices.items():
        is_address = isinstance(one, DeviceAddress)
        if is_address and not one.address:
            continue
        place = (one.driver, one.address) if is_address else id(one)
        if (taken := first.setdefault(place, name)) != name:
            where = f"at {one.driver}:{one.address}" if is_address else f"the device {one!r}"
            raise InvalidSetup(f"The {kind} {taken!r} and {name!r} are both {where}; give {name!r} its own.")


def _platform(given: AnyDevice) -> str:
    return given.driver if isinstance(given, DeviceAddress) else type(given).__name__
