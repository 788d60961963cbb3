"""How well a camera's pose is found: rendered pictures of a board of four tags, both arrangements, many seeds.

Every seed has its own camera: some centimetres and degrees from where the lab has it, with another principal point and
a distorted lens. The strategy starts from the lab's pose, picks its poses itself and drives to them in the simulation.
From the same pictures the camera's pose is then found as they are, with noise of the picture and of the robot, and with
a tenth of all tags in wrong places; what is told is the distance from the true pose, the worst over all seeds. Views
that turn about one axis only must be refused, and focal lengths that are 1 % off must raise the alarm.

Prints a table, then one JSON object: `worst_mm`, `worst_deg`, `noisy_worst_mm`, `noisy_worst_deg`; with outliers
`outliers_worst_mm`, `outliers_worst_deg`; `single_axis_refused`, `lens_alarms`, and the same per arrangement.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import rcs
from rcs.calibration import Board, BoardStrategy, Detections, HandEye, Rig, View, detect, hand_eye
from rcs.errors import InvalidSetup
from rcs.robots import Mount
from rcs.robots.calibration import CameraCalibration
from rcs.rollout.calibrate import Tour, calibrate
from rcs.rollout.free_path import FreePath
from rcs.setups.calibration import Calibration, write_calibration
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Intrinsics, Pose
from rcs.tasks import ShowBoardOptions

CAMERAS = {"eye-in-hand": "wrist", "eye-to-hand": "side"}
BOARDS: dict[str, dict[str, Any]] = {
    "eye-in-hand": {"on": "scene"},
    "eye-to-hand": {"on": "gripper", "x": 0.0, "z": 0.2, "roll": np.pi / 2},
}
FOCAL = {"eye-in-hand": 433.0, "eye-to-hand": 617.0}


@dataclass(kw_only=True)
class Options:
    """What to measure."""

    robot: str = "fr3"
    """Robot, whose lab has a camera `wrist` and a camera `side`."""
    seeds: int = 20
    """Cameras per arrangement."""
    views: int = 20
    """Pictures of each."""
    size: tuple[int, int] = (640, 480)
    """Of a picture [px]."""
    picture_noise: float = 2.0
    """Standard deviation of each colour of each pixel, of 255."""
    robot_noise: tuple[float, float] = (0.1, 0.02)
    """Standard deviations of the flange's pose, along and about every axis [mm, degrees]."""
    outliers: float = 0.1
    """Share of tags that are put in wrong places."""


def error(found: HandEye, true: Pose) -> tuple[float, float]:
    """Return how far a camera is from where it was found [mm, degrees]."""
    off = true.inverse() * found.camera_in_mount
    return 1000 * float(np.linalg.norm(off.translation)), float(np.rad2deg(np.linalg.norm(off.rotvec)))


def near(pose: Pose, rng: np.random.Generator) -> Pose:
    """Return a pose some centimetres and degrees away."""
    return pose * Pose.from_rotvec(rng.uniform(-0.02, 0.02, 3), np.deg2rad(rng.uniform(-3, 3, 3)))


def with_noise(views: Sequence[View], pictures: Sequence[NDArray[np.uint8]], board: Board, options: Options,
               rng: np.random.Generator) -> list[View]:  # fmt: skip
    """Return the views as noise of the picture and of the robot would have them."""
    millimetres, degrees = options.robot_noise
    noisy: list[View] = []
    for view, picture in zip(views, pictures, strict=True):
        grains = picture + rng.normal(0.0, options.picture_noise, picture.shape)
        off = Pose.from_rotvec(rng.normal(0, millimetres / 1000, 3), rng.normal(0, np.deg2rad(degrees), 3))
        found = detect(board, np.clip(np.rint(grains), 0, 255).astype(np.uint8))
        noisy.append(View(flange_in_base=view.flange_in_base * off, detections=found))
    return noisy


def with_outliers(views: Sequence[View], share: float, rng: np.random.Generator) -> list[View]:
    """Return the views with some tags wrong: moved, swapped with another, or turned by half a turn."""
    spoilt = [
        replace(view, detections=Detections(view.detections.ids, view.detections.corners.copy())) for view in views
    ]
    tags = [(view, i) for view in spoilt for i in range(len(view.detections))]
    for n, k in enumerate(rng.choice(len(tags), round(share * len(tags)), replace=False)):
        view, i = tags[k]
        corners = view.detections.corners
        if n % 3 == 0:
            corners[i] += rng.uniform(5, 40, 2) * rng.choice([-1, 1], 2)
        elif n % 3 == 1:
            corners[i] = corners[i][[2, 3, 0, 1]]
        else:
            corners[i] = corners[(i + 1) % len(corners)] + rng.normal(0, 3, (4, 2))
    return spoilt


class Keeping(BoardStrategy):
    """Keeps the pictures."""

    def __init__(self, rig: Rig, board: Board, **options: Any) -> None:
        """Begin without any."""
        super().__init__(rig, board, **options)
        self.pictures: list[NDArray[np.uint8]] = []

    def look(self, picture: NDArray[np.uint8], joints: NDArray[np.float64]) -> bool:
        """Keep it if it is of use."""
        is_of_use = super().look(picture, joints)
        if is_of_use:
            self.pictures.append(picture.copy())
        return is_of_use


