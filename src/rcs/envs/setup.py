"""A setup: everything that defines an environment, as one frozen record to store, send and compare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from rcs_data.options import Meta, Positive, Record, Whole, converted

from rcs.devices import lookup
from rcs.envs.cameras import Cameras
from rcs.envs.reward import RewardKind
from rcs.envs.spaces import TWIST, Control, Observed
from rcs.errors import InvalidSetup
from rcs.robots.camera import CameraMount
from rcs.robots.compliance import Compliance
from rcs.sim.camera import Quality
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Preset, Randomisation
from rcs.sim.world import Stepping

if TYPE_CHECKING:
    from rcs.envs.layers import Layer
    from rcs.envs.task import Task
    from rcs.robots.description import ArmDescription

RelativeTo = Literal["last_step", "origin", "absolute"]
"""The reference to which an arm's action is added; `absolute` for none."""

AtEnd = Literal["hold", "park"]
"""Motion of real devices when their environment is closed."""


def _task(given: str | type[Task]) -> str:
    return lookup.name_of("task", given)


def _robot(given: str | ArmDescription | Mapping[str, str | ArmDescription]) -> str | Mapping[str, str]:
    if isinstance(given, Mapping):
        return {str(name): lookup.name_of("arm", arm) for name, arm in given.items()}
    return lookup.name_of("arm", given)


def _options(given: Any) -> Mapping[str, Any]:
    return given.to_json() if isinstance(given, Record) else given


def _cameras(given: Cameras | str | bool | Sequence[str] | Mapping[str, CameraMount] | None) -> Cameras:
    return Cameras.of(given)


def _relative(given: RelativeTo | bool) -> RelativeTo:
    return ("last_step" if given else "absolute") if isinstance(given, bool) else given


def _layers(given: Sequence[str | type[Layer]]) -> tuple[str, ...]:
    is_names = isinstance(given, Sequence) and not isinstance(given, str)
    return tuple(lookup.name_of("layer", layer) for layer in given) if is_names else given  # pyright: ignore[reportReturnType]


def _gates(given: Sequence[str | type[Any]] | Mapping[str, Mapping[str, Any]]) -> Mapping[str, Mapping[str, Any]]:
    is_names = isinstance(given, Sequence) and not isinstance(given, str)
    return {lookup.name_of("gate", gate): {} for gate in given} if is_names else given  # pyright: ignore[reportReturnType]


def _observed(given: Sequence[Observed]) -> tuple[Observed, ...]:
    return given  # pyright: ignore[reportReturnType]  any sequence becomes a tuple


def _ranges(given: Randomisation | Preset | Mapping[str, Any] | bool | None) -> Randomisation | None:
    if isinstance(given, bool):
        return Randomisation() if given else None
    if isinstance(given, str):
        return Randomisation.of(given)
    return Randomisation.from_json(dict(given)) if isinstance(given, Mapping) else given


