"""Labs: robots and where they stand, the workspace on their table, camera mounts and obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from rcs_data.options import Record, converted

from rcs.devices import lookup
from rcs.envs.task import Area
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.camera import CameraMount, looking
from rcs.robots.description import ArmDescription, Mount
from rcs.robots.mount import Obstacle

SPACING = 0.82
"""Distance of arms beside each other, in proportion to the larger reach: that of the two FR3 of the paper's lab."""


def _arm_name(given: str | ArmDescription) -> str:
    return lookup.name_of("arm", given)


class Stand(Record):
    """One robot of a lab."""

    name: str
    """Name in keys and prefixes."""
    arm: str = converted(converter=_arm_name)
    """The arm: its name, `module:NAME`, or its description."""
    base_in_scene: Mount = Mount()
    """Pose of its base frame in the scene, whose origin is on the table top."""


class Lab(Record):
    """Robots and their surroundings; `robot=` takes one that is a global variable of a module."""

    stands: tuple[Stand, ...]
    """Its robots."""
    end_effector: str | None
    """Name of the usual end effector of every robot; None for a bare flange."""
    area: Area
    """Where tasks take place."""
    cameras: Mapping[str, CameraMount] = field(default_factory=dict[str, CameraMount])
    """Camera mounts by name."""
    obstacles: Mapping[str, Obstacle] = field(default_factory=dict[str, Obstacle])
    """Boxes that stand still, by name; robots collide with them, and planners and guards know them."""
    about: str = ""
    """The lab in a sentence, for people."""


def lab_of(robot: str | Mapping[str, str]) -> Lab:
    """Return the lab of a robot: an installed one, or a plain one around an arm, or around arms side by side.

    Args:
        robot: Name of a lab or an arm, or `module:NAME` of one; or names of arms by name of the robot.

    Raises:
        UnknownName: There is neither a lab nor an arm of that name.
        InvalidSetup: The object is neither a lab nor an arm.
    """
    if isinstance(robot, Mapping):
        return side_by_side({name: _arm(arm) for name, arm in robot.items()}, robot)
    if robot in lookup.names("lab"):
        return lookup.find("lab", robot)
    found = _arm(robot)
    return found if isinstance(found, Lab) else plain_lab(robot, found)


def _arm(robot: str) -> ArmDescription | Lab:
    labs, arms = lookup.names("lab"), lookup.names("arm")
    if ":" not in robot and robot not in {*labs, *arms}:
        raise UnknownName("robot", robot, {*labs, *arms})
    found = lookup.find("lab" if robot in labs and robot not in arms else "arm", robot)
    if not isinstance(found, ArmDescription | Lab):
        raise InvalidSetup(f"{robot!r} is {found!r}; valid is an ArmDescription or a Lab.")
    return found


def plain_lab(name: str, arm: ArmDescription) -> Lab:
    """Return a lab for any arm: a workspace in the middle of its reach, and a camera that sees it from the side."""
    reach = arm.workspace_reach
    area = Area(center=(0.6 * reach, 0.0), size=(0.3 * reach, 0.4 * reach))
    side = CameraMount(
        camera="realsense_d435",
        optical=looking((0.8 * reach, 1.1 * reach, 0.6 * reach), (0.4 * reach, 0.0, 0.15 * reach)),
    )
    return Lab(stands=(Stand(name=arm.name, arm=name),), end_effector=None, area=area, cameras={"side": side})


def side_by_side(arms: Mapping[str, ArmDescription | Lab], names: Mapping[str, str]) -> Lab:
    """Return a lab of arms that stand beside each other, facing the same way, the first one at the left.

    Args:
        arms: The arms, by name of the robot.
        names: Their names, by name of the robot.

    Raises:
        InvalidSetup: One of them is a lab.
    """
    reaches: list[float] = []
    for name, arm in arms.items():
        if isinstance(arm, Lab):
            raise InvalidSetup(f"robot {name!r} is the lab {names[name]!r}; valid beside others is an arm.")
        reaches.append(arm.workspace_reach)
    apart = SPACING * max(reaches)
    stands: list[Stand] = []
    for i, name in enumerate(arms):
        # Built-in labs may turn their arm, so that its home pose points along x of the scene.
        known = (
            lookup.find("lab", names[name]).stands[0] if names[name] in lookup.names("lab") else Stand(name="", arm="")
        )
        y = apart * ((len(arms) - 1) / 2 - i)
        turned = Mount(translation=(0.0, y, 0.0), quaternion=known.base_in_scene.quaternion)
        stands.append(Stand(name=name, arm=names[name], base_in_scene=turned))
    reach = min(reaches)
    front = looking((2.0 * reach, 0.0, 1.0 * reach), (0.5 * reach, 0.0, 0.1 * reach))
    return Lab(
        stands=tuple(stands),
        end_effector=None,
        area=Area(center=(0.6 * reach, 0.0), size=(0.2 * reach, 0.12 * reach)),
        cameras={"front": CameraMount(camera="realsense_d435", optical=front)},
    )
