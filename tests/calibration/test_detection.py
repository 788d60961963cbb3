"""Corners are found where they are, however the lens bends the edges between them."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.calibration import Board, detect
from rcs.calibration.board_pose import project
from rcs.calibration.detection import _straightening
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, Pose, distort, pixel_rays

pytestmark = pytest.mark.extras

SIZE = (480, 360)
BOARD = Board()
POSES = [
    Pose.from_rotvec([0.0, 0.0, 0.36], [np.pi, 0.0, 0.0]) * Pose.from_rpy([0.0, 0.0, 0.0], [0.2, -0.3, 0.4]),
    Pose.from_rotvec([0.06, 0.01, 0.45], [np.pi, 0.0, 0.0]) * Pose.from_rpy([0.0, 0.0, 0.0], [-0.4, 0.1, 1.2]),
]


def lens_of(k1: float) -> Intrinsics:
    return Intrinsics(width=480, height=360, fx=463.0, fy=460.0, cx=243.0, cy=176.0, distortion=(k1, 0.02, 0.001, 0, 0))


def drawn(lens: Intrinsics, pose: Pose) -> NDArray[np.uint8]:
    """Draw the board as a lens sees it: the mean of 4 x 4 rays of each pixel."""
    fine = lens.cut((4 * lens.width, 4 * lens.height))
    rays = pixel_rays(fine.matrix, (fine.width, fine.height), fine.distortion)
    # The plane of the board, and where each ray meets it.
    to_board = np.linalg.inv(np.column_stack([pose.matrix[:3, :2], pose.matrix[:3, 3]]))
    met = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1) @ to_board.T
    page = BOARD.picture(16)
    scale = page.shape[0] / BOARD.size[1]
    column, row = (np.floor((met[..., 0] / met[..., 2] + BOARD.size[0] / 2) * scale),
                   np.floor((BOARD.size[1] / 2 - met[..., 1] / met[..., 2]) * scale))  # fmt: skip
    is_on = (column >= 0) & (column < page.shape[1]) & (row >= 0) & (row < page.shape[0])
    shades = np.where(is_on, page[np.where(is_on, row, 0).astype(int), np.where(is_on, column, 0).astype(int)], 120)
    return shades.reshape(lens.height, 4, lens.width, 4).mean(axis=(1, 3)).round().astype(np.uint8)


def expected(lens: Intrinsics, pose: Pose) -> NDArray[np.float64]:
    rays = project(pose.matrix, BOARD.corners)
    return distort(rays, lens.distortion) * (lens.fx, lens.fy) + (lens.cx, lens.cy)


@pytest.mark.parametrize("pose", POSES, ids=["in the middle", "at the border"])
@pytest.mark.parametrize("k1", [-0.3, 0.0, 0.25])
def test_corners_are_found_in_bent_pictures_as_well_as_in_straight_ones(k1: float, pose: Pose) -> None:
    lens = lens_of(k1)
    found = detect(BOARD, drawn(lens, pose), lens)
    assert found.ids.tolist() == BOARD.ids
    off = np.linalg.norm(found.corners - expected(lens, pose), axis=-1)
    assert np.sqrt(np.mean(off**2)) < 0.1 and off.max() < 0.25


def test_a_lens_that_folds_its_picture_over_beyond_the_board_is_no_obstacle() -> None:
    # At 170 px from the middle the picture ends: nothing is seen farther out, and rays from there come back.
    lens = Intrinsics(width=480, height=360, fx=300.0, fy=300.0, cx=240.0, cy=180.0, distortion=(-0.5, 0, 0, 0, 0))
    with pytest.raises(InvalidSetup, match="folds"):
        pixel_rays(lens.matrix, SIZE, lens.distortion)
    blank = np.full(SIZE[::-1], 120, np.uint8)
    assert len(detect(BOARD, blank, lens)) == 0
    lookup, first = _straightening(lens)
    taken = np.argwhere(lookup[..., 0] >= -1)[:, ::-1] + first
    # Up to there, r - r³ / 2 rises with r.
    assert 0.7 < np.linalg.norm((taken - (240, 180)) / 300, axis=-1).max() < np.sqrt(2 / 3) + 1e-6


@pytest.mark.parametrize("lens", [lens_of(0.0), lens_of(-0.3)], ids=["straight", "bent"])
def test_a_lens_of_another_size_than_the_picture_is_refused(lens: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"240 x 180 px, its lens 480 x 360.*cut"):
        detect(BOARD, np.zeros((180, 240), np.uint8), lens)


ENDS = """
import ctypes
from rcs.calibration import detection
c = ctypes.CDLL(None)
c.malloc.restype, c.malloc.argtypes, c.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]
blocks = [c.malloc(72) for _ in range(200)]
for block in blocks[::2]:
    c.free(block)  # places of a family's size, between blocks that stay
detection._detector()
del detection._local.detector
for block in blocks[1::2]:
    c.free(block)
c.malloc(4096)  # makes the heap look at them
"""


def test_the_end_of_a_detector_leaves_the_heap_whole() -> None:
    # The library writes into memory that it has freed, which shows only when that is not cached by the thread.
    tunables = "glibc.malloc.tcache_count=0:glibc.malloc.mmap_max=0"
    environment = {**os.environ, "GLIBC_TUNABLES": tunables}
    done = subprocess.run([sys.executable, "-c", ENDS], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
