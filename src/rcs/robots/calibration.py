"""The calibration of a mounted camera."""

from __future__ import annotations

from typing import Any

from rcs_data.record import Record

from rcs.spatial import Intrinsics


class CameraCalibration(Record):
    """Calibrated intrinsics and pose covariance of a camera."""

    intrinsics: Intrinsics | None = None
    """Focal lengths, principal point and distortion; None for those of the data sheet."""
    pose_covariance: tuple[tuple[float, ...], ...] | None = None
    """Covariance of the pose, 6 x 6: translation [m], rotation vector [rad], in the camera's optical frame. It is kept
    with recordings and changes no picture; None if it is not known."""
    sha256: str = ""
    """Hash of the file that this is from; empty for none."""

    def about(self) -> dict[str, Any]:
        """Return the entry of a recording, as JSON values."""
        about: dict[str, Any] = {"source": "calibration"}
        if self.intrinsics is not None:
            about |= describe(self.intrinsics)
        if self.pose_covariance is not None:
            about["pose_covariance"] = [list(row) for row in self.pose_covariance]
        if self.sha256:
            about["sha256"] = self.sha256
        return about


def describe(intrinsics: Intrinsics) -> dict[str, Any]:
    """Return intrinsics as JSON values: `size` [px], `matrix` [px], `distortion` (k1, k2, p1, p2, k3)."""
    return {
        "size": [intrinsics.width, intrinsics.height],
        "matrix": intrinsics.matrix.tolist(),
        "distortion": list(intrinsics.distortion),
    }
