"""Measure the accuracy of hand-eye calibration, on rendered pictures of a board of four tags, for many seeds.

Every seed has its own camera: some centimetres and degrees from where the lab has it, with another principal point and
a distorted lens. The strategy starts from the lab's pose, picks its poses itself and drives to them in the simulation.
From the same pictures the camera's pose is then found with an exact robot, with noise of the pictures and of the robot,
small and large, and with a tenth of all tags in wrong places; and from pictures of a second, strongly bent lens. Beside
it stands Park's closed form, `cv2.calibrateHandEye(..., CALIB_HAND_EYE_PARK)`, with the same views less the tags that
were rejected; OpenCV 5 has it no longer, and the closed form of `rcs.calibration`, the same method, takes its place.

The error is the distance from the true position, or the angle from the true rotation. It is compared with the standard
deviation that is stated, the root of the sum of the variances along or about all three axes: of well stated ones, the
median of error / standard deviation is about 0.7 to 0.9. Views that turn about one axis only must be refused, and focal
lengths that are 1 % off must raise the alarm.

Prints a table, then one JSON object: per arrangement and case `mm`, `deg`, `park_mm`, `park_deg`, `ratio_mm`,
`ratio_deg` (medians, 90 % and largest) and what the robot seemed to be off, `robot` (medians); `single_axis_refused`,
`lens_alarms` (share), `false_alarms` (number).
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

import rcs
from rcs.calibration import Board, BoardStrategy, Detections, HandEye, View, detect, hand_eye
from rcs.calibration.board_pose import board_poses
from rcs.calibration.closed_form import camera_in_mount, rigid
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.robots import Mount
from rcs.rollout.calibrate import FreePath, Tour, look_around
from rcs.setups import Calibration, ShowBoardOptions, write_calibration
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Intrinsics, Pose

CAMERAS = {"eye-in-hand": "wrist", "eye-to-hand": "side"}
BOARDS = {
    "eye-in-hand": ShowBoardOptions(),
    "eye-to-hand": ShowBoardOptions(
        mount=Mount.of(Pose.from_rpy((0.0, 0.0, 0.2), (np.pi / 2, 0.0, 0.0))), on_gripper_of="fr3"
    ),
}
FOCAL = {"eye-in-hand": 433.0, "eye-to-hand": 617.0}
BENT = 617.0, (-0.3, 0.0, 0.0, 0.0, 0.0)
"""Focal length and distortion of a strongly bent lens; one of 433 px would fold the corners of its picture over."""
CASES = "exact", "small noise", "large noise", "outliers", "k1 -0.3"
FIGURES = {"mm": " mm", "deg": "°", "park_mm": " mm", "park_deg": "°", "ratio_mm": "", "ratio_deg": ""}
"""Figures of each case, with units."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robot: str = "fr3"
    """Robot, whose lab has a camera `wrist` and a camera `side`."""
    seeds: int = 50
    """Cameras per arrangement."""
    views: int = 20
    """Pictures per camera."""
    size: tuple[int, int] = (640, 480)
    """Size of a picture [px]."""
    picture_noise: float = 2.0
    """Standard deviation of each pixel's shade, of 255, in all cases with noise."""
    small_noise: tuple[float, float] = (0.1, 0.02)
    """Standard deviations of the flange's pose, along and about every axis [mm, degrees]."""
    large_noise: tuple[float, float] = (0.5, 0.1)
    """The same for a less accurate robot."""
    outliers: float = 0.1
    """Fraction of misplaced tags."""


def error(found: Pose, true: Pose) -> tuple[float, float]:
    """Return the error of a camera's pose [mm, degrees]."""
    off = true.inverse() * found
    return 1000 * float(np.linalg.norm(off.translation)), float(np.rad2deg(np.linalg.norm(off.rotvec)))


