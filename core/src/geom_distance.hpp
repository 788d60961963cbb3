// The distance of two geoms of a model.
#pragma once

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

namespace rcs {

/// Whether the axis of a capsule passes through a box, both at their poses in `data`.
inline bool passes_through(const mjModel* model, const mjData* data, int capsule, int box) {
  const mjtNum* turn = data->geom_xmat + 9 * box;
  const mjtNum* axis = data->geom_xmat + 9 * capsule;
  const mjtNum* place = data->geom_xpos + 3 * capsule;
  const mjtNum* middle = data->geom_xpos + 3 * box;
  double first = -model->geom_size[3 * capsule + 1], last = model->geom_size[3 * capsule + 1];
  for (int i = 0; i < 3; ++i) {  // of the part of the axis between each two opposite faces
    double at = 0.0, along = 0.0;
    for (int k = 0; k < 3; ++k) {
      at += turn[3 * k + i] * (place[k] - middle[k]);
      along += turn[3 * k + i] * axis[3 * k + 2];
    }
    const double half = model->geom_size[3 * box + i];
    if (std::abs(along) < 1e-12) {
      if (std::abs(at) > half) return false;
      continue;
    }
    const double one = (-half - at) / along, other = (half - at) / along;
    first = std::max(first, std::min(one, other));
    last = std::min(last, std::max(one, other));
    if (first > last) return false;
  }
  return true;
}

/// Signed distance [m] at the poses in `data`, below 0 inside each other; `limit` if it is larger. MuJoCo's own, which
/// for a capsule whose axis passes through a box (MuJoCo 4.0.0) may be above 0; then it is minus the capsule's radius.
inline double geom_distance(const mjModel* model, mjData* data, int a, int b, double limit) {
  const double distance = mj_geomDistance(model, data, a, b, limit, nullptr);
  if (distance < 0.0) return distance;  // 0 may be the limit
  const int kind_a = model->geom_type[a], kind_b = model->geom_type[b];
  if (kind_a == mjGEOM_CAPSULE && kind_b == mjGEOM_BOX && passes_through(model, data, a, b))
    return -model->geom_size[3 * a];
  if (kind_a == mjGEOM_BOX && kind_b == mjGEOM_CAPSULE && passes_through(model, data, b, a))
    return -model->geom_size[3 * b];
  return distance;
}

}  // namespace rcs
