// A lower bound of the distance of two geoms, much cheaper than the distance. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

namespace rcs {

/// Distance of a point from a geom, or less: exact for planes, spheres, capsules and boxes, from the bounding box of
/// others. Not positive inside.
inline double bound_from_point(const mjModel* model, const mjData* data, int geom, const double point[3]) {
  const double* size = model->geom_size + 3 * geom;
  const double* at = data->geom_xpos + 3 * geom;
  const double* axes = data->geom_xmat + 9 * geom;
  const double away[3] = {point[0] - at[0], point[1] - at[1], point[2] - at[2]};
  const auto along = [&](int k) { return axes[k] * away[0] + axes[3 + k] * away[1] + axes[6 + k] * away[2]; };
  switch (model->geom_type[geom]) {
    case mjGEOM_PLANE:
      return along(2);
    case mjGEOM_SPHERE:
      return mju_norm3(away) - size[0];
    case mjGEOM_CAPSULE: {
      const double z = along(2), beyond = std::max(std::abs(z) - size[1], 0.0);
      const double across = std::max(mju_dot3(away, away) - z * z, 0.0);
      return std::sqrt(across + beyond * beyond) - size[0];
    }
    default: {
      const double* box = model->geom_aabb + 6 * geom;  // centre, half sizes
      double squared = 0.0;
      for (int k = 0; k < 3; ++k) {
        const double out = std::max(std::abs(along(k) - box[k]) - box[3 + k], 0.0);
        squared += out * out;
      }
      return std::sqrt(squared);
    }
  }
}

/// Sum of the radii of two geoms' bounding spheres [m]; a plane's is larger than anything.
inline double radii_of(const mjModel* model, int a, int b) {
  if (model->geom_type[a] == mjGEOM_PLANE || model->geom_type[b] == mjGEOM_PLANE) return mjMAXVAL;
  return model->geom_rbound[a] + model->geom_rbound[b];
}

/// Squared distance of the middles of two geoms [m²].
inline double squared_distance(const mjData* data, int a, int b) {
  const double *at_a = data->geom_xpos + 3 * a, *at_b = data->geom_xpos + 3 * b;
  const double x = at_a[0] - at_b[0], y = at_a[1] - at_b[1], z = at_a[2] - at_b[2];
  return x * x + y * y + z * z;
}

/// Distance of two geoms, or less.
inline double bound_of(const mjModel* model, const mjData* data, int a, int b) {
  const double far = 1e10;  // a plane has no centre that says anything
  const double from_b = model->geom_type[b] == mjGEOM_PLANE
                            ? -far
                            : bound_from_point(model, data, a, data->geom_xpos + 3 * b) - model->geom_rbound[b];
  const double from_a = model->geom_type[a] == mjGEOM_PLANE
                            ? -far
                            : bound_from_point(model, data, b, data->geom_xpos + 3 * a) - model->geom_rbound[a];
  return std::max(from_a, from_b);
}

}  // namespace rcs
