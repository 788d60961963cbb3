"""A setup: everything that defines an environment, as one frozen record to store, send and compare."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypedDict, get_args

import numpy as np

from rcs.envs.reward import RewardKind
from rcs.envs.spaces import TWIST, Control, Observed
from rcs.errors import InvalidSetup, require_fields
from rcs.robots.camera_mode import parse_mode
from rcs.robots.compliance import Compliance
from rcs.sim.camera import MAX_SIZE, Quality
from rcs.sim.detail import Assets
from rcs.sim.pixels import Pixels
from rcs.sim.randomisation import Preset, Randomisation
from rcs.sim.world import Stepping

RelativeTo = Literal["last_step", "origin", "absolute"]
"""The reference to which an arm's action is added; `absolute` for none."""

AtEnd = Literal["hold", "park"]
"""What real devices do when their environment is closed."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """An environment by names and numbers. `to_json` and `from_json` are inverse to each other."""

    task: str = "PickCuboid"
    """Name of the task, or `module:Class`; `Free` for none."""
    task_options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Options of the task, fields of its class `Options`, such as `{"lift_height": 0.05}`."""
    reward: RewardKind = "shaped"
    """What a step pays: `sparse` 1 at success; `shaped` also the discounted gain in progress,
    `discount · Φ(s') - Φ(s)`, which leaves the optimal policy as it is; `dense` for where the state is, as ManiSkill's
    PickCube-v1 does."""
    discount: float = 0.99
    """What a reward one step later is worth, the learner's discount: above 0, and at most 1 (`dense`: below 1). The
    shaped reward needs it, and the dense one, whose success pays `1 / (1 - discount)`."""
    robot: str = "fr3"
    """Name of the robot."""
    end_effector: str | Mapping[str, str] | None = None
    """Name of the gripper or hand, `none` for a bare flange, or one for each of some robots by name, such as
    `{"left": "robotiq_2f85"}`; None for the usual one."""
    cameras: tuple[str, ...] = ()
    """Names of camera mounts of the robot's lab, such as `wrist` and `side`; more cameras, slower steps."""
    calibration: str | None = None
    """Calibration file with poses and intrinsics of cameras; None for those of the lab."""
    image_size: tuple[int, int] = (224, 224)
    """Width and height of every frame [px]; other sizes than those of a camera's modes are cropped and scaled."""
    camera_sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])
    """Width and height of the frames of some cameras by name [px], where they are not `image_size`."""
    camera_mode: str | None = None
    """Name of a mode that all cameras have, such as `848x480`, instead of `image_size`; see `rcs list --cameras`."""
    camera_fps: float | tuple[tuple[str, float], ...] | None = None
    """Frames per second of all cameras, or of some by name; None for the highest rate of a camera at this size. One
    slower than `frequency` repeats its last frame until the next is due."""
    depth: bool = False
    """Whether frames carry depth; costs about a third of a frame's time."""
    segmentation: bool = False
    """Whether simulated frames say which instance and which geom each pixel shows; about doubles a frame's time."""
    points: bool = False
    """Whether frames have the points that their pixels show, in the base frame; needs `depth`."""
    tactile: str | None = None
    """Name of a tactile sensor, such as `digit`, to replace the gripper's pads; None for plain pads."""
    camera_noise: bool = False
    """Whether frames have the noise of real cameras, and depth the gaps of a stereo camera: shadows of near objects,
    edges, grazing views, darkness. The same state has the same noise."""
    pixels: Pixels | None = None
    """Have simulated cameras observed for learning: channels first, stacks of frames, and nothing else; True for colour
    frames without stacks, None for pictures with matrices."""
    render_quality: Quality = "fast"
    """`full` draws shadows, reflections and smooth edges, and is about fifty times slower without a GPU."""
    assets: Assets = "builtin"
    """Where the robots' looks come from: built-in primitives, or `menagerie` for meshes of the package
    `mujoco-menagerie` (an extra), downloaded at first use. Physics is the same; without a GPU, drawing is tens of times
    slower."""
    observe: tuple[Observed, ...] = ()
    """What else is observed: `torques` (`joint_torques`), `wrench` (`tcp_wrench`), `contacts` (`finger_contacts` and
    `is_grasped`), and in simulation `privileged`, poses and velocities of the task's objects."""
    collision_reaction: bool = True
    """Whether a simulated arm that collides goes into its fault state, as the real one does, at its own limits: the
    episode ends as `fault`. Turn it off for learning by trial and error."""
    compliance: Compliance | None = None
    """How arms give way to a push, as springs and dampers of their joints or of the TCP, such as
    `Compliance(tcp=(500, 30))`; None for stiff ones. Of real arms, those of the driver `franka` have it."""
    control: Control = "joints"
    """An arm's action: joint positions; the TCP pose with a quaternion or with roll, pitch, yaw; or a twist, the TCP's
    linear [m/s] and angular velocity [rad/s]."""
    relative: RelativeTo = "last_step"
    """Reference of an arm's action: the last target, an origin set by the user, or none. A twist always moves the last
    target."""
    native: bool = False
    """Whether the controllers of real arms lead the TCP to poses, or at twists, by their own laws, in place of our
    inverse kinematics and joint trajectories; for arms that can (`Arm.commands`), and without gates that look at
    joints. A simulated arm has no such controller and takes the usual way, so that one setup serves both."""
    binary_gripper: bool = True
    """Whether the gripper only opens and closes fully."""
    at_end: AtEnd = "hold"
    """What real arms do when the environment is closed: `hold`, or `park`, which is to go home at 5 % of their largest
    speeds, each joint straight there. They hold after an error or a fault, and when the program is told to end."""
    layers: tuple[str, ...] = ()
    """Names of more layers on top, or `module:Class`, from the lowest to the highest; each robot has its own."""
    gates: Mapping[str, Mapping[str, Any]] = field(default_factory=dict[str, Mapping[str, Any]])
    """What every target must pass before a device sees it, by name or `module:Class`, each with its options, such as
    `{"Guard": {"on_hit": "clip"}}`; a sequence of names for their usual options."""
    frequency: float = 30.0
    """Control steps per second [Hz]."""
    stepping: Stepping = "async"
    """How long a step lasts: one control period of simulated time, until arrived, or one period of the wall clock."""
    sync_time_limit: float = 10.0
    """Longest synchronous step of real devices [s]; it then ends as `limit`. A slow arm on a long way needs more."""
    max_episode_steps: int | None = 300
    """An episode is truncated after this many steps; None for no limit."""
    physics_step: float = 0.002
    """Time step of the physics [s]; longer is faster and grasps slip."""
    randomisation: Randomisation | None = None
    """Domain randomisation of episodes: ranges, or the name of some; None for none, True for `default`."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A field has an invalid value; the message says what is valid.
        """
        for own in dataclasses.fields(self):
            value = getattr(self, own.name)
            if isinstance(value, np.generic):  # numpy scalars become Python numbers
                object.__setattr__(self, own.name, value.item())
        for name in ("task", "robot"):
            if not isinstance(getattr(self, name), str):
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; it must be a name.")
        object.__setattr__(self, "end_effector", _end_effector(self.end_effector))
        if not isinstance(self.tactile, str | None):
            raise InvalidSetup(f"tactile is {self.tactile!r}; it must be the name of a sensor, or None.")
        if not isinstance(self.calibration, str | None):
            raise InvalidSetup(f"calibration is {self.calibration!r}; it must be the path of a file as text, or None.")
        for name in (
            "depth", "segmentation", "points", "camera_noise", "binary_gripper", "collision_reaction", "native",
        ):  # fmt: skip
            if not isinstance(getattr(self, name), bool):
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; valid: True, False.")
        if self.points and not self.depth:
            raise InvalidSetup("points is True and depth is False; points come from depth, so give depth=True too.")
        object.__setattr__(self, "task_options", _task_options(self.task_options))
        object.__setattr__(self, "gates", _gates(self.gates))
        if not (_is_number(self.discount) and 0 < self.discount <= 1):
            raise InvalidSetup(f"discount is {self.discount!r}; valid is above 0 and up to 1.")
        if self.reward == "dense" and self.discount == 1:
            raise InvalidSetup("discount is 1; the dense reward needs one below 1, such as 0.99.")
        object.__setattr__(self, "randomisation", _ranges(self.randomisation))
        object.__setattr__(self, "compliance", _compliance(self.compliance))
        is_late = self.randomisation is not None and self.randomisation.varies("action_latency")
        if is_late and self.compliance is not None and self.compliance.is_of_tcp:
            raise InvalidSetup(
                "randomisation varies action_latency; with compliance=Compliance(tcp=…), set it to (0, 0)."
            )
        object.__setattr__(self, "pixels", _pixels(self.pixels))
        taken = [name for name in ("depth", "segmentation", "points", "camera_noise") if getattr(self, name)]
        if self.pixels is not None and taken:
            raise InvalidSetup(
                f"{taken[0]} is True and pixels are given, which are colours alone; choose one of the two."
            )
        for name in ("cameras", "layers", "observe"):
            object.__setattr__(self, name, _names(name, getattr(self, name)))
        if unknown := [name for name in self.observe if name not in get_args(Observed)]:
            raise InvalidSetup(f"observe has {unknown}; valid: {', '.join(map(repr, get_args(Observed)))}.")
        object.__setattr__(self, "image_size", _size_of_mode(self.camera_mode, _size(self.image_size), self.cameras))
        object.__setattr__(self, "camera_sizes", _sizes(self.camera_sizes, self.cameras, self.pixels))
        object.__setattr__(self, "camera_fps", _frame_rates(self.camera_fps, self.cameras))
        relative: Any = self.relative
        if isinstance(relative, bool):
            object.__setattr__(self, "relative", "last_step" if relative else "absolute")
        choices = {
            "reward": RewardKind,
            "at_end": AtEnd,
            "control": Control,
            "relative": RelativeTo,
            "stepping": Stepping,
            "render_quality": Quality,
            "assets": Assets,
        }
        for name, options in choices.items():
            value = getattr(self, name)
            if value not in get_args(options):
                raise InvalidSetup(f"{name} is {value!r}; valid: {', '.join(map(repr, get_args(options)))}.")
        if self.control == TWIST and self.relative != "last_step":
            raise InvalidSetup(
                f"relative is {self.relative!r} and control is {TWIST!r}, a velocity, which always moves the last "
                "target; leave relative out."
            )
        if self.native and self.control == "joints":
            raise InvalidSetup("native is True and control is 'joints'; valid with it: 'tquat', 'xyzrpy', 'twist'.")
        if self.native and self.stepping == "sync":
            raise InvalidSetup(
                "native is True and stepping is 'sync', which waits for arrival; a controller that leads the TCP does "
                "not tell it. Use stepping='async' or 'realtime'."
            )
        if not (_is_number(self.physics_step) and 0 < self.physics_step <= 0.01):
            raise InvalidSetup(f"physics_step is {self.physics_step!r} s; valid is above 0 and up to 0.01 s.")
        highest = 1 / self.physics_step
        if not (_is_number(self.frequency) and 0 < self.frequency <= highest + 1e-9):
            raise InvalidSetup(f"frequency is {self.frequency!r} Hz; valid is above 0 and up to {highest:g} Hz.")
        if not (_is_number(self.sync_time_limit) and 0 < self.sync_time_limit < float("inf")):
            raise InvalidSetup(f"sync_time_limit is {self.sync_time_limit!r} s; valid is a finite number above 0.")
        steps: Any = self.max_episode_steps
        if steps is not None and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
            raise InvalidSetup(f"max_episode_steps is {steps!r}; valid is a whole number from 1, or None.")

    def __hash__(self) -> int:
        """Equal setups have equal hashes."""
        return hash(json.dumps(self.to_json(), sort_keys=True))

    def end_effector_of(self, robot: str) -> str | None:
        """Return the name of what a robot carries; None for its usual one."""
        return self.end_effector.get(robot) if isinstance(self.end_effector, Mapping) else self.end_effector

    def size_of(self, camera: str) -> tuple[int, int]:
        """Return width and height of a camera's frames [px]."""
        return self.camera_sizes.get(camera, self.image_size)

    def fps_of(self, camera: str) -> float | None:
        """Return the wanted frame rate of a camera [frames/s]; None for its highest."""
        return dict(self.camera_fps).get(camera) if isinstance(self.camera_fps, tuple) else self.camera_fps

    def to_json(self) -> dict[str, Any]:
        """Return the setup as JSON values."""
        values = {own.name: getattr(self, own.name) for own in dataclasses.fields(self)}
        if self.randomisation is not None:
            values["randomisation"] = self.randomisation.to_json()
        if self.compliance is not None:
            values["compliance"] = self.compliance.to_json()
        if self.pixels is not None:
            values["pixels"] = self.pixels.to_json()
        values["camera_sizes"] = {name: list(size) for name, size in self.camera_sizes.items()}
        if isinstance(self.camera_fps, tuple):
            values["camera_fps"] = dict(self.camera_fps)
        return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}

    @staticmethod
    def from_json(values: dict[str, Any]) -> Setup:
        """Return the setup that `to_json` wrote.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        require_fields("option", values, (own.name for own in dataclasses.fields(Setup)))
        return Setup(**values)


class Options(TypedDict, total=False):
    """The fields of `Setup` besides the task, as `rcs.make` takes them."""

    task_options: Mapping[str, Any]
    reward: RewardKind
    discount: float
    robot: str
    end_effector: str | Mapping[str, str] | None
    cameras: Sequence[str]
    calibration: str | None
    image_size: int | tuple[int, int]
    camera_sizes: Mapping[str, int | tuple[int, int]]
    camera_mode: str | None
    camera_fps: float | Mapping[str, float] | None
    depth: bool
    segmentation: bool
    points: bool
    tactile: str | None
    camera_noise: bool
    pixels: Pixels | bool | None
    render_quality: Quality
    assets: Assets
    observe: Sequence[Observed]
    collision_reaction: bool
    compliance: Compliance | None
    control: Control
    relative: RelativeTo | bool
    native: bool
    binary_gripper: bool
    at_end: AtEnd
    frequency: float
    stepping: Stepping
    sync_time_limit: float
    max_episode_steps: int | None
    physics_step: float
    randomisation: Randomisation | Preset | bool | None


def _end_effector(value: Any) -> str | dict[str, str] | None:
    names = [*value, *value.values()] if isinstance(value, Mapping) else [] if value is None else [value]
    if not all(isinstance(name, str) for name in names):
        raise InvalidSetup(f"end_effector is {value!r}; it must be a name, a name for each of some robots, or None.")
    return dict(value) if isinstance(value, Mapping) else value


def _task_options(value: Any) -> dict[str, Any]:
    options = dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else value
    if not isinstance(options, Mapping) or not all(isinstance(name, str) for name in options):
        raise InvalidSetup(f"task_options is {value!r}; valid is a mapping of the task's options by name.")
    return dict(options)


def _gates(value: Any) -> dict[str, dict[str, Any]]:
    given = value if isinstance(value, Mapping) else {name: {} for name in _names("gates", value)}
    if not all(isinstance(name, str) and isinstance(options, Mapping) for name, options in given.items()):
        raise InvalidSetup(f"gates is {value!r}; valid is a sequence of names, or a mapping from names to options.")
    return {name: {str(key): own for key, own in options.items()} for name, options in given.items()}


def _ranges(value: Any) -> Randomisation | None:
    if isinstance(value, bool):
        return Randomisation() if value else None
    if isinstance(value, str):
        return Randomisation.of(value)
    if isinstance(value, dict):
        return Randomisation.from_json(value)
    if not isinstance(value, Randomisation | None):
        raise InvalidSetup(
            f"randomisation is {value!r}; valid: a Randomisation, the name of one, True for its defaults, or None."
        )
    return value


def _compliance(value: Any) -> Compliance | None:
    if isinstance(value, dict):
        return Compliance.from_json(value)
    if not isinstance(value, Compliance | None):
        raise InvalidSetup(f"compliance is {value!r}; valid: rcs.Compliance(joints=...), (tcp=...), or None.")
    return value


def _pixels(value: Any) -> Pixels | None:
    if isinstance(value, bool):
        return Pixels() if value else None
    if isinstance(value, dict):
        return Pixels.from_json(value)
    if not isinstance(value, Pixels | None):
        raise InvalidSetup(f"pixels is {value!r}; valid: rcs.Pixels(...), True for its defaults, or None.")
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _names(field: str, value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        raise InvalidSetup(f"{field} is the text {value!r}; give a tuple of names, such as ({value!r},).")
    if not isinstance(value, Sequence) or not all(isinstance(name, str) for name in value):
        raise InvalidSetup(f"{field} is {value!r}; it must be a tuple of names.")
    if len(set(value)) != len(value):
        raise InvalidSetup(f"{field} is {value!r}; names must not repeat.")
    return tuple(value)


def _size(value: Any) -> tuple[int, int]:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    size = (value, value) if isinstance(value, int) else value
    if not isinstance(size, Sequence) or len(size) != 2 or not all(_is_edge(edge) for edge in size):
        raise InvalidSetup(f"image_size is {value!r}; valid is one number or (width, height) of 1 to {MAX_SIZE} px.")
    return int(size[0]), int(size[1])


def _sizes(value: Any, cameras: tuple[str, ...], pixels: Any) -> dict[str, tuple[int, int]]:
    if not isinstance(value, Mapping):
        raise InvalidSetup(f"camera_sizes is {value!r}; valid is a mapping from some cameras to sizes.")
    if unknown := sorted(str(name) for name in value if name not in cameras):
        raise InvalidSetup(f"camera_sizes names the cameras {unknown}; this setup has {list(cameras)}.")
    if value and pixels is not None:
        raise InvalidSetup("camera_sizes and pixels are given; pixels for learners are of one size, image_size.")
    return {name: _size(size) for name, size in value.items()}


def _size_of_mode(mode: Any, size: tuple[int, int], cameras: tuple[str, ...]) -> tuple[int, int]:
    if mode is None:
        return size
    if not isinstance(mode, str):
        raise InvalidSetup(f"camera_mode is {mode!r}; it must be the name of a mode, such as '848x480', or None.")
    wanted = parse_mode(mode)
    if wanted is None or not all(_is_edge(edge) for edge in wanted):
        if cameras:
            return size  # refused where the cameras are looked up, with a list of their modes
        raise InvalidSetup(f"camera_mode is {mode!r}; it is written like '848x480' (see `rcs list --cameras`).")
    if size not in (wanted, Setup.image_size):
        raise InvalidSetup(f"camera_mode is {mode!r} and image_size is {size}; give one of the two.")
    return wanted


def _frame_rates(value: Any, cameras: tuple[str, ...]) -> float | tuple[tuple[str, float], ...] | None:
    if value is None:
        return None
    try:
        by_name = None if _is_number(value) else {str(name): rate for name, rate in dict(value).items()}
    except (TypeError, ValueError) as err:
        raise InvalidSetup(
            f"camera_fps is {value!r}; valid is a number, or one for each of some cameras by name."
        ) from err
    if by_name is not None and (unknown := sorted(set(by_name) - set(cameras))):
        raise InvalidSetup(f"camera_fps names the cameras {unknown}; this setup has {list(cameras)}.")
    for rate in [value] if by_name is None else by_name.values():
        if not (_is_number(rate) and 0 < rate < float("inf")):
            raise InvalidSetup(f"camera_fps is {value!r}; a rate must be above 0.")
    return value if by_name is None else tuple(sorted(by_name.items()))


def _is_edge(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and 1 <= int(value) <= MAX_SIZE
