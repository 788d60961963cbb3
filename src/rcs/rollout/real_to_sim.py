"""Real-to-sim replay: drives a simulation with the recorded states of a real robot, and keeps what succeeds there too.

A real episode needs no simulation states: its joints and gripper openings are followed, with the objects of the task
placed where `outcome["objects"]` says they were at the start: poses by name, translation [m] and quaternion xyzw in the
base frame of the robot (of several robots: in the scene). The task then judges.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from rcs.data import Dataset, DatasetWriter, EpisodeRecord
from rcs.envs.observers.recorder import OBJECTS, Recorder, require_recordable
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.derive import SOURCE, derive, source_of
from rcs.rollout.look import Look, Stage, setup_of, varied
from rcs.rollout.recorded_motion import GripperFrom, RecordedMotion, find_states

MODE = "states"

Keep = Literal["successes", "all"]
"""Which episodes the new dataset has: those that succeed in simulation, or all that could be replayed."""


@dataclass(frozen=True, kw_only=True)
class RealToSim:
    """What to replay in simulation, and how."""

    source: Path
    """Folder of the dataset of real (or simulated) episodes."""
    out: Path
    """Folder of the new one."""
    task: str | None = None
    """Name of the task that judges; None for that of the dataset's setup."""
    robot: str | None = None
    """Name of the robot's lab; None for that of the dataset's setup."""
    frequency: float | None = None
    """Control steps per second of the simulation [Hz]; None for that of the setup, or of the recording."""
    objects: Path | None = None
    """JSON file with the objects' poses by episode, {id: {name: [x, y, z, qx, qy, qz, qw]}}; None for those that were
    recorded in `outcome["objects"]`."""
    state: str | None = None
    """Feature that has joints [rad], then gripper (0 closed … 1 open) or hand, robot by robot, such as
    `observation/state` in datasets of others; None for those of this library, a feature each."""
    lookahead: float | None = None
    """By how much joint targets run ahead of the recorded states [s]; None for as much as each simulated servo lags, so
    that joints are where they were recorded."""
    gripper: GripperFrom | None = None
    """What the gripper is told: `trend`, to open or to close as the recorded opening does; `opening`, the opening
    itself; `command`, what it was told in the recording. None for `trend` where grippers only open and close fully."""
    keep: Keep = "successes"
    """Which episodes the new dataset has."""
    grace: float = 1.0
    """For how long the last state is held when the recording is over and the task is not done yet [s]."""
    look: Look = field(default_factory=Look)
    workers: int = 1
    """Processes; 0 for one per core."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            InvalidSetup: One that makes no sense.
        """
        for name in ("lookahead", "grace"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < np.inf:
                raise InvalidSetup(f"{name} is {value} s; valid is 0 and more.")
        for name, valid in (("keep", get_args(Keep)), ("gripper", (None, *get_args(GripperFrom)))):
            if getattr(self, name) not in valid:
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; valid: {', '.join(map(repr, valid))}.")

    def setup(self, dataset: Dataset) -> Setup:
        """Return the setup to replay a dataset in: absolute joint targets, and task and robot as given or recorded.

        Raises:
            InvalidSetup: The dataset's setup is not one of ours, and task or robot is not given; or it has no rate.
        """
        try:
            setup = setup_of(dataset)
        except InvalidSetup as err:
            if self.task is None or self.robot is None:
                raise InvalidSetup(
                    f"The setup of {dataset.path} is not one of this library ({err}) Say what to simulate: give a "
                    "robot and a task."
                ) from err
            setup = Setup(max_episode_steps=None, frequency=dataset.info.fps)
        setup = replace(
            setup,
            task=self.task or setup.task,
            robot=self.robot or setup.robot,
            control="joints",
            relative="absolute",
            mode="async" if setup.mode == "realtime" else setup.mode,
            frequency=self.frequency or setup.frequency,
            max_episode_steps=None,
        )
        require_recordable(setup)
        return replace(setup, binary_gripper=setup.binary_gripper if self.gripper is None else self.gripper == "trend")

    def gripper_from(self, setup: Setup) -> GripperFrom:
        """Return what the gripper is told, in a setup of `setup`."""
        return self.gripper or ("trend" if setup.binary_gripper else "opening")


@dataclass(frozen=True, kw_only=True)
class RealToSimResult:
    """How one episode went in simulation."""

    episode_id: str
    recorded_success: bool | None
    """What the recording says."""
    success: bool
    """What the task says of the simulated one."""
    steps: int = 0
    joint_error: tuple[float, float] | None = None
    """Largest and median distance of a simulated joint from the recorded one [rad]; None if it was not replayed."""
    problem: str | None = None
    """Why it could not be replayed; None if it was."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        error = self.joint_error
        return {
            "episode": self.episode_id,
            "recorded_success": self.recorded_success,
            "success": self.success,
            "steps": self.steps,
            "joint_error": None if error is None else {"max": error[0], "median": error[1]},
            "problem": self.problem,
        }


def real_to_sim(replay: RealToSim) -> Iterator[RealToSimResult]:
    """Replay every episode in simulation and record those that are to be kept.

    Raises:
        InvalidSetup: The dataset does not fit the setup, or no episode says where the objects were.
        DatasetError, CorruptEpisode: A dataset cannot be read or written.
    """
    dataset = Dataset.open(replay.source)
    stage = _stage(replay, dataset)
    env, _ = stage.env()
    try:
        _require_objects(replay, dataset, set(env.scenario.task.object_poses()))
        find_states(dataset.info, env.scenario.robots, replay.gripper_from(stage.setup), replay.state)
        info = stage.info(env, dataset.info)
    finally:
        env.close()
    make = functools.partial(_Replayer, replay)
    return derive(replay.out, info, make, range(len(dataset)), replay.workers)


def _stage(replay: RealToSim, dataset: Dataset) -> Stage:
    setup = replay.setup(dataset)
    return Stage.of(setup, setup, replay.look)


class _Replayer:
    """Replays episodes in simulation: the part that one process does."""

    def __init__(self, replay: RealToSim, out: Path) -> None:
        self._replay = replay
        self._dataset = Dataset.open(replay.source)
        self._objects = _read_objects(replay.objects)
        self._stage = _stage(replay, self._dataset)
        self._writer = DatasetWriter.join(out)
        self._env, self._looks = self._stage.env()
        self._recorder = Recorder(self._writer)
        self._env.add_observer(self._recorder)

    def attempt(self, number: int) -> RealToSimResult:
        """Replay one episode."""
        episode = self._dataset.episodes[number]
        try:
            with self._recorder.discard_on_error():
                return self._follow(episode)
        except InvalidSetup as err:
            # Of this episode alone: a joint far out of its limits, no object's pose, an explosion.
            self._recorder.forget_next()
            return RealToSimResult(
                episode_id=episode.id, recorded_success=episode.success, success=False, problem=str(err)
            )

    def _follow(self, episode: EpisodeRecord) -> RealToSimResult:
        setup, scenario = self._stage.setup, self._env.scenario
        motion = RecordedMotion(
            episode,
            scenario.robots,
            self._replay.gripper_from(setup),
            self._replay.lookahead,
            self._replay.state,
        )
        if self._looks is not None:
            self._looks.episode_id = episode.id
        self._recorder.name_next(episode.id, instruction=episode.instruction)
        options: dict[str, Any] = {"robot": motion.start()}
        if scenario.task.object_poses():
            options[OBJECTS] = self._poses(episode)
        observation, info = self._env.reset(seed=episode.seed, options=options)
        steps, reward, errors = 0, 0.0, [motion.error(observation, 0.0)]
        last = int(np.ceil((motion.duration + self._replay.grace) * setup.frequency - 1e-9))
        is_over = False
        while not is_over and steps < last:
            steps += 1
            time = steps / setup.frequency
            action = motion.action(time, 1 / setup.frequency)
            observation, earned, terminated, truncated, info = self._env.step(action)
            reward += float(earned)
            if time <= motion.duration:
                errors.append(motion.error(observation, time))
            is_over = terminated or truncated
        success = bool(info.get("success", False))
        result = RealToSimResult(
            episode_id=episode.id,
            recorded_success=episode.success,
            success=success,
            steps=steps,
            joint_error=(float(max(errors)), float(np.median(errors))),
        )
        if success or self._replay.keep == "all":
            told = result.to_json()
            source = {
                **source_of(episode, self._dataset.path, MODE),
                "joint_error": told["joint_error"],
                "success": episode.success,
            }
            outcome = {"failure": None if success else "replay", "reward": reward, **varied(self._env), SOURCE: source}
            self._recorder.finish(success, outcome)
        else:
            self._recorder.discard()
        return result

    def _poses(self, episode: EpisodeRecord) -> Mapping[str, Any]:
        poses = episode.outcome.get(OBJECTS) if self._objects is None else self._objects.get(episode.id)
        if poses is None:
            raise InvalidSetup("It is not known where the objects were.")
        return poses

    def close(self) -> None:
        """Close the environment and the writer."""
        self._env.close()
        self._writer.close()


def _require_objects(replay: RealToSim, dataset: Dataset, names: set[str]) -> None:
    given = _read_objects(replay.objects)
    if not names or given is not None or any(OBJECTS in episode.outcome for episode in dataset.episodes):
        return
    raise InvalidSetup(
        f"No episode of {dataset.path} says where the objects were ({', '.join(sorted(names))}). Record it as "
        "outcome['objects'] = {name: [x, y, z, qx, qy, qz, qw]} in the robot's base frame, or give a JSON file "
        "{episode id: {name: [...]}}."
    )


def _read_objects(path: Path | None) -> dict[str, Any] | None:
    if path is None:
        return None
    try:
        poses = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as err:
        raise InvalidSetup(f"The file with the objects' poses, {path}, does not read: {err}") from err
    if not isinstance(poses, dict) or not all(isinstance(value, dict) for value in poses.values()):
        raise InvalidSetup(f"{path} has no poses; valid is {{episode id: {{name: [x, y, z, qx, qy, qz, qw]}}}}.")
    return poses