class Setup(Record):
    """An environment by names and numbers: the options of `rcs.make`, of the command line and of training."""

    hints: ClassVar[Mapping[str, str]] = {
        "fps": "Use frequency; cameras=rcs.Cameras(fps=...) for frames.",
        "hz": "Use frequency.",
        **dict.fromkeys(("gripper", "hand"), "Use end_effector."),
        **dict.fromkeys(("num_envs", "n_envs", "copies"), "Use rcs.make_vec(task, copies=...)."),
        **dict.fromkeys(("control_mode", "action_space", "action_space_type"), "Use control."),
        **dict.fromkeys(("obs", "observations"), "Use observe."),
        "seed": "Give it to env.reset(seed=...).",
        **dict.fromkeys(("max_steps", "horizon"), "Use max_episode_steps."),
        **dict.fromkeys(("randomize", "domain_randomization"), "Use randomisation."),
        "timestep": "Use physics_step.",
        "camera_names": "Use cameras.",
        "use_camera_obs": "Use cameras='all'.",
        **{
            name: f"Use cameras=rcs.Cameras({name.removeprefix('camera_')}=...)."
            for name in (
                "image_size", "camera_mode", "camera_fps", "depth", "segmentation", "points", "camera_noise",
                "calibration", "pixels",
            )
        },
        "camera_sizes": "Use cameras=rcs.Cameras(image_size={'wrist': (320, 240)}).",
        **{f"control={name}": "Use 'xyzrpy' or 'tquat'." for name in ("pose", "cartesian", "ee", "tcp")},
        "control=velocity": "Use 'twist', velocities of the TCP.",
        "control=joint_position": "Use 'joints'.",
    }  # fmt: skip

    task: str = converted(converter=_task, default="PickCuboid", kw_only=False)
    """Task by name, as `module:Class` or as a class; `Free` for none."""
    task_options: Mapping[str, Any] = converted(converter=_options, default_factory=dict[str, Any])
    """Options of the task, fields of its class `Options`, such as `{"lift_height": 0.05}`."""
    reward: RewardKind = "shaped"
    """Reward of a step: `sparse` 1 at success; `shaped` also the discounted gain in progress,
    `discount · Φ(s') - Φ(s)`, which leaves the optimal policy as it is; `dense` the progress of the state, as in
    ManiSkill's PickCube-v1."""
    discount: Annotated[float, Meta(gt=0, le=1)] = 0.99
    """The learner's discount of a reward one step later: above 0 and up to 1 (`dense`: below 1). The shaped reward
    depends on it, and the dense one, which pays `1 / (1 - discount)` at success."""
    robot: str | Mapping[str, str] = converted(converter=_robot, default="fr3")
    """Robot by name: a lab, or an arm, which may be an `ArmDescription` or `module:NAME`; or arms side by side by name,
    such as `{"left": "fr3", "right": "ur5e"}`."""
    end_effector: str | Mapping[str, str] | None = None
    """Name of the gripper or hand, `none` for a bare flange, or one for each of some robots by name, such as
    `{"left": "robotiq_2f85"}`; None for the usual one."""
    cameras: Cameras = converted(converter=_cameras, default_factory=Cameras)
    """Cameras: names of mounts of the robot's lab, such as `wrist` or `("wrist", "side")`, `all` for all of them, your
    own `CameraMount`s by name, or `Cameras` for these with sizes, rates, depth and more."""
    tactile: str | None = None
    """Name of a tactile sensor, such as `digit`, to replace the gripper's pads; None for plain pads."""
    render_quality: Quality = "fast"
    """`full` draws shadows, reflections and smooth edges, and is about fifty times slower without a GPU."""
    assets: Assets = "builtin"
    """Source of the robots' looks: built-in primitives, or `menagerie` for meshes of the package
    `mujoco-menagerie` (an extra), downloaded at first use. Physics is the same; without a GPU, drawing is tens of times
    slower."""
    observe: tuple[Observed, ...] = converted(converter=_observed, default=())
    """More observations: `torques` (`joint_torques`), `wrench` (`tcp_wrench`), `contacts` (`finger_contacts` and
    `is_grasped`), and in simulation `privileged`, poses and velocities of the task's objects."""
    collision_reaction: bool = True
    """Put a simulated arm that collides into its fault state, as the real one does, at its own limits, and end the
    episode as `fault`. Turn it off for learning by trial and error."""
    compliance: Compliance | None = None
    """Arms that give way to a push, as springs and dampers of their joints or of the TCP, such as
    `Compliance(tcp=(500, 30))`; None for stiff ones. Among real arms, those of the driver `franka` have it."""
    control: Control = "joints"
    """An arm's action: joint positions; the TCP pose with a quaternion or with roll, pitch, yaw; or a twist, the TCP's
    linear [m/s] and angular velocity [rad/s]."""
    relative: RelativeTo = converted(converter=_relative, default="last_step")
    """Reference of an arm's action: the last target (True), an origin set by the user, or none (`absolute`, False). A
    twist always moves the last target."""
    native: bool = False
    """Send poses and twists to the controllers of real arms, which lead the TCP by their own laws, in place of inverse
    kinematics and joint trajectories; for arms that can (`Arm.commands`), and without gates that check joints.
    Simulated arms have no such controller and ignore it, so one setup serves both."""
    binary_gripper: bool = True
    """Only open and close the gripper fully."""
    at_end: AtEnd = "hold"
    """Motion of real arms when the environment is closed: `hold`, or `park` to go home at 5 % of their largest speeds,
    each joint straight there. After an error, a fault or a signal to end they hold."""
    layers: tuple[str, ...] = converted(converter=_layers, default=())
    """Names of more layers on top, or `module:Class`, from the lowest to the highest; each robot has its own."""
    gates: Mapping[str, Mapping[str, Any]] = converted(converter=_gates, default_factory=dict[str, Mapping[str, Any]])
    """Gates that every target passes before a device sees it, by name or `module:Class`, each with its options, such as
    `{"Guard": {"on_hit": "clip"}}`; a sequence of names for their usual options."""
    frequency: Positive = 30.0
    """Control steps per second [Hz]."""
    stepping: Stepping = "async"
    """Length of a step: one control period of simulated time, until arrival, or one period of the wall clock."""
    sync_time_limit: Positive = 10.0
    """Longest synchronous step of real devices [s]; it then ends as `limit`. A slow arm on a long way needs more."""
    max_episode_steps: Whole | None = 300
    """An episode is truncated after this many steps; None for no limit."""
    physics_step: Annotated[float, Meta(gt=0, le=0.01)] = 0.002
    """Time step of the physics [s]; longer is faster, and contacts sink in and swing more."""
    randomisation: Randomisation | None = converted(converter=_ranges, default=None)
    """Domain randomisation of episodes: ranges, or the name of a preset; None for none, True for `default`."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A field has an invalid value; the message says what is valid.
        """
        super().__post_init__()
        for name in ("layers", "observe"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; names must not repeat.")
        if not self.robot:
            raise InvalidSetup(f"robot is {self.robot!r}; valid is a name, or arms by name.")
        if self.reward == "dense" and self.discount == 1:
            raise InvalidSetup("discount is 1; the dense reward needs one below 1, such as 0.99.")
        is_late = self.randomisation is not None and self.randomisation.varies("action_latency")
        if is_late and self.compliance is not None and self.compliance.is_of_tcp:
            raise InvalidSetup(
                "randomisation varies action_latency; with compliance=Compliance(tcp=…), set it to (0, 0)."
            )
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
                "not report it. Use stepping='async' or 'realtime'."
            )
        highest = 1 / self.physics_step
        if self.frequency > highest + 1e-9:
            raise InvalidSetup(f"frequency is {self.frequency!r} Hz; valid is above 0 and up to {highest:g} Hz.")

    @property
    def robot_label(self) -> str:
        """Name of the robot for people; for arms side by side, their names joined by `+`."""
        return self.robot if isinstance(self.robot, str) else "+".join(self.robot.values())

    @property
    def title(self) -> str:
        """First line of the printed environment."""
        return f"rcs {self.task} with {self.robot_label}"

    def end_effector_of(self, robot: str) -> str | None:
        """Return the name of a robot's end effector; None for its usual one."""
        return self.end_effector.get(robot) if isinstance(self.end_effector, Mapping) else self.end_effector
