"""The ranges of domain randomisation, as one frozen record."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, Self, get_args

from rcs_data.options import Meta, NotNegative, Positive, Record, Share

from rcs.errors import InvalidSetup
from rcs.sim.model_fields import FieldRange

Preset = Literal["none", "mild", "default", "strong"]
"""Names of sets of ranges; `none` varies nothing."""
Factors = tuple[Positive, Positive]
"""Lowest and highest factor."""
Count = Annotated[int, Meta(ge=0, le=16)]
"""A texture takes 48 kB in the model; more than 16 distractors find no room on the table."""
UpToTenth = Annotated[float, Meta(ge=0, le=0.1)]
UpToHalf = Annotated[float, Meta(ge=0, le=0.5)]


def _presets(off: Any, *, mild: Any, default: Any, strong: Any) -> Any:
    """Declare a field with its value in every preset; `off` changes nothing."""
    return dataclasses.field(default=default, metadata={"none": off, "mild": mild, "strong": strong})


class Randomisation(Record):
    """Ranges from which every episode draws uniformly. A range without width changes nothing, not even a bit.

    Each field draws from its own stream, so switching one on or off does not change others.
    """

    # Written by envs/variation/scene.py.
    light_intensity: Factors = _presets((1, 1), mild=(0.75, 1.25), default=(0.5, 1.5), strong=(0.3, 2.0))
    """Factor on the brightness of each light."""
    light_direction: Share = _presets(0.0, mild=0.15, default=0.3, strong=0.6)
    """Largest turn of each light about each axis [rad]."""
    light_position: NotNegative = _presets(0.0, mild=0.1, default=0.2, strong=0.4)
    """Largest shift of each light along each axis [m]; directional lights do not change."""
    table_colour: Share = _presets(0.0, mild=0.08, default=0.15, strong=0.3)
    """Largest change of red, green and blue of the table, of 1."""
    object_colour: Share = _presets(0.0, mild=0.05, default=0.10, strong=0.15)
    """The same for each object of the task."""
    room_colour: Share = _presets(0.0, mild=0.08, default=0.15, strong=0.3)
    """The same for each wall and the floor."""
    textures: Count = _presets(0, mild=2, default=4, strong=8)
    """Number of procedural textures of the table top besides its own look, all equally likely."""
    camera_translation: UpToHalf = _presets(0.0, mild=0.005, default=0.01, strong=0.02)
    """Largest shift of each camera along each axis of its optical frame [m]."""
    camera_rotation: Share = _presets(0.0, mild=0.015, default=0.03, strong=0.06)
    """Largest turn of each camera about each axis of its optical frame [rad]."""
    field_of_view: Factors = _presets((1, 1), mild=(0.985, 1.015), default=(0.97, 1.03), strong=(0.95, 1.05))
    """Factor on the vertical field of view of each camera."""
    object_size: Factors = _presets((1, 1), mild=(0.95, 1.05), default=(0.9, 1.1), strong=(0.85, 1.15))
    """Factor on the size of each object of simple or soft shapes; mass and material stay the same."""
    object_mass: Factors = _presets((1, 1), mild=(0.75, 1.5), default=(0.5, 2.0), strong=(0.4, 3.0))
    """Factor on the mass and the inertia of each object."""
    friction: Factors = _presets((1, 1), mild=(0.9, 1.1), default=(0.8, 1.25), strong=(0.7, 1.5))
    """One factor on all friction: of objects, pads, table and robots."""
    object_friction: Factors = _presets((1, 1), mild=(0.9, 1.1), default=(0.8, 1.25), strong=(0.7, 1.5))
    """One more factor on the friction of each object. It acts as long as it leaves an object more friction than pads
    and table have, since a contact uses the greater of two."""
    # Written by envs/variation/robots.py.
    joint_damping: Factors = _presets((1, 1), mild=(0.9, 1.1), default=(0.8, 1.25), strong=(0.7, 1.5))
    """Factor on the damping of each joint of the robots, fingers included."""
    servo_stiffness: Factors = _presets((1, 1), mild=(0.95, 1.05), default=(0.9, 1.1), strong=(0.8, 1.2))
    """Factor on the position gain of each servo of the arms."""
    servo_damping: Factors = _presets((1, 1), mild=(0.95, 1.05), default=(0.9, 1.1), strong=(0.8, 1.2))
    """Factor on the velocity gain of each servo of the arms."""
    gripper_force: Factors = _presets((1, 1), mild=(0.9, 1.1), default=(0.8, 1.2), strong=(0.6, 1.3))
    """Factor on the strength of each end effector's drives: their gains and the limits of their force."""
    robot_start: UpToHalf = _presets(0.0, mild=0.02, default=0.05, strong=0.1)
    """Largest deviation of each joint of an arm from home at the start [rad]. Deviations that would touch anything are
    drawn again."""
    gripper_opening: tuple[Share, Share] = _presets((1, 1), mild=(0.9, 1), default=(0.7, 1), strong=(0.4, 1))
    """Opening of each gripper at the start, 0 closed … 1 open. Hands start open."""
    table_height: UpToTenth = _presets(0.0, mild=0.002, default=0.005, strong=0.015)
    """Largest shift of the table up or down, with everything on it [m]; robots and cameras stay."""
    # The latencies of `strong` are our choice: a slow controller and a slow camera.
    action_latency: tuple[UpToHalf, UpToHalf] = _presets((0, 0), mild=(0, 0.02), default=(0, 0.05), strong=(0, 0.1))
    """Time from the start of a step until the servos get its action, in whole physics steps [s]."""
    late_actions: UpToHalf = _presets(0.0, mild=0.0, default=0.01, strong=0.05)
    """Share of the steps whose action does not arrive in time: the previous one is repeated, and the action comes with
    the next step. Synchronous steps are never late."""
    # Written by sim/delayed_frames.py.
    frame_latency: tuple[Share, Share] = _presets((0, 0), mild=(0, 0.035), default=(0, 0.07), strong=(0, 0.125))
    """Time from the capture of a frame until an observation has it, of each camera [s]. A D435 takes 9 ms for depth and
    66 ms for colour (realsense-ros, issue 2686)."""
    frame_jitter: Share = _presets(0.0, mild=0.002, default=0.005, strong=0.01)
    """Largest time that a single frame takes longer than that [s]. Frames of a D455 at 30 Hz come up to 4 ms early or
    late (librealsense, issue 14957)."""
    # Written by tasks/clutter.py.
    distractors: Count = _presets(0, mild=0, default=0, strong=4)
    """Number of objects on the table that do not belong to the task; of random size, colour and place."""
    fields: tuple[FieldRange, ...] = _presets((), mild=(), default=(), strong=())
    """Ranges of any other fields of the MuJoCo model, by their names there."""

    def __post_init__(self) -> None:
        """Check every range.

        Raises:
            InvalidSetup: A range is not valid, or a field range is there twice.
        """
        super().__post_init__()
        for name in self.names():
            value = getattr(self, name)
            if isinstance(value, tuple) and value[0] > value[1]:
                raise InvalidSetup(f"{name} is {value}; valid is the lower number first.")
        keys = [one.key for one in self.fields]
        if twice := next((key for key in keys if keys.count(key) > 1), None):
            raise InvalidSetup(f"fields has two ranges of {twice}; give one.")

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of all ranges but `fields`."""
        return [own.name for own in dataclasses.fields(cls) if own.name != "fields"]

    @classmethod
    def off(cls, **ranges: Any) -> Self:
        """Return ranges without width, except those given."""
        return cls(**{**_preset("none"), **ranges})

    @classmethod
    def of(cls, preset: str) -> Self | None:
        """Return the ranges of a preset; None for `none`.

        `mild` has about half the default ranges; `strong` has about twice them and four distractors, and experts still
        succeed.

        Raises:
            InvalidSetup: There is no such preset.
        """
        if preset not in get_args(Preset):
            raise InvalidSetup(f"randomisation is {preset!r}; valid names: {', '.join(map(repr, get_args(Preset)))}.")
        return None if preset == "none" else cls(**({} if preset == "default" else _preset(preset)))

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Return the ranges that `to_json` wrote; missing fields, such as those of a later version, vary nothing.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        return super().from_json({**_preset("none"), **values})

    def varies(self, field: str) -> bool:
        """Return whether a field differs from the value that changes nothing."""
        return getattr(self, field) != _preset("none")[field]

    def bounds(self, field: str) -> tuple[float, float]:
        """Return the bounds of a field's uniform draw; for textures, of a number to be rounded down."""
        value: float | tuple[float, float] = getattr(self, field)
        if isinstance(value, tuple):
            return value
        return (0.0, value + 1.0) if field == "textures" else (-float(value), float(value))


@cache
def _preset(name: str) -> dict[str, Any]:
    """Return the values of all fields in a preset other than `default`."""
    return {own.name: own.metadata[name] for own in dataclasses.fields(Randomisation)}
