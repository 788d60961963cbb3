"""How a person's hand leads a robot."""

from __future__ import annotations

from typing import Annotated

from rcs_data.options import Meta, NotNegative, Positive, Record

from rcs.agents.guide import SPEED, TURN_SPEED


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