def park(board: Board, views: Sequence[View], found: HandEye, lens: Intrinsics) -> Pose:
    """Return the camera's pose by Park's closed form, without the rejected tags."""
    rejected = set(found.rejected)
    anchors: list[NDArray[np.float64]] = []
    boards: list[NDArray[np.float64]] = []
    for i, view in enumerate(views):
        right = np.array([(i, int(number)) not in rejected for number in view.detections.ids], bool)
        for pose in board_poses(board, view.detections[right], lens)[:1]:
            anchors.append(view.anchor_in_mount(found.arrangement))
            boards.append(pose.board_in_camera)
    cv2 = package_of("calibration", "cv2")
    if not hasattr(cv2, "calibrateHandEye"):
        return rigid(camera_in_mount(np.array(anchors), np.array(boards)))
    mounts = np.linalg.inv(anchors)
    rotation, translation = cv2.calibrateHandEye(
        list(mounts[:, :3, :3]), list(mounts[:, :3, 3]), [one[:3, :3] for one in boards],
        [one[:3, 3] for one in boards],
        method=cv2.CALIB_HAND_EYE_PARK,
    )  # fmt: skip
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation[:, 0]
    return rigid(pose)


def near(pose: Pose, rng: np.random.Generator) -> Pose:
    """Return a pose some centimetres and degrees away."""
    return pose * Pose.from_rotvec(rng.uniform(-0.02, 0.02, 3), np.deg2rad(rng.uniform(-3, 3, 3)))


def with_noise(strategy: BoardStrategy, sigma: float, rng: np.random.Generator) -> list[View]:
    """Return the views with noise of the pictures."""
    noisy: list[View] = []
    for view, picture in zip(strategy.views, strategy.pictures, strict=True):
        grains = np.clip(np.rint(picture + rng.normal(0.0, sigma, picture.shape)), 0, 255).astype(np.uint8)
        noisy.append(replace(view, detections=detect(strategy.board, grains, strategy.rig.intrinsics)))
    return noisy


def with_robot(views: Sequence[View], noise: tuple[float, float], rng: np.random.Generator) -> list[View]:
    """Return the views with noise of the robot [mm, degrees]."""
    metres, radians = noise[0] / 1000, np.deg2rad(noise[1])
    off = [Pose.from_rotvec(rng.normal(0, metres, 3), rng.normal(0, radians, 3)) for _ in views]
    return [replace(view, flange_in_base=view.flange_in_base * one) for view, one in zip(views, off, strict=True)]


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


