"""Poses and conversions between their representations; the only place that knows about quaternion order.

Functions take one pose or a batch, indexed from the right, as float64. A pose is a `tquat`, shape (..., 7): translation
[m] and unit quaternion xyzw; or an `xyzrpy`, shape (..., 6): translation [m] and roll, pitch, yaw [rad] about the fixed
x, y, z axes, in that order. Leading dimensions are kept; each of several arguments has the same leading shape or is a
single pose for every row. Results are new arrays; the quaternions of poses have w >= 0. Poses with numbers that are not
finite, or with a quaternion more than 1e-3 off norm 1, raise a ValueError that names the row; `normalize` accepts
quaternions of any length.
"""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
