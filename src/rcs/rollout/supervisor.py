"""Supervisors of real robots during a collection: they agree to motions, place the objects, and judge."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.setup import Setup
from rcs.envs.spaces import Observation
from rcs.errors import InvalidSetup, UnknownName
from rcs.hardware.site import DeviceAddress, Site
from rcs.rollout.episode import Answer
from rcs.rollout.outlines import in_words
from rcs.rollout.person import PersonJudge, agrees, read_line
from rcs.setups.make import site_of
from rcs.virtual.control import running, tell
from rcs.virtual.virtual_world import ABOUT, JUDGE, LOOK, VERDICTS


class Supervisor(ABC):
    """Supervises real robots."""

    @abstractmethod
    def may_move(self, question: str) -> bool:
        """Return whether the arms may go home, which the question describes; called before every episode."""

    @abstractmethod
    def place(self, seed: int, poses: Mapping[str, NDArray[np.float64]]) -> None:
        """Place the objects, and return when they are there.

        Args:
            seed: Seed of the episode.
            poses: Poses by name, (7,) [m], xyzw, in the base frame; with several robots, in the scene.
        """

    @abstractmethod
    def look(self, poses: Mapping[str, NDArray[np.float64]]) -> Mapping[str, NDArray[np.float64]] | None:
        """Return where the objects lie, once a robot has set them down; None if not about where it believes them.

        Args:
            poses: Where the robot believes them, as in `place`.
        """

    @abstractmethod
    def judge(self, observation: Observation, info: Mapping[str, Any]) -> Answer | bool | None:
        """Return an answer, or only whether the task was done; None if that is not known."""

    @abstractmethod
    def may_recover(self, faults: str) -> bool:
        """Return whether the episode that a fault has ended may be made again, and devices leave their fault state."""


class TerminalSupervisor(Supervisor):
    """The person at the terminal."""

    def __init__(self, *, is_agreed: bool = False) -> None:
        """Ask before the first motion, and again after a fault.

        Args:
            is_agreed: Do not ask before motions, because the person has agreed to all of them.
        """
        self._always_agrees = self._agrees = is_agreed

    def may_move(self, question: str) -> bool:
        """Ask once."""
        self._agrees = self._agrees or agrees(f"Before every episode, and now: {question}")
        return self._agrees

    def place(self, seed: int, poses: Mapping[str, NDArray[np.float64]]) -> None:
        """Print the places of all objects, and wait."""
        if poses:
            read_line(f"Put {in_words(poses)}. Then press Enter: ")

    def look(self, poses: Mapping[str, NDArray[np.float64]]) -> Mapping[str, NDArray[np.float64]] | None:
        """Ask."""
        return poses if agrees(f"The robot has put {in_words(poses)}. Does it lie there?") else None

    def judge(self, observation: Observation, info: Mapping[str, Any]) -> Answer:
        """Ask."""
        return PersonJudge()(observation, info)

    def may_recover(self, faults: str) -> bool:
        """Ask."""
        self._agrees = self._always_agrees
        return agrees(f"{faults} Look at the robot. Clear the fault, and make this episode again?")


class VirtualSupervisor(Supervisor):
    """Operates a virtual robot, whose own world has the objects and judges the task."""

    def __init__(self, name: str) -> None:
        """Take the name of a running virtual robot."""
        self.name = name
        self._has_begun = False

    @staticmethod
    def of(site: Site, setup: Setup) -> VirtualSupervisor | None:
        """Return the supervisor of the virtual robot of this machine at a site's addresses; None if there is none.

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
            if (theirs.task, _options(theirs)) != (setup.task, _options(setup)):
                raise InvalidSetup(
                    f"The virtual robot {name!r} has the scene of {_task(theirs)}, not of {_task(setup)}; start it "
                    "with --setup FILE, the JSON of the wanted setup."
                )
            return VirtualSupervisor(name)
        return None

    def may_move(self, question: str) -> bool:
        """Agree."""
        return True

    def place(self, seed: int, poses: Mapping[str, NDArray[np.float64]]) -> None:
        """Place the objects according to the seed."""
        self._has_begun = True
        tell(self.name, ("reset", str(seed)))

    def look(self, poses: Mapping[str, NDArray[np.float64]]) -> Mapping[str, NDArray[np.float64]] | None:
        """Return where the robot's world has the objects, as a camera that measures them would."""
        return {name: np.array(pose) for name, pose in json.loads(tell(self.name, (LOOK,))).items()}

    def judge(self, observation: Observation, info: Mapping[str, Any]) -> bool | None:
        """Return whether the task was done in the robot's world."""
        answer = tell(self.name, (JUDGE,))
        return next(verdict for verdict, word in VERDICTS.items() if word == answer)

    def may_recover(self, faults: str) -> bool:
        """Clear old faults; refuse from the first episode on, because a fault is worth a look."""
        return not self._has_begun


def supervisor_of(setup: Setup, hardware: Any, *, is_agreed: bool = False) -> Supervisor:
    """Return the supervisor: the world of the virtual robot at a site's addresses, or the user at the terminal.

    Args:
        setup: The setup of the episodes.
        hardware: The real devices, as in `rcs.make`.
        is_agreed: Do not ask before motions, because the person has agreed to all of them.

    Raises:
        InvalidSetup: The virtual robot's scene is that of another task.
    """
    return VirtualSupervisor.of(site_of(setup, hardware), setup) or TerminalSupervisor(is_agreed=is_agreed)


def _options(setup: Setup) -> dict[str, Any]:
    """Return the task options that decide what the scene is."""
    return {name: value for name, value in setup.task_options.items() if name != "placed_by"}


def _task(setup: Setup) -> str:
    return f"{setup.task} {setup.task_options or ''}".rstrip()
