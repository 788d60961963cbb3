"""Who stands by real robots while episodes are collected: agrees to motions, places the objects, and judges."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.setup import Setup
from rcs.envs.spaces import Observation
from rcs.errors import InvalidSetup, Refused, UnknownName
from rcs.hardware.site import DeviceAddress, Site
from rcs.rollout.episode import ask
from rcs.setups.make import site_of
from rcs.spatial import Pose
from rcs.virtual.control import running, tell
from rcs.virtual.virtual_world import ABOUT, JUDGE, VERDICTS

ENDED = "The input has ended, so nobody can be asked any more."


class Operator(ABC):
    """Stands by real robots."""

    @abstractmethod
    def may_move(self, question: str) -> bool:
        """Return whether the arms may go home, which the question describes; called before every episode."""

    @abstractmethod
    def place(self, seed: int, poses: Mapping[str, NDArray[np.float64]]) -> None:
        """Put the objects where they belong, and return when they lie there.

        Args:
            seed: Of the episode.
            poses: Poses by name, (7,) [m], xyzw, in the base frame; with several robots, in the scene.
        """

    @abstractmethod
    def judge(self, observation: Observation, info: Mapping[str, Any]) -> bool | None:
        """Return whether the task was done; None if that is not known."""

    @abstractmethod
    def may_recover(self, faults: str) -> bool:
        """Return whether devices may leave their fault state, and the episode be made again."""


class TerminalOperator(Operator):
    """The person at the terminal."""

    def __init__(self, *, agrees: bool = False) -> None:
        """Ask before the first motion, and again after a fault.

        Args:
            agrees: Whether the person has agreed to all motions, so that they are not asked.
        """
        self._always_agrees = self._agrees = agrees

    def may_move(self, question: str) -> bool:
        """Ask once."""
        self._agrees = self._agrees or _agrees(f"Before every episode, and now: {question}")
        return self._agrees

    def place(self, seed: int, poses: Mapping[str, NDArray[np.float64]]) -> None:
        """Say where every object is to lie, and wait."""
        if poses:
            places = "; ".join(f"the {name} at {_words(pose)}" for name, pose in poses.items())
            _input(f"Put {places}. Then press Enter: ")

    def judge(self, observation: Observation, info: Mapping[str, Any]) -> bool | None:
        """Ask."""
        try:
            return ask(observation, info)
        except EOFError as err:
            raise Refused(ENDED) from err

    def may_recover(self, faults: str) -> bool:
        """Ask."""
        self._agrees = self._always_agrees
        return _agrees(f"{faults} Look at the robot. Clear the fault, and make this episode again?")


class VirtualOperator(Operator):
    """Stands by a virtual robot, whose own world has the objects and knows how the task went."""

    def __init__(self, name: str) -> None:
        """Take the name of a virtual robot that runs."""
        self.name = name
        self._has_begun = False

    @staticmethod
    def of(site: Site, setup: Setup) -> VirtualOperator | None:
        """Return who stands by the virtual robot of this machine that is at a site's addresses; None if there is none.

        Raises:
            InvalidSetup: Its scene is that of another task.
        """
        places = {one.address for one in site.arms.values() if isinstance(one, DeviceAddress)}
        for name in running():
            try:
                about = json.loads(tell(name, (ABOUT,)))
            except (InvalidSetup, UnknownName, ValueError):  # it hangs, has ended meanwhile, or is of another version
                continue
            if not places & {entry["address"] for entry in about["site"]["arms"].values()}:
                continue
            theirs = Setup.from_json(about["setup"])
            if (theirs.task, theirs.task_options) != (setup.task, setup.task_options):
                raise InvalidSetup(
                    f"The virtual robot {name!r} has the scene of {_task(theirs)}, not of {_task(setup)}; start it "
                    "with --setup FILE, the JSON of the setup that is wanted."
                )
            return VirtualOperator(name)
        return None

    def may_move(self, question: str) -> bool:
        """Agree."""
        return True

    def place(self, seed: int, poses: Mapping[str, NDArray[np.float64]]) -> None:
        """Have the objects lie where the seed has them."""
        self._has_begun = True
        tell(self.name, ("reset", str(seed)))

    def judge(self, observation: Observation, info: Mapping[str, Any]) -> bool | None:
        """Return whether the task was done in the robot's world."""
        answer = tell(self.name, (JUDGE,))
        return next(verdict for verdict, word in VERDICTS.items() if word == answer)

    def may_recover(self, faults: str) -> bool:
        """Clear what was left from before; refuse from the first episode on, for a fault is worth a look."""
        return not self._has_begun


def operator_of(setup: Setup, hardware: Any, *, agrees: bool = False) -> Operator:
    """Return who stands by: the world of the virtual robot at a site's addresses, or else the person at the terminal.

    Args:
        setup: What is done.
        hardware: What is real, as in `rcs.make`.
        agrees: Whether the person has agreed to all motions.

    Raises:
        InvalidSetup: The virtual robot's scene is that of another task.
    """
    return VirtualOperator.of(site_of(setup, hardware), setup) or TerminalOperator(agrees=agrees)


def _task(setup: Setup) -> str:
    return f"{setup.task} {setup.task_options or ''}".rstrip()


def _words(pose: NDArray[np.float64]) -> str:
    """Return a pose in words."""
    x, y, z = pose[:3]
    roll, pitch, yaw = np.rad2deg(Pose.from_tquat(pose).xyzrpy[3:])
    tilt = f"rolled by {roll:.0f}° and pitched by {pitch:.0f}°, then " if max(abs(roll), abs(pitch)) > 1 else ""
    return (
        f"x {x:.3f} m, y {y:.3f} m, z {z:.3f} m in the frame of the base (its middle), {tilt}turned by {yaw:.0f}° "
        "counterclockwise"
    )


def _agrees(question: str) -> bool:
    return _input(f"{question} [y]es, [n]o: ").strip().lower() in ("y", "yes")


def _input(question: str) -> str:
    try:
        return input(question)
    except EOFError as err:
        raise Refused(ENDED) from err
