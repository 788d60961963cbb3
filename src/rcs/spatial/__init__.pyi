from rcs._core import Pose as Pose
from rcs._core import compose_tquat as compose
from rcs._core import distance_tquat as distance
from rcs._core import interpolate_tquat as interpolate
from rcs._core import inverse_tquat as inverse
from rcs._core import limit_step_tquat as limit_step
from rcs._core import matrix_to_tquat as matrix_to_tquat
from rcs._core import normalize_tquat as normalize
from rcs._core import relative_tquat as relative
from rcs._core import tquat_to_matrix as tquat_to_matrix
from rcs._core import tquat_to_xyzrpy as tquat_to_xyzrpy
from rcs._core import wxyz_to_xyzw as wxyz_to_xyzw
from rcs._core import xyzrpy_to_tquat as xyzrpy_to_tquat
from rcs._core import xyzw_to_wxyz as xyzw_to_wxyz
from rcs.spatial.pinhole import Intrinsics as Intrinsics
from rcs.spatial.pinhole import distort as distort
from rcs.spatial.pinhole import pixel_rays as pixel_rays
from rcs.spatial.pinhole import undistort as undistort
from rcs.spatial.points import PointCloud as PointCloud
from rcs.spatial.points import deproject as deproject
from rcs.spatial.points import point_cloud as point_cloud

# Names that are not those of the core are public because they are listed here.
__all__ = [
    "Intrinsics",
    "PointCloud",
    "Pose",
    "compose",
    "deproject",
    "distance",
    "distort",
    "interpolate",
    "inverse",
    "limit_step",
    "matrix_to_tquat",
    "normalize",
    "pixel_rays",
    "point_cloud",
    "relative",
    "tquat_to_matrix",
    "tquat_to_xyzrpy",
    "undistort",
    "wxyz_to_xyzw",
    "xyzrpy_to_tquat",
    "xyzw_to_wxyz",
]
