"""Points from depth: what is projected comes back, and what was not measured gives no point."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.spatial import Pose, deproject, distort, point_cloud

MATRIX = np.array([[50.0, 0.0, 11.0], [0.0, 48.0, 7.0], [0.0, 0.0, 1.0]])
LENS = (-0.2, 0.05, 0.001, -0.001, 0.0)
POSE = Pose((0.3, -0.2, 0.9), (0.5, -0.5, 0.5, 0.5)).matrix
RNG = np.random.default_rng(0)
DEPTH = RNG.uniform(0.4, 2.0, (16, 24))


def in_picture(points: np.ndarray, lens: tuple[float, ...]) -> np.ndarray:
    """Return columns, rows and depths of points."""
    seen = np.linalg.inv(POSE) @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T
    pixels = distort((seen[:2] / seen[2]).T, lens) * (50.0, 48.0) + (11.0, 7.0)
    return np.column_stack([pixels, seen[2]])


@pytest.mark.parametrize("lens", [(0.0,) * 5, LENS])
def test_every_point_is_seen_in_its_pixel_at_its_depth(lens: tuple[float, ...]) -> None:
    points, colours = point_cloud(DEPTH, MATRIX, POSE, distortion=lens)
    assert points.dtype == np.float32
    assert colours is None
    rows, columns = np.mgrid[:16, :24].reshape(2, -1)
    np.testing.assert_allclose(
        in_picture(points.astype(float), lens), np.column_stack([columns, rows, DEPTH.ravel()]), atol=2e-4
    )


def test_whole_numbers_are_millimetres() -> None:
    depth = np.rint(1e3 * DEPTH).astype(np.uint16)
    np.testing.assert_array_equal(point_cloud(depth, MATRIX).points, point_cloud(1e-3 * depth, MATRIX).points)


def test_what_was_not_measured_or_is_masked_gives_no_point_and_colours_go_along() -> None:
    rgb = RNG.integers(0, 255, (16, 24, 3)).astype(np.uint8)
    depth = np.rint(1e3 * DEPTH).astype(np.uint16)
    depth[3, 4] = 0
    mask = np.zeros((16, 24), np.bool_)
    mask[3, 3:7] = True
    points, colours = point_cloud(depth, MATRIX, POSE, rgb, mask)
    assert points.shape == (3, 3)
    assert colours is not None
    np.testing.assert_array_equal(colours, rgb[3, [3, 5, 6]])
    broken = DEPTH.copy()
    broken[0, :3] = np.nan, -1.0, np.inf
    assert len(point_cloud(broken, MATRIX).points) == DEPTH.size - 3


def test_many_images_have_the_points_of_each() -> None:
    depth = np.rint(1e3 * RNG.uniform(0.4, 2.0, (3, 2, 16, 24))).astype(np.uint16)
    depth[1, 1, 2, 2] = 0
    matrices = np.broadcast_to(MATRIX, (3, 2, 3, 3)) * np.ones((3, 2, 1, 1))
    matrices[2, 0, 0, 0] = 60.0
    poses = np.stack([POSE] * 6).reshape(3, 2, 4, 4)
    many = deproject(depth, matrices, poses, invalid=0.0)
    for index in np.ndindex(3, 2):
        one = deproject(depth[index], matrices[index], poses[index], invalid=0.0)
        assert one.tobytes() == many[index].tobytes()
    assert not many[1, 1, 2, 2].any()
    assert np.isnan(deproject(depth, matrices)[1, 1, 2, 2]).all()
    without = deproject(depth, matrices, poses, distortion=None, invalid=0.0)
    assert without.tobytes() == many.tobytes()


def test_shapes_that_do_not_fit_are_told() -> None:
    for rgb, mask in ((np.zeros((8, 8, 3), np.uint8), None), (None, np.ones((8, 8), np.bool_))):
        with pytest.raises(InvalidSetup, match=r"\(8, 8"):
            point_cloud(DEPTH, MATRIX, rgb=rgb, mask=mask)
    with pytest.raises(InvalidSetup, match="intrinsics has shape"):
        point_cloud(DEPTH, np.eye(4))
    with pytest.raises(InvalidSetup, match=r"distortion has shape \(3, 5\); valid is \(5,\) or \(2, 5\)"):
        deproject(np.stack([DEPTH] * 2), MATRIX, distortion=np.zeros((3, 5)))
    with pytest.raises(InvalidSetup, match="depth has shape"):
        point_cloud(DEPTH[None], MATRIX)
