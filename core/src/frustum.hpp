// The space that a camera sees. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <cmath>

#include "rcs/lens.hpp"

namespace rcs {

/// Give a camera the principal point and the focal lengths of a lens, for a picture of some height [pixels].
inline void aim(mjvGLCamera& camera, const Lens& lens, int picture_height) {
  const double near = camera.frustum_near;
  const double model_focal = picture_height * near / (camera.frustum_top - camera.frustum_bottom);
  const double column = near / (lens.scale_x * model_focal), row = near / (lens.scale_y * model_focal);
  const double left = -(lens.cx + 0.5) * column, right = (lens.width - 0.5 - lens.cx) * column;
  camera.frustum_center = static_cast<float>((left + right) / 2);
  camera.frustum_width = static_cast<float>((right - left) / 2);
  camera.frustum_top = static_cast<float>((lens.cy + 0.5) * row);
  camera.frustum_bottom = static_cast<float>(-(lens.height - 0.5 - lens.cy) * row);
}

/// A pyramid from the camera's position, in camera axes (x right, y up, z forward).
class Frustum {
 public:
  /// `aspect` is the picture's width over its height.
  Frustum(const mjvGLCamera& camera, double aspect) : camera_(camera) {
    mju_f2n(forward_, camera.forward, 3);
    mju_f2n(up_, camera.up, 3);
    mju_cross(right_, forward_, up_);
    const double half_height = 0.5 * (camera.frustum_top - camera.frustum_bottom);
    const double half_width = camera.frustum_width > 0 ? camera.frustum_width : half_height * aspect;
    const double scale = camera.orthographic ? 1.0 : camera.frustum_near;
    left_ = (camera.frustum_center - half_width) / scale;
    right_end_ = (camera.frustum_center + half_width) / scale;
    bottom_ = camera.frustum_bottom / scale;
    top_ = camera.frustum_top / scale;
  }

  /// Whether a ball around the geom, which has no known size when its radius is 0, can be in the picture.
  bool may_show(const mjvGeom& geom) const {
    if (geom.modelrbound <= 0) return true;
    const double radius = 1.001 * geom.modelrbound;
    const mjtNum offset[3] = {geom.pos[0] - camera_.pos[0], geom.pos[1] - camera_.pos[1], geom.pos[2] - camera_.pos[2]};
    const double x = mju_dot3(offset, right_), y = mju_dot3(offset, up_), z = mju_dot3(offset, forward_);
    if (z < camera_.frustum_near - radius) return false;
    const auto is_outside = [&](double coordinate, double slope) {
      if (camera_.orthographic) return coordinate - slope > radius;
      return coordinate - slope * z > radius * std::sqrt(1 + slope * slope);
    };
    return !is_outside(x, right_end_) && !is_outside(-x, -left_) && !is_outside(y, top_) && !is_outside(-y, -bottom_);
  }

 private:
  const mjvGLCamera& camera_;
  mjtNum forward_[3], up_[3], right_[3];
  double left_, right_end_, bottom_, top_;
};

}  // namespace rcs
