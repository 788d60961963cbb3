"""The ranges of domain randomisation, as one frozen record."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from rcs.errors import InvalidSetup, require_fields

Range = tuple[float, float]
"""Lowest and highest value of a draw."""
Preset = Literal["none", "mild", "default", "strong"]
"""Names of sets of ranges; `none` varies nothing."""


@dataclass(frozen=True, kw_only=True)
class Randomisation:
    """Ranges from which every episode draws uniformly. A range without width changes nothing, not even a bit.

    Each field draws from its own stream, so switching one on or off does not change others.
    """

    light_intensity: Range = (0.5, 1.5)
    """Factor on the brightness of each light."""
    light_direction: float = 0.3
    """Largest turn of each light about each axis [rad]."""
    light_position: float = 0.2
    """Largest shift of each light along each axis [m]; directional lights do not change."""
    table_colour: float = 0.15
    """Largest change of red, green and blue of the table, of 1."""
    object_colour: float = 0.10
    """The same for each object of the task."""
    room_colour: float = 0.15
    """The same for each wall and the floor."""
    textures: int = 4
    """Number of procedural textures of the table top besides its own look, all equally likely."""
    camera_translation: float = 0.01
    """Largest shift of each camera along each axis of its optical frame [m]."""
    camera_rotation: float = 0.03
    """Largest turn of each camera about each axis of its optical frame [rad]."""
    field_of_view: Range = (0.97, 1.03)
    """Factor on the vertical field of view of each camera."""
    object_size: Range = (0.9, 1.1)
    """Factor on the size of each object of simple or soft shapes; mass and material stay the same."""
    object_mass: Range = (0.5, 2.0)
    """Factor on the mass and the inertia of each object."""
    friction: Range = (0.8, 1.25)
    """One factor on all friction: of objects, pads, table and robots."""
    object_friction: Range = (0.8, 1.25)
    """One more factor on the friction of each object. It acts as long as it leaves an object more friction than pads
    and table have, since a contact uses the greater of two."""
    joint_damping: Range = (0.8, 1.25)
    """Factor on the damping of each joint of the robots, fingers included."""
    servo_stiffness: Range = (0.9, 1.1)
    """Factor on the position gain of each servo of the arms."""
    servo_damping: Range = (0.9, 1.1)
    """Factor on the velocity gain of each servo of the arms."""
    gripper_force: Range = (0.8, 1.2)
    """Factor on what each end effector's drives can do: their gains and the limits of their force."""
    robot_start: float = 0.05
    """Largest deviation of each joint of an arm from home at the start [rad]. Deviations that would touch anything are
    drawn again."""
    gripper_opening: Range = (0.7, 1.0)
    """Opening of each gripper at the start, 0 closed … 1 open. Hands start open."""
    table_height: float = 0.005
    """Largest shift of the table up or down, with everything on it [m]; robots and cameras stay."""
    action_latency: Range = (0.0, 0.05)
    """Time from the start of a step to when the servos get what it sends, in whole physics steps [s]."""
    late_actions: float = 0.01
    """Share of the steps whose action does not arrive in time: what was sent before is sent again, and the action comes
    with the next step. Synchronous steps are never late."""
    frame_latency: Range = (0.0, 0.07)
    """Time from the capture of a frame until an observation has it, of each camera [s]. A D435 takes 9 ms for depth and
    66 ms for colour (realsense-ros, issue 2686)."""
    frame_jitter: float = 0.005
    """Largest time that a single frame takes longer than that [s]. Frames of a D455 at 30 Hz come up to 4 ms early or
    late (librealsense, issue 14957)."""
    distractors: int = 0
    """Number of objects on the table that the task has nothing to do with; of random size, colour and place."""

    def __post_init__(self) -> None:
        """Check every range.

        Raises:
            InvalidSetup: A range is not valid, or would make something negative.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name in COUNTS:
                most = COUNTS[field.name]
                if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
                    raise InvalidSetup(
                        f"randomisation: {field.name} is {value!r}; valid is a whole number from 0 to {most}."
                    )
            elif isinstance(OFF[field.name], tuple):
                object.__setattr__(self, field.name, _range(field.name, value))
            elif not _is_number(value) or value < 0 or value > LIMITS.get(field.name, math.inf):
                most = f" to {LIMITS[field.name]:g}" if field.name in LIMITS else " and more"
                raise InvalidSetup(f"randomisation: {field.name} is {value!r}; valid is 0{most}.")

    @staticmethod
    def off(**ranges: Any) -> Randomisation:
        """Return ranges without width, except those given."""
        return Randomisation(**{**OFF, **ranges})

    @staticmethod
    def mild() -> Randomisation:
        """Return about half the default ranges."""
        return MILD

    @staticmethod
    def strong() -> Randomisation:
        """Return about twice the default ranges, with four distractors: what an expert still copes with."""
        return STRONG

    @staticmethod
    def of(preset: str) -> Randomisation | None:
        """Return the ranges of a preset; None for `none`.

        Raises:
            InvalidSetup: There is no such preset.
        """
        presets = {"none": None, "mild": MILD, "default": Randomisation(), "strong": STRONG}
        if preset not in presets:
            raise InvalidSetup(f"randomisation is {preset!r}; valid names: {', '.join(map(repr, presets))}.")
        return presets[preset]

    def varies(self, field: str) -> bool:
        """Return whether a field differs from what changes nothing."""
        return getattr(self, field) != OFF[field]

    def bounds(self, field: str) -> tuple[float, float]:
        """Return the bounds of a field's uniform draw; for textures, of a number to be rounded down."""
        value: float | Range = getattr(self, field)
        if isinstance(value, tuple):
            return value
        return (0.0, value + 1.0) if field == "textures" else (-float(value), float(value))

    def to_json(self) -> dict[str, Any]:
        """Return the ranges as JSON values."""
        values = dataclasses.asdict(self)
        return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}

    @staticmethod
    def from_json(values: dict[str, Any]) -> Randomisation:
        """Return the ranges that `to_json` wrote; missing fields, such as those of a later version, vary nothing.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        require_fields("field of a randomisation", values, (field.name for field in dataclasses.fields(Randomisation)))
        return Randomisation.off(**values)


FACTORS = frozenset(
    {
        "light_intensity", "field_of_view", "object_size", "object_mass", "friction", "object_friction",
        "joint_damping", "servo_stiffness", "servo_damping", "gripper_force",
    }
)  # fmt: skip
"""Fields that are factors."""
LIMITS = {
    "light_direction": 1.0,
    "table_colour": 1.0,
    "object_colour": 1.0,
    "room_colour": 1.0,
    "camera_translation": 0.5,
    "camera_rotation": 1.0,
    "robot_start": 0.5,
    "table_height": 0.1,
    "late_actions": 0.5,
    "frame_jitter": 1.0,
}
"""Largest values of the others, if limited: beyond these, cameras look elsewhere and lights shine from below."""
SPANS = {"gripper_opening": (0.0, 1.0), "action_latency": (0.0, 0.5), "frame_latency": (0.0, 1.0)}
"""Valid values of ranges that are no factors: an opening, and times [s]."""
MAX_TEXTURES = 16
"""Each takes 48 kB in the model."""
MAX_DISTRACTORS = 16
"""As many as find room on the table."""
COUNTS = {"textures": MAX_TEXTURES, "distractors": MAX_DISTRACTORS}
"""Largest values of fields that are counts."""
OFF: dict[str, Any] = {
    **{field.name: 0 if field.name in COUNTS else 0.0 for field in dataclasses.fields(Randomisation)},
    **dict.fromkeys(FACTORS, (1.0, 1.0)),
    **dict.fromkeys(("action_latency", "frame_latency"), (0.0, 0.0)),
    "gripper_opening": (1.0, 1.0),
}
"""What changes nothing, by field."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _range(name: str, value: Any) -> Range:
    what = "factor" if name in FACTORS else "value"
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise InvalidSetup(f"randomisation: {name} is {value!r}; valid are the lowest and the highest {what}.")
    low, high = value
    is_ascending = _is_number(low) and _is_number(high) and low <= high
    if name in FACTORS and not (is_ascending and low > 0):
        raise InvalidSetup(f"randomisation: {name} is {value!r}; valid are two factors above 0, the lower one first.")
    least, most = SPANS.get(name, (0.0, math.inf))
    if not (is_ascending and least <= low and high <= most):
        raise InvalidSetup(
            f"randomisation: {name} is {value!r}; valid are two numbers from {least:g} to {most:g}, the lower one "
            "first."
        )
    return float(low), float(high)


