"""How real arms come to the start of an episode: slowly, each joint straight, and after a person has agreed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm
from rcs.envs import spaces as keys
from rcs.envs.spaces import ARM_KEYS, Observation
from rcs.envs.step.clock import Clock
from rcs.envs.step.stack import NAMELESS, Nested, Stack
from rcs.errors import DeviceFault, InvalidSetup, Refused
from rcs.sim.scene import RobotPlacement

SPEED = 0.05
"""Share of the joints' largest speeds, when nothing else is said: 5 % is slow enough to stop the arm by hand."""
SETTLING = 0.5
"""How long the last target is repeated, for arms that lag [s]."""
RESTING = 2.0
"""How long an arm that its controller leads to a pose may take to stand [s]."""
APART = 0.1
"""A joint that is farther from its target then has not arrived [rad]; servos without integrators sag by half of it."""

PEAK = 15 / 8
"""Largest speed of a motion with the least jerk over its mean speed."""

MayMove = bool | Callable[[str], bool]
"""Whether a person agrees that arms move; a function puts the question that it is given, and returns the answer."""


@dataclass(frozen=True, kw_only=True)
class Approach:
    """The start to which real robots go before an episode, and the permission to move."""

    placements: Sequence[RobotPlacement]
    """The robots of the environment."""
    robots: Mapping[str, Mapping[str, NDArray[Any]]]
    """For robots by name: `joints` [rad], and `gripper` or `hand`, which follows when the arm has arrived."""
    may_move: MayMove | None = None
    """Whether they may go; None where no person can be asked."""
    speed: float = SPEED
    """Largest speed of a joint as a share of its limit, above 0 and up to 1."""

    def __post_init__(self) -> None:
        """Check how it is to be done.

        Raises:
            InvalidSetup: The speed is out of range, or nobody can be asked.
        """
        speed: Any = self.speed
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0.0 < speed <= 1.0:
            raise InvalidSetup(f"The reset option 'speed' is {speed!r}; valid is a share above 0 and up to 1.")
        if self.may_move is not None and not isinstance(self.may_move, bool) and not callable(self.may_move):
            raise InvalidSetup(
                f"The reset option 'may_move' is {self.may_move!r}; valid is True, False, or a function that is given "
                "a question and returns whether a person agrees."
            )
        if self.robots and self.may_move is None:
            raise InvalidSetup(
                f"The reset option 'robot' moves real arms ({', '.join(self.robots)}), and nobody can be asked. Give "
                "'may_move' too: a function that puts the question that it is given to a person and returns whether "
                "they agree, or True where somebody watches."
            )

    def go(self, stack: Stack, clock: Clock, is_held: Callable[[], bool]) -> None:
        """Ask, and move; gates see every target on the way.

        Args:
            stack: All robots. Those without a target stay where they are measured.
            clock: Keeps the rate.
            is_held: Whether another thread has said since that all devices shall hold.

        Raises:
            InvalidSetup: A target is out of the range of the device; nothing has moved.
            Refused: The person does not agree, and nothing has moved; or a gate does not on the way, or `is_held`.
            DeviceFault: A device failed on the way, or an arm has not arrived.
        """
        question = self._question(self._ways(stack))
        if self.may_move is False or (callable(self.may_move) and self.may_move(question) is not True):
            raise Refused(f"Nothing has moved, because nobody agreed to this: {question}")
        clock.reset()
        self._come_to_rest(stack, clock)
        ways = self._ways(stack)  # anew: somebody may have moved an arm while the question was open
        stay = _stay(stack)
        for way in ways:
            for key in ARM_KEYS:
                stay[way.chain].pop(key, None)
        end: Mapping[str, Observation] = {}
        steps = math.ceil(self._duration(ways) * clock.frequency)
        settling = math.ceil(SETTLING * clock.frequency)
        for step in range(1, steps + settling + 1):
            targets: Nested = {name: dict(own) for name, own in stay.items()}
            for way in ways:
                targets[way.chain][keys.JOINTS] = way.start + _least_jerk(step / max(steps, 1)) * (way.goal - way.start)
                if step > steps:
                    targets[way.chain].update(way.effector)
            stack.lead(stack.admit(targets))
            if is_held():
                stack.hold()  # again: the first call may have been before the targets were sent
                raise Refused("`hold` was called while the arms were on their way; they stay where they are.")
            clock.tick()
            end = stack.measure()
            if faults := stack.faults():
                listed = "; ".join(f"{name}: {why}" for name, why in faults.items())
                raise DeviceFault(f"On the way to the start: {listed}.")
        for way in ways:
            apart = np.abs(end[way.chain][keys.JOINTS] - way.goal)
            if apart.max() > APART:
                joint = way.joints[int(apart.argmax())]
                raise DeviceFault(
                    f"{way.name} has not arrived: {joint} is {apart.max():.2f} rad from its target. Look at what holds "
                    "it, then start again."
                )

    def _ways(self, stack: Stack) -> list[_Way]:
        """Return the way of every robot that has one, from where it is measured now."""
        ways = list[_Way]()
        measured = stack.measure_devices()
        for one in self.placements:
            if (goal := self.robots.get(one.name)) is None:
                continue
            chain = NAMELESS if len(self.placements) == 1 else one.name
            box = stack.chains[chain].joint_space
            assert box is not None, "a robot has an arm"
            if not box.contains(goal[keys.JOINTS]):
                raise InvalidSetup(
                    f"{one.name} cannot go to the joints {np.round(goal[keys.JOINTS], 3)}; the device has the range "
                    f"{np.round(box.low, 3)} to {np.round(box.high, 3)}."
                )
            devices = [port.device for port in stack.chains[chain].ports if isinstance(port.device, Arm)]
            speeds = [arm.limits.joint_velocity for arm in devices]
            ways.append(
                _Way(
                    name=one.name,
                    chain=chain,
                    joints=one.arm.joints,
                    start=measured[chain][keys.JOINTS],
                    goal=goal[keys.JOINTS],
                    effector={key: value for key, value in goal.items() if key != keys.JOINTS},
                    speed=np.min([np.array(one.arm.velocity_limit), *speeds], axis=0),
                )
            )
        return ways

    def _come_to_rest(self, stack: Stack, clock: Clock) -> None:
        """Have arms stand that their controllers may still lead to a pose: only then are they led by joints."""
        ports = [
            port for chain in stack.chains.values() if keys.JOINTS not in chain.executed_spaces for port in chain.ports
        ]
        arms = [port for port in ports if port.joint_space is not None]
        for port in arms:
            port.hold()
        for _ in range(math.ceil(RESTING * clock.frequency)):
            if all(port.has_arrived() for port in arms):
                return
            clock.tick()

    def _duration(self, ways: Sequence[_Way]) -> float:
        """Return how long the longest way takes [s]; all robots arrive together."""
        longest = max(float((np.abs(way.goal - way.start) / way.speed).max()) for way in ways)
        return PEAK * longest / self.speed

    def _question(self, ways: Sequence[_Way]) -> str:
        parts: list[str] = []
        for way in ways:
            turns = np.abs(way.goal - way.start)
            parts.append(f"{way.name} by up to {turns.max():.2f} rad ({way.joints[int(turns.argmax())]})")
        return (
            f"Move {' and '.join(parts)} in {self._duration(ways):.0f} s, at {100 * self.speed:g} % of the largest "
            "speed, each joint straight to its target. Is the way free?"
        )


@dataclass(frozen=True, kw_only=True)
class _Way:
    """The way of one robot."""

    name: str
    chain: str
    joints: Sequence[str]
    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    effector: Mapping[str, NDArray[Any]]
    speed: NDArray[np.float64]


def _stay(stack: Stack) -> Nested:
    """Return targets with which all robots stay as they are: an arm also outside of its range."""
    stay: Nested = {}
    for name, own in stack.at_rest().items():
        boxes = stack.chains[name].executed_spaces
        stay[name] = {
            key: value if key == keys.JOINTS else np.clip(value, boxes[key].low, boxes[key].high)
            for key, value in own.items()
        }
    return stay


def _least_jerk(fraction: float) -> float:
    """Return the share of a way after a fraction of its time, with the least jerk, as human arms move.

    Flash and Hogan, "The coordination of arm movements", 1985.
    """
    x = min(fraction, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