def is_single_axis_refused(tour: Tour, camera: str, strategy: Keeping) -> bool:
    """Return whether views in which only the last joint turns are refused."""
    views: list[View] = []
    middle = strategy.rig.kinematics.joint_lower[-1] / 2 + strategy.rig.kinematics.joint_upper[-1] / 2
    joints = tour.joints
    for turn in np.linspace(-0.8, 0.8, 10):
        tour.go_to(np.array([*joints[:-1], middle + turn]))
        found = detect(strategy.board, tour.picture(camera))
        views.append(View(flange_in_base=strategy.rig.kinematics.forward(tour.joints), detections=found))
    # Also those that show nothing count as views here: it is the motion that is judged.
    known = strategy.views[0].detections
    views = [view if len(view.detections) else replace(view, detections=known) for view in views]
    try:
        hand_eye(strategy.board, views, strategy.rig.arrangement, strategy.rig.intrinsics)
    except InvalidSetup as err:
        return "one axis" in str(err)
    return False


def measure(arrangement: str, seed: int, options: Options, folder: Path) -> dict[str, Any]:
    """Return the errors of one camera."""
    rng = np.random.default_rng(seed)
    name, task = CAMERAS[arrangement], ShowBoardOptions(**BOARDS[arrangement])
    setup = rcs.Setup(
        task="rcs.tasks.show_board:ShowBoard", task_options=task.to_json(), robot=options.robot, cameras=(name,),
        image_size=options.size, relative="absolute", stepping="sync", max_episode_steps=None,
    )  # fmt: skip
    lab = MountedCamera.of(setup, name)
    width, height = options.size
    focal = FOCAL[arrangement] * height / 480
    seen = Intrinsics(
        width=width, height=height, fx=focal * rng.uniform(0.98, 1.02), fy=focal * rng.uniform(0.98, 1.02),
        cx=(width - 1) / 2 + rng.uniform(-8, 8), cy=(height - 1) / 2 + rng.uniform(-8, 8),
        distortion=(*rng.uniform(-0.05, 0.05, 2), *rng.uniform(-0.001, 0.001, 2), 0.0),
    )  # fmt: skip
    optical = Mount.of(near(lab.camera.optical_in_parent.pose, rng))
    file = folder / f"{arrangement}-{seed}.json"
    write_calibration(file, {name: Calibration(optical=optical, camera=CameraCalibration(intrinsics=seen))})
    setup = replace(setup, calibration=str(file))
    with rcs.make(setup) as env:
        true = MountedCamera.of(setup, name).rig(seen).camera_in_mount
        strategy = Keeping(lab.rig(seen, near(task.pose, rng)), task.board, views=options.views, seed=seed)
        found = calibrate(env, strategy, name, is_free=FreePath(env, lab.robot.name))
        refused = is_single_axis_refused(Tour(env), name, strategy) if seed == 0 else True

    def solved(views: Sequence[View], lens: Intrinsics = seen) -> HandEye:
        return hand_eye(task.board, views, lab.arrangement, lens)

    noisy = solved(with_noise(strategy.views, strategy.pictures, task.board, options, rng))
    spoilt = solved(with_outliers(strategy.views, options.outliers, rng))
    off = solved(strategy.views, replace(seen, fx=1.01 * seen.fx, fy=1.01 * seen.fy))
    return {
        "clean": error(found, true), "noisy": error(noisy, true), "outliers": error(spoilt, true),
        "sigma": (noisy.sigma_mm, noisy.sigma_degrees), "held_out": (noisy.held_out_mm, noisy.held_out_degrees),
        "false_alarms": len(found.alarms) + len(noisy.alarms) + len(spoilt.alarms),
        "lens_alarm": bool(off.alarms), "refused": refused,
    }  # fmt: skip


def main(options: Options) -> None:
    """Measure and print."""
    table = Table("arrangement", "", "median", "worst", title=f"Error of the camera's pose, {options.seeds} seeds")
    report: dict[str, Any] = {"seeds": options.seeds, "views": options.views}
    with tempfile.TemporaryDirectory() as folder:
        rows = {
            arrangement: [measure(arrangement, seed, options, Path(folder)) for seed in range(options.seeds)]
            for arrangement in CAMERAS
        }
    for arrangement, found in rows.items():
        report[arrangement] = {}
        for kind in ("clean", "noisy", "outliers", "sigma", "held_out"):
            errors = np.array([row[kind] for row in found])
            middle, worst = np.median(errors, axis=0), errors.max(axis=0)
            table.add_row(arrangement, kind, *(f"{mm:.3f} mm {deg:.4f}°" for mm, deg in (middle, worst)))
            report[arrangement][kind] = {"median": middle.round(4).tolist(), "worst": worst.round(4).tolist()}
    every = [row for found in rows.values() for row in found]
    for kind, prefix in (("clean", ""), ("noisy", "noisy_"), ("outliers", "outliers_")):
        mm, deg = np.array([row[kind] for row in every]).max(axis=0)
        report |= {f"{prefix}worst_mm": round(float(mm), 4), f"{prefix}worst_deg": round(float(deg), 5)}
    report["single_axis_refused"] = all(row["refused"] for row in every)
    report["lens_alarms"] = float(np.mean([row["lens_alarm"] for row in every]))
    report["false_alarms"] = sum(row["false_alarms"] for row in every)
    Console().print(table)
    print(json.dumps(report))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
