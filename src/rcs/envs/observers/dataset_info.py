"""The description of a dataset for the episodes of an environment."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from gymnasium import spaces
from rcs_data import DatasetInfo, Encoding, Feature, JointBounds
from rcs_data.files.feature import Colour, DType
from rcs_data.files.flags import flags_key

from rcs.devices import lookup
from rcs.envs import spaces as keys
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.setup import Setup
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription

OBSERVATION, ACTION, EXECUTED, NOTES = "observation", "action", "executed", "notes"
TIME_MONOTONIC, TIME_PERIOD, TIME_COMMAND = "time/monotonic", "time/period", "time/command"
"""Times of a row [s]: when the observation was complete, how long after that of the row before, and when the targets
that led to it were sent."""
SIMULATED_TIME = "simulated_time"
TIME_DEVICE = "time/device"
"""Start of the keys of times on devices' own clocks."""
OBJECTS = "objects"
"""Key of an outcome: where the task's objects were at the start, by name, translation [m] and quaternion xyzw in the
base frame (of several robots: in the scene). Real recordings that have it can be replayed in simulation."""

_FRAMES = f"{keys.FRAMES}/"


def dataset_info(
    env: Env | VecEnv,
    *,
    instruction: str | None = None,
    colour: Colour = "jpeg",
    jpeg_quality: int = 95,
    notes: Sequence[str | Note] = (),
) -> DatasetInfo:
    """Return the info of a dataset of an environment's episodes.

    Args:
        env: The environment, or a batch of copies of one.
        instruction: Instruction for the robot; None for the environment's instruction.
        colour: Encoding of colour frames; docs/data.md compares sizes and quality.
        jpeg_quality: JPEG quality of colour frames, 1 to 100.
        notes: Notes that `env.note` may give beside a step, recorded as `notes/name`: vectors and words as `Note`s,
            numbers by their names alone. Where it did not, numbers are NaN.

    Raises:
        InvalidSetup: Steps of the environment have no fixed rate.
    """
    setup = env.setup if isinstance(env, VecEnv) or env.has_setup else None
    if setup is not None:
        require_recordable(setup)
    is_foreign = not isinstance(env, VecEnv) and not env.robots  # in a simulator of another project
    arms = {} if setup is None or is_foreign else _arms_of(setup.robot)
    limits = {f"{OBSERVATION}/{name}/joints".replace("//", "/"): bounds_of_joints(arm) for name, arm in arms.items()}
    features = _features(OBSERVATION, env.stack.observation_space.spaces, colour)
    features = [replace(feature, limits=limits.get(feature.key)) for feature in features]
    features += _features(ACTION, env.stack.action_space.spaces, colour)
    features += _features(EXECUTED, env.stack.executed_spaces, colour)
    features += [
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="truncated", shape=(), dtype="bool"),
    ]
    simulated = env.simulation if isinstance(env, VecEnv) or env.is_simulated else None
    times = [TIME_MONOTONIC, TIME_PERIOD, TIME_COMMAND, *([] if simulated is None else [SIMULATED_TIME])]
    times += [f"time/{key}" for key in env.stack.timed]
    times += [] if isinstance(env, VecEnv) else [f"{TIME_DEVICE}/{key}" for key in env.stack.device_timed]
    features += [Feature(key=key, shape=(), dtype="float64", unit="s") for key in times]
    sensors = [name for key in env.stack.timed if (name := camera_of_time(key)) is not None]
    features += [Feature(key=flags_key(name), shape=(), dtype="uint8") for name in sensors]
    notes = [*_origins(env, setup), *notes]
    features += [_note(note if isinstance(note, Note) else Note(note)) for note in notes]
    return DatasetInfo(
        frequency=env.frequency,
        features=tuple(features),
        setup={} if setup is None else setup.to_json(),
        instruction=env.instruction if instruction is None else instruction,
        jpeg_quality=jpeg_quality,
        sim_state_size=None if simulated is None else simulated.world.core.state_size,
        versions=versions(),
        origin={"platform": dict(env.platform), **env.stack.about},
    )


