"""One robot that follows one hand, behind a clutch.

A hand is released, engaged or held. It is held from the start, and whenever it cannot be followed; the robot then
brakes and stays. From there it is released first, and engaged only when the clutch is pressed after that, or, without a
clutch, when the hand was moved and rests. Engaged, the TCP makes the way of the hand from where both were at that
moment, so that engaging moves nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Meta, NotNegative, Positive, Record

from rcs.agents.guide import SPEED, TURN_SPEED, Guide
from rcs.envs.spaces import Action, Observation
from rcs.kinematics.chain import POSE
from rcs.spatial import Pose, compose, distance, interpolate, inverse, limit_step
from rcs.teleop.device import Button, HandReading

State = Literal["released", "engaged", "held"]

LEAD = 0.1, 0.5
"""Longest way of the wanted pose before the TCP [m, rad]. A hand's way beyond it is lost, so that the robot does not
go on for seconds after a fast hand has stopped."""

SAME = 1e-3, 1e-2
"""A target this near to the measured TCP [m, rad] is where the arm stands; its servos are off by no more."""

NEAR = 0.2
"""Largest distance of each joint of a leader from its follower's at which it engages [rad]."""

MET = 0.02
"""Distance at which a follower has caught up [rad]."""

CATCH_UP = 0.2
"""Pace at which a follower catches up, in parts of the usual one."""

CALM = 0.03, 1.0
"""A leader without a clutch engages after moving farther than this [rad], then no farther for this time [s]."""

PICKED_UP = 0.1
"""Difference of openings at which a hand's takes over from that of the gripper: what was grasped does not fall."""

SPEED_CUTOFF = 5.0
"""Cutoff frequency of the measured speed [Hz]."""

TURN = 0.2
"""Speed of translation that counts as much as a rotational speed of one [m/rad]."""


class LeadOptions(Record):
    """Scale, direction, smoothing and speeds of a person's hand on a robot."""

    scale: Annotated[float, Meta(gt=0, le=4)] = 1.0
    """Way of the TCP in proportion to that of the hand. Rotations are not scaled."""
    front: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    """Direction of the device's frame that is the robot's front [degrees], counterclockwise from its x axis: 180 for a
    person who faces the robot. The button `front` sets it to where the hand points."""
    speed: Annotated[float, Meta(gt=0, le=2)] = SPEED
    """Largest speed of the TCP's target [m/s]. The TCP exceeds it by up to 19 % where it catches up; the default keeps
    the TCP at the 0.25 m/s of ISO 10218-1."""
    turn_speed: Annotated[float, Meta(gt=0, le=6)] = TURN_SPEED
    """Largest rotational speed of the TCP's target [rad/s]."""
    deadband: Annotated[float, Meta(ge=0, lt=1)] = 0.02
    """Share of the largest speeds below which a wanted velocity counts as none: a puck never rests at zero exactly."""
    smoothing: Positive = 3.0
    """Lowest cutoff frequency of the filter of a hand at rest [Hz]; less calms a trembling hand, and delays it."""
    quickness: NotNegative = 30.0
    """Increase of the cutoff frequency with the speed of the hand [Hz per m/s], so that fast motions are not late."""
    catch_up: bool = False
    """Let a follower come slowly to a leader that is elsewhere, instead of waiting until the leader is near it."""


