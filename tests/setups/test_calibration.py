"""Calibration files say where cameras are and how they see; a bad one is refused with what is wrong."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.calibration import Board
from rcs.devices import CameraCalibration, CameraMode
from rcs.devices.fakes import FakeCamera
from rcs.envs.observers.record import record
from rcs.errors import InvalidSetup
from rcs.hardware import Site
from rcs.robots import Mount
from rcs.robots.camera import Calibration
from rcs.setups.calibration import KnownBoard, calibrated, read_calibration, write_calibration
from rcs.setups.labs import FR3 as LAB
from rcs.spatial import Intrinsics

OPTICAL = {"translation": [0.4, 0.9, 0.6], "quaternion": [1.0, 0.0, 0.0, 0.0]}
SEES = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 319.5, "cy": 239.5}
SIDE: dict[str, Any] = {"optical": OPTICAL, "intrinsics": SEES}


def write(folder: Path, camera: dict[str, Any], name: str = "side") -> Path:
    path = folder / "calibration.json"
    path.write_text(json.dumps({"cameras": {name: camera}}))
    return path


def test_a_calibrated_camera_is_where_the_file_says_and_sees_as_it_says(tmp_path: Path) -> None:
    lab = calibrated(LAB, write(tmp_path, SIDE))
    assert lab.cameras["side"].optical.translation == (0.4, 0.9, 0.6)
    calibration = lab.cameras["side"].calibration
    assert calibration is not None
    assert calibration.intrinsics == Intrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
    assert lab.cameras["wrist"] == LAB.cameras["wrist"], "what the file does not name stays"


@pytest.mark.gl
def test_frames_carry_the_calibrated_matrices(tmp_path: Path) -> None:
    path = write(tmp_path, SIDE)
    env = rcs.make(
        "Free", robot="fr3", cameras=rcs.Cameras(names=("side",), image_size=(640, 480), calibration=str(path))
    )
    frame = env.reset(seed=0)[0]["frames"]["side"]
    assert frame["intrinsics"][0, 0] == pytest.approx(500.0)
    np.testing.assert_allclose(frame["extrinsics"][:3, 3], OPTICAL["translation"], atol=1e-9)
    env.close()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"optical": {"quaternion": [1.0, 1.0, 0.0, 0.0]}}, "side.*norm"),
        ({"optical": {"translation": [0.0, 1.0]}}, "side.*translation"),
        ({"optical": {"quaternion": None}}, "not a calibration file"),
        ({"intrinsics": {**SEES, "fy": -1.0}}, "side.*fy is -1.0; valid: a finite number above 0"),
        ({"intrinsics": {**SEES, "cx": 700.0}}, "side.*principal point"),
        ({"intrinsics": {**SEES, "distortion": [0.1, 0.2]}}, "side.*k1, k2, p1, p2 and k3"),
        ({"intrinsics": {**SEES, "distortion": [0.1] * 8}}, "side.*k1, k2, p1, p2 and k3"),
        ({"intrinsics": {**SEES, "k1": 0.1}}, "side.*'k1'"),
        ({"intrinsics": {**SEES, "width": 640.5}}, "side.*whole number"),
        ({"intrinsics": {"fy": 500.0}}, "side.*lacks 'width'"),
        ({"lens": {}}, "side.*'lens'"),
        ({"pose_covariance": [[1.0]]}, "side.*6 x 6"),
        ({"pose_covariance": (-np.eye(6)).tolist()}, "side.*negative variance"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path: Path, changes: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidSetup, match=text):
        read_calibration(write(tmp_path, {**SIDE, **changes}))


def test_missing_files_and_unknown_cameras_are_told(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="cannot be read"):
        rcs.make("Free", robot="fr3", cameras=rcs.Cameras(calibration=str(tmp_path / "none.json")))
    with pytest.raises(InvalidSetup, match=r"\['top'\].*side.*wrist"):
        calibrated(LAB, write(tmp_path, SIDE, name="top"))
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(InvalidSetup, match="not a calibration file"):
        read_calibration(tmp_path / "broken.json")


LENS = {"fx": 480.0, "fy": 470.0, "cx": 335.0, "cy": 228.0, "distortion": [-0.2, 0.05, 0.001, -0.001]}
COVARIANCE = np.diag([1e-6] * 3 + [1e-5] * 3).tolist()


def test_an_unknown_key_at_the_top_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"cameras": {"side": SIDE}, "units": "mm"}))
    with pytest.raises(InvalidSetup, match="units"):
        read_calibration(path)


@pytest.mark.gl
@pytest.mark.parametrize("size", [(640, 480), (224, 224), (320, 180)])
def test_simulation_and_device_tell_the_same_matrices_and_distortion(tmp_path: Path, size: tuple[int, int]) -> None:
    path = str(write(tmp_path, {**SIDE, "intrinsics": {**SEES, **LENS}}))
    simulated = rcs.make("Free", robot="fr3", cameras=rcs.Cameras(names=("side",), image_size=size, calibration=path))
    device = FakeCamera(CameraMode(640, 480, 30.0, False), name="side")
    site = Site(arms={"fr3": "fake"}, grippers={"fr3": "fake"}, cameras={"side": device})
    real = rcs.make(
        "Free", robot="fr3", cameras=rcs.Cameras(names=("side",), image_size=size, calibration=path), hardware=site
    )
    frames = [env.reset(seed=0)[0]["frames"]["side"] for env in (simulated, real)]
    for key in ("intrinsics", "distortion", "extrinsics"):
        np.testing.assert_allclose(frames[0][key], frames[1][key], rtol=1e-12, atol=1e-12)
    assert frames[0].keys() == frames[1].keys()
    assert frames[0]["intrinsics"][0, 0] == pytest.approx(480.0 * size[0] / min(640, 480 * size[0] / size[1]))
    np.testing.assert_array_equal(frames[0]["distortion"], [*LENS["distortion"], 0.0])
    assert simulated.stack.about == real.stack.about
    simulated.close()
    real.close()


def test_a_devices_own_calibration_is_used_whole_also_when_it_is_known_only_after_opening() -> None:
    matrix = np.array([[600.0, 0.0, 331.0], [0.0, 602.0, 236.0], [0.0, 0.0, 1.0]])
    lens = [0.1, -0.2, 0.001, 0.0005, 0.05]

    class LateCamera(FakeCamera):
        def _calibration(self) -> CameraCalibration | None:
            return CameraCalibration(matrix, lens) if self.is_open else None

    device = LateCamera(CameraMode(640, 480, 30.0, False), name="overhead")
    site = Site(arms={"ur5e": "fake"}, grippers={"ur5e": "fake"}, cameras={"overhead": device})
    env = rcs.make("Free", robot="ur5e", cameras=rcs.Cameras(names=("overhead",), image_size=(320, 240)), hardware=site)
    frame = env.reset(seed=0)[0]["frames"]["overhead"]
    half = [[300.0, 0.0, 165.25], [0.0, 301.0, 117.75], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(frame["intrinsics"], half)
    np.testing.assert_allclose(frame["distortion"], lens)
    for _ in range(20):
        frame = env.step({"joints": np.zeros(6), "gripper": np.ones(1, np.float32)})[0]["frames"]["overhead"]
        np.testing.assert_allclose(frame["distortion"], lens)
    about = env.stack.device_facts["cameras"]["overhead"]
    assert about == {"source": "device", "size": [640, 480], "matrix": matrix.tolist(), "distortion": lens}
    env.close()


def test_a_calibration_of_another_shape_than_the_devices_pictures_is_refused(tmp_path: Path) -> None:
    device = FakeCamera(CameraMode(640, 360, 30.0, False), name="side")
    site = Site(arms={"fr3": "fake"}, grippers={"fr3": "fake"}, cameras={"side": device})
    with pytest.raises(InvalidSetup, match=r"delivers 640 x 360 px.*those of 640 x 480 px"):
        rcs.make(
            "Free",
            robot="fr3",
            cameras=rcs.Cameras(names=("side",), calibration=str(write(tmp_path, SIDE))),
            hardware=site,
        )


@pytest.mark.gl
def test_a_recording_keeps_matrix_distortion_covariance_and_the_files_hash(tmp_path: Path) -> None:
    path = write(tmp_path, {**SIDE, "intrinsics": {**SEES, **LENS}, "pose_covariance": COVARIANCE})
    env = rcs.make(
        "Free", robot="fr3", cameras=rcs.Cameras(names=("side", "wrist"), image_size=(64, 48), calibration=str(path))
    )
    with record(env, tmp_path / "takes") as takes:
        takes.start(at_reset=True)
        frame = env.reset(seed=0)[0]["frames"]["side"]
        env.step({"joints": np.zeros(7), "gripper": np.ones(1, np.float32)})
        takes.finish(None)
    env.close()
    dataset = Dataset.open(tmp_path / "takes")
    about = dataset.info.origin["cameras"]["side"]
    assert about == {
        "source": "calibration",
        "size": [640, 480],
        "matrix": [[480.0, 0.0, 335.0], [0.0, 470.0, 228.0], [0.0, 0.0, 1.0]],
        "distortion": [*LENS["distortion"], 0.0],
        "pose_covariance": COVARIANCE,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }
    episode = dataset.episodes[0]
    for key in ("intrinsics", "distortion"):
        stored = episode.column(f"observation/frames/side/{key}")
        np.testing.assert_array_equal(stored, np.broadcast_to(frame[key], stored.shape))


def test_what_is_written_is_read_again_and_what_was_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "new" / "lab.json"
    seen = Intrinsics(width=640, height=480, fx=500.0, fy=501.0, cx=310.5, cy=241.0, distortion=(0.1, 0, 0, 0, 0))
    covariance = tuple(tuple(1e-8 * float(i == j) for j in range(6)) for i in range(6))
    side = Calibration(optical=Mount(translation=(0.1, 0.2, 0.3)), intrinsics=seen, pose_covariance=covariance)
    board = KnownBoard(board=Board(rows=3), mount=Mount(translation=(0.5, 0.0, 0.0)), on_gripper_of="fr3")
    write_calibration(path, {"side": side}, {"side": board})
    write_calibration(path, {"wrist": Calibration(intrinsics=seen)})
    found = read_calibration(path)
    assert replace(found.cameras["side"], sha256="") == side and found.boards == {"side": board}
    lab = calibrated(LAB, path)
    assert lab.cameras["wrist"].optical == LAB.cameras["wrist"].optical, "without a pose, the lab's stays"
    wrist = lab.cameras["wrist"].calibration
    assert wrist is not None and wrist.intrinsics == seen


@pytest.mark.parametrize(
    ("board", "text"),
    [
        ({"board": {"rows": 0}, "mount": {}}, "wall.*rows"),
        ({"board": {"tags": 4}, "mount": {}}, "wall.*tags"),
        ({"mount": {"quaternion": [0, 0, 0, 2]}}, "wall.*norm"),
        ({"mount": {}, "on_gripper_of": 3}, "wall.*on_gripper_of"),
        ({"board": {}}, "wall.*mount"),
    ],
)
def test_a_bad_board_is_refused_with_what_is_wrong(board: dict[str, Any], text: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.json"
    path.write_text(json.dumps({"cameras": {}, "boards": {"wall": board}}))
    with pytest.raises(InvalidSetup, match=text):
        read_calibration(path)