MILD = Randomisation(
    light_intensity=(0.75, 1.25),
    light_direction=0.15,
    light_position=0.1,
    table_colour=0.08,
    object_colour=0.05,
    room_colour=0.08,
    textures=2,
    camera_translation=0.005,
    camera_rotation=0.015,
    field_of_view=(0.985, 1.015),
    object_size=(0.95, 1.05),
    object_mass=(0.75, 1.5),
    friction=(0.9, 1.1),
    object_friction=(0.9, 1.1),
    joint_damping=(0.9, 1.1),
    servo_stiffness=(0.95, 1.05),
    servo_damping=(0.95, 1.05),
    gripper_force=(0.9, 1.1),
    robot_start=0.02,
    gripper_opening=(0.9, 1.0),
    table_height=0.002,
    action_latency=(0.0, 0.02),
    late_actions=0.0,
    frame_latency=(0.0, 0.035),
    frame_jitter=0.002,
)
"""See `Randomisation.mild`."""
STRONG = Randomisation(
    light_intensity=(0.3, 2.0),
    light_direction=0.6,
    light_position=0.4,
    table_colour=0.3,
    object_colour=0.15,
    room_colour=0.3,
    textures=8,
    camera_translation=0.02,
    camera_rotation=0.06,
    field_of_view=(0.95, 1.05),
    object_size=(0.85, 1.15),
    object_mass=(0.4, 3.0),
    friction=(0.7, 1.5),
    object_friction=(0.7, 1.5),
    joint_damping=(0.7, 1.5),
    servo_stiffness=(0.8, 1.2),
    servo_damping=(0.8, 1.2),
    gripper_force=(0.6, 1.3),
    robot_start=0.1,
    gripper_opening=(0.4, 1.0),
    table_height=0.015,
    # Our choice: a slow controller and a slow camera.
    action_latency=(0.0, 0.1),
    late_actions=0.05,
    frame_latency=(0.0, 0.125),
    frame_jitter=0.01,
    distractors=4,
)
"""See `Randomisation.strong`."""