def is_single_axis_refused(tour: Tour, camera: str, strategy: BoardStrategy) -> bool:
    """Return True if views in which only the last joint turns are refused."""
    views: list[View] = []
    middle = strategy.rig.kinematics.joint_lower[-1] / 2 + strategy.rig.kinematics.joint_upper[-1] / 2
    joints = tour.joints
    for turn in np.linspace(-0.8, 0.8, 10):
        tour.go_to(np.array([*joints[:-1], middle + turn]))
        found = detect(strategy.board, tour.picture(camera), strategy.rig.intrinsics)
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
    """Return the figures of one camera."""
    rng = np.random.default_rng(seed)
    name, task = CAMERAS[arrangement], BOARDS[arrangement]
    if task.on_gripper_of is not None:
        task = replace(task, on_gripper_of=options.robot)
    plain = rcs.Setup(
        task="rcs.setups.board_setup:ShowBoard", task_options=task.to_json(), robot=options.robot,
        cameras=rcs.Cameras(name, image_size=options.size), relative="absolute", stepping="sync",
        max_episode_steps=None,
    )  # fmt: skip
    lab = MountedCamera.of(plain, name)
    optical = Mount.of(near(lab.camera.optical_in_parent.pose, rng))
    board_near = near(task.mount.pose, rng)
    width, height = options.size
    result: dict[str, Any] = {"refused": True, "false_alarms": 0}

    def lens_of(focal: float, distortion: tuple[float, ...]) -> Intrinsics:
        fx, fy = focal * height / 480 * rng.uniform(0.98, 1.02, 2)
        cx, cy = (width - 1) / 2 + rng.uniform(-8, 8), (height - 1) / 2 + rng.uniform(-8, 8)
        return Intrinsics(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion)

    def look(lens: Intrinsics) -> tuple[BoardStrategy, Pose]:
        """Drive and look; the single axis of the first seed besides."""
        file = folder / "calibration.json"
        write_calibration(file, {name: Calibration(optical=optical, intrinsics=lens)})
        setup = replace(plain, cameras=replace(plain.cameras, calibration=str(file)))
        strategy = BoardStrategy(lab.rig(lens, board_near), task.board, views=options.views, seed=seed)
        with rcs.make(setup) as env:
            look_around(env, strategy, name, is_free=FreePath(env, lab.robot.name))
            if seed == 0:
                result["refused"] &= is_single_axis_refused(Tour(env), name, strategy)
        return strategy, MountedCamera.of(setup, name).rig(lens).camera_in_mount

    def solve(case: str, views: Sequence[View], lens: Intrinsics, true: Pose) -> None:
        """Calibrate the camera and store the error."""
        found = hand_eye(task.board, views, lab.arrangement, lens)
        off, sigma = error(found.camera_in_mount, true), (found.sigma_mm, found.sigma_degrees)
        beside = error(park(task.board, views, found, lens), true)
        ratio = np.divide(off, sigma)
        result[case] = (*off, *beside, *ratio, 1000 * found.robot[0], float(np.rad2deg(found.robot[1])))
        result["false_alarms"] += len(found.alarms)

    seen = lens_of(FOCAL[arrangement], (*rng.uniform(-0.05, 0.05, 2), *rng.uniform(-0.001, 0.001, 2), 0.0))
    strategy, true = look(seen)
    noisy = with_noise(strategy, options.picture_noise, rng)
    solve("exact", strategy.views, seen, true)
    solve("small noise", with_robot(noisy, options.small_noise, rng), seen, true)
    solve("large noise", with_robot(noisy, options.large_noise, rng), seen, true)
    solve("outliers", with_outliers(strategy.views, options.outliers, rng), seen, true)
    longer = replace(seen, fx=1.01 * seen.fx, fy=1.01 * seen.fy)
    result["lens_alarm"] = bool(hand_eye(task.board, strategy.views, lab.arrangement, longer).alarms)
    bent = lens_of(*BENT)
    strategy, true = look(bent)
    solve("k1 -0.3", strategy.views, bent, true)
    return result


def main(options: Options) -> None:
    """Measure and print."""
    console = Console(width=140)
    table = Table("arrangement", "case", "error", "Park's", "error / σ", "robot seems off by",
                  title=f"Error of the camera's pose, {options.seeds} seeds: median, 90 %, largest")  # fmt: skip
    report: dict[str, Any] = {"seeds": options.seeds, "views": options.views}
    every: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for arrangement in CAMERAS:
            steps = track(range(options.seeds), arrangement, console=Console(stderr=True))
            found = [measure(arrangement, seed, options, Path(folder)) for seed in steps]
            every += found
            report[arrangement] = {case: summary([row[case] for row in found]) for case in CASES}
    for arrangement, case in product(CAMERAS, CASES):
        row = report[arrangement][case]
        lines = [" ".join(f"{value:.3f}" for value in row[key]) + unit for key, unit in FIGURES.items()]
        cells = ["\n".join(pair) for pair in zip(lines[::2], lines[1::2], strict=True)]
        table.add_row(arrangement, case, *cells, "{:.3f} mm\n{:.4f}°".format(*row["robot"]))
    report["single_axis_refused"] = all(row["refused"] for row in every)
    report["lens_alarms"] = float(np.mean([row["lens_alarm"] for row in every]))
    report["false_alarms"] = sum(row["false_alarms"] for row in every)
    console.print(table)
    print(json.dumps(report))


def summary(rows: list[tuple[float, ...]]) -> dict[str, list[float]]:
    """Return the figures of a case."""
    quantiles = np.quantile(rows, (0.5, 0.9, 1.0), axis=0).round(5).T.tolist()
    return {**dict(zip(FIGURES, quantiles, strict=False)), "robot": [one[0] for one in quantiles[len(FIGURES) :]]}


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
