"""Real-to-sim replay: drives a simulation with the recorded states of a real robot, and keeps the successes.

The simulated robot follows recorded joints and gripper openings. The task's objects are placed according to
`outcome["objects"]`: their poses at the start by name, translation [m] and quaternion xyzw in the base frame of the
robot (with several robots: in the scene). The task judges the result.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from rcs_data import Dataset, EpisodeRecord

from rcs.envs.observers.dataset_info import OBJECTS, require_recordable
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.derived_dataset import Derivation, EpisodeMaker, derive
from rcs.rollout.recorded_motion import RecordedMotion, find_states
from rcs.rollout.recorded_setup import setup_of
from rcs.rollout.reexecute import ReexecutionResult
from rcs.rollout.replay_scene import Appearance, ReplayScene

Keep = Literal["successes", "all"]
"""Episodes to keep: those that succeed in simulation, or all that could be replayed."""


def real_to_sim(
    source: str | Path,
    out: str | Path,
    *,
    task: str | None = None,
    robot: str | None = None,
    objects: str | Path | None = None,
    state: str | None = None,
    keep: Keep = "successes",
    grace: float = 1.0,
    appearance: Appearance | None = None,
    workers: int = 1,
    trust: Collection[str] = (),
) -> Iterator[ReexecutionResult]:
    """Make simulated robots follow every episode of real (or simulated) ones, and record those to keep.

    Args:
        source: Folder of the recorded dataset.
        out: Folder of the new dataset; it must not exist.
        task: Name of the task that judges; None for that of the dataset's setup.
        robot: Name of the robot's lab; None for that of the dataset's setup.
        objects: JSON file with the objects' poses by episode, {id: {name: [x, y, z, qx, qy, qz, qw]}}; None for those
            in `outcome["objects"]`.
        state: Feature with joints [rad], then gripper (0 closed … 1 open) or hand, robot by robot, such as
            `observation/state` in foreign datasets; None for RCS's own, one feature each.
        keep: Episodes to keep.
        grace: How long to hold the last state if the task is not done yet [s].
        appearance: Changes to the frames; None for the recorded ones.
        workers: Number of processes; 1 for this one, 0 for one per core.
        trust: Modules that may be imported because the dataset's setup names them.

    Raises:
        InvalidSetup: The dataset does not fit the robots, no episode has the objects' poses, or an option is not valid.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    if not 0 <= grace < np.inf:
        raise InvalidSetup(f"grace is {grace} s; valid is 0 and more.")
    if keep not in get_args(Keep):
        raise InvalidSetup(f"keep is {keep!r}; valid: {', '.join(map(repr, get_args(Keep)))}.")
    dataset = Dataset.open(source)
    setup = _setup(dataset, task, robot, trust)
    scene = ReplayScene(physics=setup, frames=setup, appearance=appearance or Appearance())
    poses = None if objects is None else _read_objects(Path(objects))
    env, _ = scene.make()
    try:
        if (names := sorted(env.simulation.task.object_poses())) and poses is None:
            _require_objects(dataset, names)
        find_states(dataset.info, env.simulation.robots, setup.binary_gripper, state)
        info = scene.info(env, dataset.info)
    finally:
        env.close()
    follow = _Follow(poses=poses, state=state, keep=keep, grace=grace)
    recipe = Derivation(kind="states", source=Path(source), scene=scene, make=follow)
    yield from derive(recipe, Path(out), info, workers)


def _setup(dataset: Dataset, task: str | None, robot: str | None, trust: Collection[str]) -> Setup:
    """Return the setup of the simulation: absolute joint targets, and task and robot as given or recorded.

    Its arms are stiff, since the measured ones have given way already, and go on after a collision, as the real ones
    have.
    """
    try:
        setup = setup_of(dataset, trust=trust, task=task)
    except InvalidSetup as err:
        if task is None or robot is None:
            raise InvalidSetup(f"Cannot use the setup of {dataset.path} ({err}) Give a robot and a task.") from err
        setup = Setup(frequency=dataset.info.frequency)
    setup = replace(
        setup,
        task=task or setup.task,
        robot=robot or setup.robot,
        control="joints",
        relative="absolute",
        stepping="async" if setup.stepping == "realtime" else setup.stepping,
        max_episode_steps=None,
        compliance=None,
        collision_reaction=False,
    )
    require_recordable(setup)
    return setup


@dataclass(frozen=True, kw_only=True)
class _Follow:
    """Makes one episode."""

    poses: Mapping[str, Any] | None
    state: str | None
    keep: Keep
    grace: float

    def __call__(self, maker: EpisodeMaker, episode: EpisodeRecord) -> ReexecutionResult:
        try:
            with maker.recorder.discard_on_error():
                return self._follow(maker, episode)
        except InvalidSetup as err:  # joints out of limits, missing poses or an explosion concern this episode only
            maker.recorder.forget_next()
            return ReexecutionResult(
                episode_id=episode.id, recorded_success=episode.success, success=False, problem=str(err)
            )

    def _follow(self, maker: EpisodeMaker, episode: EpisodeRecord) -> ReexecutionResult:
        setup, simulation = maker.env.setup, maker.env.simulation
        motion = RecordedMotion(episode, simulation.robots, setup.binary_gripper, setup.frequency, self.state)
        start: dict[str, Any] = {"robot": motion.start()}
        if simulation.task.object_poses():
            poses = episode.outcome.get(OBJECTS) if self.poses is None else self.poses.get(episode.id)
            if poses is None:
                raise InvalidSetup("The objects' poses are unknown.")
            start[OBJECTS] = poses
        most = int(np.ceil((motion.duration + self.grace) * setup.frequency - 1e-9))
        errors: list[float] = []
        last = None
        for last in maker.play(episode, motion, start, most):
            if (time := last.row / setup.frequency) <= motion.duration:
                errors.append(motion.error(last.observation, time))
        assert last is not None, "the reset always yields"
        result = ReexecutionResult(
            episode_id=episode.id,
            recorded_success=episode.success,
            success=last.success,
            recorded_steps=episode.length - 1,
            steps=last.row,
            errors={"joints": errors},
        )
        if last.success or self.keep == "all":
            maker.keep(episode, last, {"errors": result.summary(), "success": episode.success})
        else:
            maker.recorder.discard()
        return result


def _require_objects(dataset: Dataset, names: list[str]) -> None:
    if not any(OBJECTS in episode.outcome for episode in dataset.episodes):
        raise InvalidSetup(
            f"No episode of {dataset.path} has poses of the objects {', '.join(names)}. Record them as  "
            "outcome['objects'] = {name: [x, y, z, qx, qy, qz, qw]} in the robot's base frame, or give a JSON file "
            "{episode id: {name: [...]}}."
        )


def _read_objects(path: Path) -> dict[str, Any]:
    try:
        poses = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"Cannot read the objects' poses in {path}: {err}") from err
    if not isinstance(poses, dict) or not all(isinstance(value, dict) for value in poses.values()):
        raise InvalidSetup(f"{path} has no poses; expected {{episode id: {{name: [x, y, z, qx, qy, qz, qw]}}}}.")
    return poses
