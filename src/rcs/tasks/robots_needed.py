"""What robots a task needs; where others are given, which of the installed ones fit is told."""

from __future__ import annotations

from collections.abc import Sequence

from rcs.devices import lookup
from rcs.devices.lookup import Kind
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot
from rcs.sim.scene import RobotPlacement


def require_robots(task: str, robots: Sequence[SimRobot], number: int = 1, *, hands: bool = False) -> None:
    """Check how many robots there are, and that each has what it takes hold with.

    Args:
        task: Name of the task.
        robots: Those of the setup.
        number: How many it needs.
        hands: Whether a hand will do in the place of a gripper.

    Raises:
        InvalidSetup: They are others; the message has what would fit.
    """
    kinds: tuple[Kind, ...] = ("gripper", "hand") if hands else ("gripper",)
    placements = [robot.placement for robot in robots]
    lacking = [one for one in placements if (one.end_effector if hands else one.gripper) is None]
    if len(robots) == number and not lacking:
        return
    each = "a gripper or a hand" if hands else "a gripper"
    needed = f"{task} needs one robot with {each}" if number == 1 else f"{task} needs {number} robots, each with {each}"
    if len(robots) != number:
        labs = {name: lookup.find("lab", name) for name in lookup.names("lab")}
        usual = {name for kind in kinds for name in lookup.names(kind)}
        fitting = [name for name, lab in labs.items() if len(lab.stands) == number and lab.end_effector in usual]
        raise InvalidSetup(
            f"{needed}; this setup has {len(robots)}. Choose another robot (robot=, --robot): {', '.join(fitting)}."
        )
    has = lacking[0].end_effector
    fitting = sorted(name for kind in kinds for name in lookup.names(kind) if _can_carry(lacking[0], kind, name))
    raise InvalidSetup(
        f"{needed}; {lacking[0].name!r} has {'none' if has is None else has.label}. "
        f"Choose another end effector (end_effector=, --end-effector): {', '.join(fitting)}."
    )


def _can_carry(robot: RobotPlacement, kind: Kind, name: str) -> bool:
    own = robot.arm.end_effectors
    made_for = getattr(lookup.find(kind, name), "arms", None)
    return (own is None or name in own) and (made_for is None or robot.arm.name in made_for)