def _origins(env: Env | VecEnv, setup: Setup | None) -> list[Note]:
    """Return a note for the origin of each robot's relative actions, where they have one."""
    if setup is None or setup.relative != "origin":
        return []
    key = keys.JOINTS if setup.control == keys.JOINTS else keys.TQUAT
    spaces_of: dict[str, Any] = {name: chain.observation_spaces for name, chain in env.stack.chains.items()}
    return [
        Note(f"{name}/{keys.ORIGIN}".lstrip("/"), size=int(own[key].shape[0]), unit=keys.UNITS[key])
        for name, own in spaces_of.items()
        if key in own
    ]


def _note(note: Note) -> Feature:
    shape = () if note.size is None else (note.size,)
    dtype: DType = "uint8" if note.words else "float64"
    return Feature(key=f"{NOTES}/{note.name}", shape=shape, dtype=dtype, unit=note.unit, words=note.words)


def versions() -> dict[str, str]:
    """Return the versions of the software that makes the data."""
    packages = ("robot-control-stack", "rcs-data", "mujoco-core", "numpy", "gymnasium", "pyarrow", "simplejpeg")
    return {"python": platform.python_version(), **{name: importlib.metadata.version(name) for name in packages}}


def camera_of_time(key: str) -> str | None:
    """Return the camera of a capture time; None for that of another device."""
    return key.removeprefix(_FRAMES) if key.startswith(_FRAMES) else None


def _features(prefix: str, entries: Mapping[str, spaces.Space[Any]], colour: Colour) -> list[Feature]:
    """Return a feature per array, with `/` between the levels of nested spaces."""
    features: list[Feature] = []
    for key, space in entries.items():
        if is_derived(prefix, key):
            continue
        if isinstance(space, spaces.Dict):
            features += _features(f"{prefix}/{key}", space.spaces, colour)
            continue
        assert isinstance(space, spaces.Box)
        # A camera on a table has the same matrices in every row, one on a wrist has not.
        encodings: dict[str, Encoding] = {
            keys.RGB: colour, keys.DEPTH: "depth", keys.SEGMENTATION: "labels", keys.GEOMS: "labels",
            keys.INTRINSICS: "held", keys.DISTORTION: "held", keys.EXTRINSICS: "held",
        }  # fmt: skip
        encoding = encodings.get(key, "plain")
        unit = keys.UNITS.get(key, "")
        dtype = cast("DType", str(space.dtype))  # checked by the feature
        features.append(Feature(key=f"{prefix}/{key}", shape=space.shape, dtype=dtype, unit=unit, encoding=encoding))
    return features


def bounds_of_joints(arm: ArmDescription) -> JointBounds:
    """Return the limits of an arm's joints as a dataset has them."""
    return JointBounds(
        arm=arm.label, names=arm.joints, lower=arm.joint_lower, upper=arm.joint_upper, velocity=arm.velocity_limit
    )


def _arms_of(robot: str | Mapping[str, str]) -> dict[str, ArmDescription]:
    """Return the arms of a robot by their names in keys; a single arm has the empty name."""
    if isinstance(robot, str):
        if robot in lookup.names("arm"):
            return {"": lookup.find("arm", robot)}
        found = lookup.find("lab", robot)
        robot = {stand.name: stand.arm for stand in getattr(found, "stands", ())}
        if not robot:
            return {"": found}
    return {"" if len(robot) == 1 else name: lookup.find("arm", arm) for name, arm in robot.items()}


def is_derived(prefix: str, key: str) -> bool:
    """Return whether a value is left out: points follow from depth and matrices, and are several times as large."""
    return key == keys.POINTS and prefix.startswith(f"{OBSERVATION}/{_FRAMES}")


def require_recordable(setup: Setup) -> None:
    """Check that a setup can be recorded.

    Raises:
        InvalidSetup: Its control mode has no fixed rate.
    """
    if setup.stepping == "sync":
        raise InvalidSetup(
            "A dataset has a fixed rate; synchronous steps have none. Use stepping='async' or 'realtime'."
        )