class Hand:
    """Leads one robot as a hand moves."""

    def __init__(self, guide: Guide, options: LeadOptions, *, period: float, has_clutch: bool = True) -> None:
        """Prepare to lead.

        Args:
            guide: The guide of the robot.
            options: Scale, smoothing and speeds.
            period: Time between two actions [s].
            has_clutch: Whether the device has a button for the clutch.
        """
        self.guide = guide
        self.state: State = "held"
        """Whether the robot follows."""
        self.why = ""
        """Why the hand is held, or does not engage."""
        self.front = float(np.deg2rad(options.front))
        """Direction of the device's frame that is the robot's front [rad]."""
        self._options, self._period, self._has_clutch = options, period, has_clutch
        self._filter = PoseFilter(options.smoothing, options.quickness)
        self._hand_at = self._tcp_at = np.zeros(7)
        self._is_catching_up = self._has_opening = self._has_turned = False
        self._calm_at, self._calm_since = np.zeros(0), np.inf
        self._step = options.speed * period, options.turn_speed * period

    def hold(self, why: str) -> None:
        """Brake and stay, until the clutch was released and pressed, or a leader without one was moved."""
        self.state, self.why = "held", why
        self.guide.brake()

    def act(
        self,
        observation: Observation,
        info: Mapping[str, Any],
        *,
        hand: HandReading | None,
        pressed: Sequence[Button] = (),
        broken: str = "",
        time: float = 0.0,
        now: float = 0.0,
    ) -> Action:
        """Return the robot's next action.

        Args:
            observation: The present observation of the whole environment.
            info: Info of the last step.
            hand: The newest reading of the hand; None for none.
            pressed: Buttons that were pressed since the last action.
            broken: Why the hand could not be followed; empty if it could.
            time: When the hand was measured [s].
            now: The present time [s].
        """
        self.guide.see(observation)
        before = self.state
        self._update_clutch(hand, pressed, broken, now)
        if hand is not None and self.state != "held" and "gripper" in pressed:
            self.guide.opening = 0.0 if self.guide.opening >= 0.5 else 1.0
        if self.state == "engaged" and hand is not None:
            if before != "engaged" or "clutch" in pressed or self._has_turned:
                self._engage(hand, time, now)
            self._lead(hand, time, now)
        elif not self.guide.is_braking:
            self.guide.brake()
        self._has_turned = False
        return self.guide.act(observation, info)

    # --- The clutch ---------------------------------------------------------------------------------------------------

    def _update_clutch(self, hand: HandReading | None, pressed: Sequence[Button], broken: str, now: float) -> None:
        if hand is None or broken or not hand.is_tracked:
            self.hold(broken or "not tracked")
            return
        if not self._has_clutch:
            self._update_by_rest(hand, now)
            return
        is_pressed, is_anew = "clutch" in hand.buttons, "clutch" in pressed
        if self.state == "held" and (not is_pressed or is_anew):
            self.state, self.why = "released", ""
        if not is_pressed:
            self.state = "released"
        elif self.state == "released" and is_anew:
            self._try_to_engage(hand)

    def _update_by_rest(self, hand: HandReading, now: float) -> None:
        """Engage a leader without a clutch once it was moved and rests."""
        if self.state == "engaged" or hand.joints is None:
            return
        least, seconds = CALM
        if self.state == "held":  # a rest counts once somebody has moved it
            self.state, self.why = "released", "move the leader, then let it rest"
            self._calm_at, self._calm_since = hand.joints, np.inf
        elif np.abs(hand.joints - self._calm_at).max() > least:
            self._calm_at, self._calm_since = hand.joints, now
        if now - self._calm_since >= seconds:
            self._try_to_engage(hand)

    def _try_to_engage(self, hand: HandReading) -> None:
        self.why = "" if hand.joints is None else self._why_apart(hand.joints)
        self.state = "released" if self.why else "engaged"

    def _why_apart(self, joints: NDArray[np.float64]) -> str:
        """Return why a leader may not lead from where it is; empty if it may."""
        measured = self.guide.measured_joints
        if joints.shape != measured.shape:
            return f"the leader has {len(joints)} joints and the arm {len(measured)}"
        apart = joints - measured
        worst = int(np.abs(apart).argmax())
        if self._options.catch_up or abs(apart[worst]) <= NEAR:
            return ""
        return (
            f"joint {worst + 1} of the leader is {apart[worst]:+.2f} rad from the follower's; bring it within "
            f"{NEAR:g}, or let the follower catch up"
        )

    # --- While engaged ------------------------------------------------------------------------------------------------

    def _engage(self, hand: HandReading, time: float, now: float) -> None:
        guide = self.guide
        target, measured = guide.target_in_scene, guide.tcp_in_scene
        # Where the arm stands, its target is what keeps it there; measured again and again, it would sink bit by bit.
        is_there = (np.asarray(distance(target, measured)) <= SAME).all()
        self._tcp_at = target if is_there else measured
        if hand.pose is not None:
            self._filter.reset(hand.pose, time, now)
            self._hand_at = np.array(hand.pose)
        self._is_catching_up = hand.joints is not None
        self._has_opening = False

    def _lead(self, hand: HandReading, time: float, now: float) -> None:
        if hand.opening is not None:
            self._lead_gripper(hand.opening)
        if hand.joints is not None:
            self._lead_joints(hand.joints)
        elif hand.pose is not None:
            self._filter.take(hand.pose, time)
            self._lead_tcp(self._filter.at(now))
        elif hand.twist is not None:
            self._move_tcp(hand.twist)

    def _lead_tcp(self, hand: NDArray[np.float64]) -> None:
        """Lead the TCP to a pose of the hand in the device's frame."""
        way = self._in_scene(hand[:3] - self._hand_at[:3])
        wanted = np.array(self._tcp_at)
        wanted[:3] += self._options.scale * way
        if self.guide.kinematics.dof >= POSE:  # an arm with fewer joints keeps its tool upright as it was
            turn = compose(_rotation(hand), inverse(_rotation(self._hand_at)))
            turn[3:6] = self._in_scene(turn[3:6])
            wanted[3:] = compose(turn, _rotation(self._tcp_at))[3:]
        near = limit_step(self.guide.tcp_in_scene, wanted, *LEAD)
        if (np.asarray(distance(near, wanted)) > 1e-9).any():
            self._hand_at, self._tcp_at = np.array(hand), near
        self.guide.lead_to(near)

    def _move_tcp(self, twist: NDArray[np.float64]) -> None:
        """Move the wanted pose with a velocity in the device's frame, for one period."""
        options, guide = self._options, self.guide
        goal = self._tcp_at
        fastest = np.repeat([options.speed, options.turn_speed], 3)
        velocity = np.concatenate([self._in_scene(options.scale * twist[:3]), self._in_scene(twist[3:])])
        size = max(float(np.linalg.norm((velocity / fastest)[:3])), float(np.linalg.norm((velocity / fastest)[3:])))
        if size <= options.deadband:
            guide.lead_to(goal)
            return
        velocity *= (size - options.deadband) / (1.0 - options.deadband) / size / max(1.0, size)
        step = velocity * self._period
        turned = compose(Pose.from_rotvec(np.zeros(3), step[3:]).tquat, _rotation(goal))
        goal = np.concatenate([goal[:3] + step[:3], turned[3:] if guide.kinematics.dof >= POSE else goal[3:]])
        self._tcp_at = limit_step(guide.tcp_in_scene, goal, *LEAD)
        guide.lead_to(self._tcp_at)

    def _lead_joints(self, joints: NDArray[np.float64]) -> None:
        """Lead the arm to the joints of a leader, no faster than the TCP may be."""
        guide = self.guide
        joints = np.clip(joints, guide.lower, guide.upper)  # beyond, the follower would never have caught up
        start = guide.target_joints
        if self._is_catching_up and np.abs(joints - start).max() <= MET:
            self._is_catching_up = False
        guide.joint_pace = CATCH_UP if self._is_catching_up else 1.0
        way, turn = np.asarray(distance(guide.kinematics.forward(start).tquat, guide.kinematics.forward(joints).tquat))
        excess = max(way / self._step[0], turn / self._step[1], 1.0)
        guide.lead_joints_to(start + (joints - start) / excess)

    def _lead_gripper(self, opening: float) -> None:
        apart = opening - self.guide.opening
        if not self._has_opening:
            self._has_opening = abs(apart) <= PICKED_UP
        if self._has_opening:
            self.guide.opening = float(np.clip(opening, 0.0, 1.0))

    def face(self, pose: NDArray[np.float64]) -> None:
        """Take where a hand of the same person points for the robot's front; an engaged hand begins anew."""
        self._has_turned = True
        pointing = compose(_rotation(pose), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))[:3]
        if np.hypot(*pointing[:2]) > 0.2:  # a hand that points up or down points nowhere
            self.front = float(np.arctan2(pointing[1], pointing[0]))

    def _in_scene(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a vector of the device's frame in that of the scene, both level."""
        cos, sin = np.cos(self.front), np.sin(self.front)
        x, y, z = vector
        return np.array([cos * x + sin * y, cos * y - sin * x, z])


class PoseFilter:
    """Follows samples of a hand's pose with a low-pass whose cutoff frequency grows with their speed.

    Calm while the hand is still, quick while it moves: the One-Euro filter of Casiez, Roussel and Vogel (CHI 2012). It
    is evaluated at the moments of the loop instead of those of the samples, so that a loop that is faster than the
    device has a new target in every step.
    """

    def __init__(self, cutoff: float, quickness: float) -> None:
        """Set the cutoff.

        Args:
            cutoff: Cutoff frequency at rest [Hz].
            quickness: Its increase with the speed [Hz per m/s].
        """
        self._cutoff, self._quickness = cutoff, quickness
        self._newest = self._filtered = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self._sampled = self._now = 0.0
        self._speeds = np.zeros(2)

    def reset(self, pose: NDArray[np.float64], time: float, now: float) -> None:
        """Start at rest at a pose, (7,), that was sampled at a moment [s]."""
        self._newest = self._filtered = np.array(pose, np.float64)
        self._sampled, self._now = time, now
        self._speeds = np.zeros(2)

    def take(self, pose: NDArray[np.float64], time: float) -> None:
        """Take a sample, (7,), of a moment [s]; an old one again changes nothing."""
        passed = time - self._sampled
        if passed <= 0:
            return
        speeds = np.asarray(distance(self._newest, pose)) / passed
        self._speeds = self._speeds + (speeds - self._speeds) * _share(SPEED_CUTOFF, passed)
        self._newest, self._sampled = np.array(pose, np.float64), time

    def at(self, now: float) -> NDArray[np.float64]:
        """Return the filtered pose, (7,), at a moment [s]."""
        passed, self._now = max(now - self._now, 0.0), now
        way, turn = self._speeds
        shares = [_share(self._cutoff + self._quickness * speed, passed) for speed in (way, TURN * turn)]
        filtered = interpolate(self._filtered, self._newest, shares[1])
        filtered[:3] = self._filtered[:3] + shares[0] * (self._newest[:3] - self._filtered[:3])
        self._filtered = filtered
        return filtered


def _rotation(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([np.zeros(3), pose[3:]])


def _share(cutoff: float, passed: float) -> float:
    """Return the share of the way to its input that a low-pass goes in some time [s]."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff * passed)
