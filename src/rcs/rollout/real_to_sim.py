"""Real-to-sim replay: drives a simulation with the recorded states of a real robot, and keeps the successes.

The simulated robot follows recorded joints and gripper openings. The task's objects are placed according to
`outcome["objects"]`: their poses at the start by name, translation [m] and quaternion xyzw in the base frame of the
robot (with several robots: in the scene). The task judges the result.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from rcs_data import Dataset, DatasetInfo, EpisodeRecord

from rcs.envs.env import Env
from rcs.envs.observers.recorder import OBJECTS, require_recordable
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.derive import Derivation, Workplace
from rcs.rollout.look import Stage, setup_of
from rcs.rollout.recorded_motion import GripperFrom, RecordedMotion, find_states
from rcs.rollout.replay import Step

Keep = Literal["successes", "all"]
"""Episodes to keep: those that succeed in simulation, or all that could be replayed."""


@dataclass(frozen=True, kw_only=True)
class RealToSimResult:
    """The result of one episode in simulation."""

    episode_id: str
    recorded_success: bool | None
    """The verdict of the recording."""
    success: bool
    """The task's verdict on the simulated episode."""
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


@dataclass(frozen=True, kw_only=True)
class RealToSim(Derivation):
    """Replays every episode of real (or simulated) robots in simulation and records those to keep."""

    kind = "states"

    task: str | None = None
    """Name of the task that judges; None for that of the dataset's setup."""
    robot: str | None = None
    """Name of the robot's lab; None for that of the dataset's setup."""
    frequency: float | None = None
    """Control steps per second of the simulation [Hz]; None for that of the setup, or of the recording."""
    objects: Path | None = None
    """JSON file with the objects' poses by episode, {id: {name: [x, y, z, qx, qy, qz, qw]}}; None for those in
    `outcome["objects"]`."""
    state: str | None = None
    """Feature with joints [rad], then gripper (0 closed … 1 open) or hand, robot by robot, such as `observation/state`
    in foreign datasets; None for RCS's own, one feature each."""
    lookahead: float = 0.0
    """Lead of joint targets over the recorded states [s]. A simulated arm reaches a target by the end of its step."""
    gripper: GripperFrom | None = None
    """What the gripper follows: `trend`, whether the recorded opening grows or shrinks; `opening`, the opening itself;
    `command`, the recorded command. None for `trend` with grippers that only open and close fully."""
    keep: Keep = "successes"
    """Episodes to keep."""
    grace: float = 1.0
    """How long to hold the last state if the task is not done yet [s]."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            InvalidSetup: An option is not valid.
        """
        for name in ("lookahead", "grace"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise InvalidSetup(f"{name} is {value} s; valid is 0 and more.")
        for name, valid in (("keep", get_args(Keep)), ("gripper", (None, *get_args(GripperFrom)))):
            if getattr(self, name) not in valid:
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; valid: {', '.join(map(repr, valid))}.")

    def setup(self, dataset: Dataset) -> Setup:
        """Return the setup to replay a dataset in: absolute joint targets, and task and robot as given or recorded.

        Its arms are stiff, since what was measured has given way already.

        Raises:
            InvalidSetup: The dataset's setup cannot be used, and task or robot is not given.
        """
        try:
            setup = setup_of(dataset, trust=self.trust, task=self.task)
        except InvalidSetup as err:
            if self.task is None or self.robot is None:
                raise InvalidSetup(f"Cannot use the setup of {dataset.path} ({err}) Give a  robot and a task.") from err
            setup = Setup(max_episode_steps=None, frequency=dataset.info.frequency)
        setup = replace(
            setup,
            task=self.task or setup.task,
            robot=self.robot or setup.robot,
            control="joints",
            relative="absolute",
            stepping="async" if setup.stepping == "realtime" else setup.stepping,
            frequency=self.frequency or setup.frequency,
            max_episode_steps=None,
            compliance=None,
        )
        require_recordable(setup)
        return replace(setup, binary_gripper=setup.binary_gripper if self.gripper is None else self.gripper == "trend")

    def gripper_from(self, setup: Setup) -> GripperFrom:
        """Return what the gripper follows in a setup."""
        return self.gripper or ("trend" if setup.binary_gripper else "opening")

    def stage(self, dataset: Dataset) -> Stage:
        """Return the stage to replay on; the real arm has gone on where a simulated one would take a touch for more."""
        setup = replace(self.setup(dataset), collision_reaction=False)
        return Stage.of(setup, setup, self.look)

    def info(self, dataset: Dataset, stage: Stage, env: Env) -> DatasetInfo:
        """Return the info of the new dataset.

        Raises:
            InvalidSetup: The dataset does not fit the robots, or no episode has the objects' poses.
        """
        if names := sorted(env.scenario.task.object_poses()):
            self._require_objects(dataset, names)
        find_states(dataset.info, env.scenario.robots, self.gripper_from(stage.setup), self.state)
        return stage.info(env, dataset.info)

    def make(self, workplace: Workplace, episode: EpisodeRecord) -> RealToSimResult:
        """Replay one episode."""
        setup, scenario = workplace.stage.setup, workplace.env.scenario
        gripper = self.gripper_from(setup)
        motion = RecordedMotion(episode, scenario.robots, gripper, setup.frequency, self.lookahead, self.state)
        options: dict[str, Any] = {"robot": motion.start()}
        if scenario.task.object_poses():
            options[OBJECTS] = self._poses(episode)
        most = int(np.ceil((motion.duration + self.grace) * setup.frequency - 1e-9))
        errors: list[float] = []

        def compare(step: Step) -> None:
            if (time := step.row / setup.frequency) <= motion.duration:
                errors.append(motion.error(step.observation, time))

        last = workplace.play(episode, motion, options, most, compare)
        result = RealToSimResult(
            episode_id=episode.id,
            recorded_success=episode.success,
            success=last.success,
            steps=last.row,
            joint_error=(float(max(errors)), float(np.median(errors))),
        )
        if last.success or self.keep == "all":
            more = {"joint_error": result.to_json()["joint_error"], "success": episode.success}
            workplace.keep(episode, last, more)
        else:
            workplace.recorder.discard()
        return result

    def give_up(self, episode: EpisodeRecord, error: InvalidSetup) -> RealToSimResult:
        """Go on, since joints out of limits, missing poses of objects or an explosion concern this episode only."""
        return RealToSimResult(
            episode_id=episode.id, recorded_success=episode.success, success=False, problem=str(error)
        )

    def _poses(self, episode: EpisodeRecord) -> Mapping[str, Any]:
        given = _read_objects(self.objects)
        poses = episode.outcome.get(OBJECTS) if given is None else given.get(episode.id)
        if poses is None:
            raise InvalidSetup("The objects' poses are unknown.")
        return poses

    def _require_objects(self, dataset: Dataset, names: list[str]) -> None:
        if _read_objects(self.objects) is None and not any(OBJECTS in e.outcome for e in dataset.episodes):
            raise InvalidSetup(
                f"No episode of {dataset.path} has poses of the objects {', '.join(names)}. Record them as  "
                "outcome['objects'] = {name: [x, y, z, qx, qy, qz, qw]} in the robot's base frame, or give a JSON file "
                "{episode id: {name: [...]}}."
            )


def _read_objects(path: Path | None) -> dict[str, Any] | None:
    if path is None:
        return None
    try:
        poses = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"Cannot read the objects' poses in {path}: {err}") from err
    if not isinstance(poses, dict) or not all(isinstance(value, dict) for value in poses.values()):
        raise InvalidSetup(f"{path} has no poses; expected {{episode id: {{name: [x, y, z, qx, qy, qz, qw]}}}}.")
    return poses
